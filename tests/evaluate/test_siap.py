"""SIAP measures by hand: associations, shares, continuity."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.evaluate.mot_pairs import Tracks, pair
from bayesnet_track.evaluate.siap import Siap, siap
from bayesnet_track.evaluate.siap_associations import Association, associate

C = 10.0


def tracks(*rows):
    """Boxes of 1 px, of rows (frame, identity, x)."""
    values = np.array(rows, dtype=np.float64).reshape(-1, 3)
    boxes = np.column_stack([values[:, 2], np.zeros(len(values)), np.ones((len(values), 2))])
    return Tracks(values[:, 0].astype(np.int64), values[:, 1].astype(np.int64), boxes)


def along(identity, frames, x):
    return [(frame, identity, x) for frame in frames]


ONE = tracks(*along(1, range(10), 0))


def spells(truth, found):
    return [(one.true, one.track, one.start, one.end) for one in associate(pair(truth, found), C)]


def test_exact_tracks():
    two = tracks(*along(1, range(10), 0), *along(2, range(5), 100))
    assert siap(pair(two, two), C) == Siap(1.0, 1.0, 0.0, 0.0, 0.0, 1.0)


def test_no_tracks():
    assert siap(pair(ONE, tracks()), C) == Siap(0.0, 1.0, 0.0, 0.0, 0.0, 0.0)


def test_another_number_half_way():
    """Tracked from 0 to 4 and from 5 to 9: one change in 8 frame intervals; the longest lasts 4 of 9."""
    found = tracks(*along(1, range(5), 3), *along(2, range(5, 10), 0))
    assert siap(pair(ONE, found), C) == Siap(1.0, 1.0, 0.0, 1.5, 1 / 8, 4 / 9)


def test_two_tracks_on_a_target_and_one_on_none():
    """The second is there for 5 of 10 frames and adds no change; the third's 4 are spurious."""
    found = tracks(*along(1, range(10), 0), *along(2, range(5), 4), *along(3, range(4), 50))
    assert siap(pair(ONE, found), C) == Siap(1.0, 1.5, 4 / 19, 20 / 15, 0.0, 1.0)


def test_the_fewest_tracks_that_cover_a_target_are_counted():
    """Frames 0 to 5, 3 to 7, 5 to 9: the middle one is not needed."""
    found = tracks(*along(1, range(6), 0), *along(2, range(3, 8), 0), *along(3, range(5, 10), 0))
    assert siap(pair(ONE, found), C).breaks == 1 / 9


def test_a_track_that_returns_is_a_break_and_its_times_add_up():
    """On it from 0 to 2, away for two frames, on it from 5 to 9: one change in 6, 6 of 9."""
    found = tracks(*[(frame, 1, 50 * (frame in (3, 4))) for frame in range(10)])
    assert siap(pair(ONE, found), C) == Siap(0.8, 1.0, 0.2, 0.0, 1 / 6, 6 / 9)


def test_three_boxes_in_a_row_make_an_association():
    assert spells(ONE, tracks(*along(1, range(2), 0))) == []
    assert spells(ONE, tracks(*along(1, range(3), 0))) == [(0, 0, 0, 2)]
    assert spells(ONE, tracks(*along(1, range(3), C))) == []
    interrupted = [(0, 1, 0), (1, 1, 0), (2, 1, 50), (3, 1, 0), (4, 1, 0)]
    assert spells(ONE, tracks(*interrupted)) == []


def test_two_boxes_elsewhere_in_a_row_end_it():
    def found(*away):
        return tracks(*[(frame, 1, 50 * (frame in away)) for frame in range(10)])

    assert spells(ONE, found(4)) == [(0, 0, 0, 9)]
    assert spells(ONE, found(4, 6)) == [(0, 0, 0, 9)]
    assert spells(ONE, found(4, 5)) == [(0, 0, 0, 3), (0, 0, 6, 9)]
    assert spells(ONE, found(4, 5, 9)) == [(0, 0, 0, 3), (0, 0, 6, 8)]


def test_a_track_that_changes_its_target():
    two = tracks(*along(1, range(10), 0), *along(2, range(10), 12))
    found = tracks(*along(1, range(5), 2), *along(1, range(5, 10), 11))
    assert spells(two, found) == [(0, 0, 0, 4), (1, 0, 5, 9)]


def test_one_that_flickers_between_two_targets_stays_with_the_first():
    """The other one is nearest in frames 3, 5, 6: not three in a row, so it gets nothing."""
    two = tracks(*along(1, range(8), 0), *along(2, range(8), 12))
    found = tracks(*[(frame, 1, 11 if frame in (3, 5, 6) else 1) for frame in range(8)])
    assert spells(two, found) == [(0, 0, 0, 4)]


def test_frames_in_which_one_of_both_has_no_box_do_not_count():
    """The association lasts over a gap of the track; there nothing is tracked."""
    found = tracks(*along(1, [0, 1, 2, 3, 6, 7, 8, 9], 0))
    assert spells(ONE, found) == [(0, 0, 0, 9)]
    assert siap(pair(ONE, found), C) == Siap(0.8, 1.0, 0.0, 0.0, 0.0, 1.0)


@given(st.integers(0, 2**32 - 1))
def test_of_any_tracks(seed):
    rng = np.random.default_rng(seed)
    sides = []
    for count in (3, 4):
        frame, one = np.nonzero(rng.random((15, count)) < 0.9)
        sides.append(tracks(*np.column_stack([frame, one, 8.0 * one + rng.normal(0, 3, len(one))])))
    pairs = pair(*sides)
    score, found = siap(pairs, C), associate(pairs, C)
    assert 0 <= score.completeness <= 1 and 0 <= score.spuriousness <= 1 and 0 <= score.longest <= 1
    assert score.ambiguity >= 1 and score.position_px >= 0 and score.breaks >= 0
    for a in found:
        assert isinstance(a, Association) and a.end - a.start >= 2
        assert all(a.end < b.start or b.end < a.start for b in found if b.track == a.track and b != a)


def test_a_cut_off_of_nothing_is_refused():
    with pytest.raises(ValueError, match="cut-off 0; expected a distance above 0 px"):
        siap(pair(ONE, ONE), 0.0)
