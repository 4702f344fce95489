"""CLEAR MOT and identity scores of sequences that are counted by hand."""

import numpy as np
import pytest

from bayesnet_track.evaluate.mot import clear_mot, identity
from bayesnet_track.evaluate.truth import Tracks, pair


def tracks(*rows):
    """Rows of frame, identity and left edge, of boxes of 10 x 10 px."""
    frames, ids, left = np.array(rows).T
    boxes = np.column_stack([left, np.zeros(len(rows)), np.full((len(rows), 2), 10.0)]).astype(float)
    return Tracks(frames, ids, boxes)


TRUTH = tracks(*((frame, 1, 0) for frame in range(6)), *((frame, 2, 100) for frame in range(6)))


def test_a_switch_halfway_costs_one_switch_and_half_of_the_identity():
    switched = tracks(
        *((frame, 7 if frame < 3 else 8, 0) for frame in range(6)), *((frame, 9, 100) for frame in range(6))
    )
    clear, own = clear_mot(pair(TRUTH, switched)), identity(pair(TRUTH, switched))
    assert (clear.tp, clear.fn, clear.fp, clear.idsw) == (12, 0, 0, 1)
    assert clear.mota == pytest.approx(1 - 1 / 12) and clear.motp == 1.0
    assert (own.idtp, own.idfn, own.idfp) == (9, 3, 3) and own.idf1 == 0.75


def test_a_missed_target_and_a_false_track():
    found = tracks(*((frame, 1, 0) for frame in range(6)), (0, 5, 300), (1, 5, 300))
    clear, own = clear_mot(pair(TRUTH, found)), identity(pair(TRUTH, found))
    assert (clear.tp, clear.fn, clear.fp, clear.idsw) == (6, 6, 2, 0)
    assert clear.mota == pytest.approx(1 - 8 / 12)
    assert (own.idp, own.idr) == (6 / 8, 6 / 12)


def test_a_pair_stays_matched_while_it_overlaps_enough():
    """A better track appears beside it: by overlap alone it would take over, and count as a switch."""
    truth = tracks(*((frame, 1, 0) for frame in range(4)))
    both = tracks(*((frame, 1, 3) for frame in range(4)), *((frame, 2, 0) for frame in range(2, 4)))
    clear = clear_mot(pair(truth, both))
    assert (clear.tp, clear.fp, clear.idsw) == (4, 2, 0)
    assert clear.motp == pytest.approx(7 / 13)


def test_boxes_that_overlap_too_little_are_a_miss_and_a_false_one():
    away = tracks(*((frame, 1, 4) for frame in range(6)))  # an overlap of 6 / 14
    clear, own = clear_mot(pair(TRUTH, away)), identity(pair(TRUTH, away))
    assert (clear.tp, clear.fn, clear.fp) == (0, 12, 6) and clear.motp == 0.0
    assert (own.idtp, own.idf1) == (0, 0.0)
