"""GOSPA, OSPA(2) and trajectory GOSPA: by hand, against enumeration, and as metrics."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bayesnet_track.evaluate.gospa import gospa, ospa2, track_distances, trajectory_gospa
from bayesnet_track.evaluate.truth import Tracks, pair

C = 10.0


def tracks(*rows):
    """Boxes of 1 px, of rows (frame, identity, x, y)."""
    values = np.array(rows, dtype=np.float64).reshape(-1, 4)
    boxes = np.hstack([values[:, 2:], np.ones((len(values), 2))])
    return Tracks(values[:, 0].astype(np.int64), values[:, 1].astype(np.int64), boxes)


def along(identity, frames, x, y=0.0):
    return [(frame, identity, x, y) for frame in frames]


def matchings(rows, columns):
    """All sets of pairs, one to one, the empty one included, as tuples: column of each row, or None."""
    for chosen in product([None, *range(columns)], repeat=rows):
        used = [one for one in chosen if one is not None]
        if len(used) == len(set(used)):
            yield chosen


def distances(truth, found, frame=0):
    """Distances of all true places of a frame from all tracked ones."""
    true, tracked = (side.boxes[side.frames == frame, :2] for side in (truth, found))
    return np.hypot(*(true[:, None] - tracked[None]).transpose(2, 0, 1))


@st.composite
def several(draw, sides, frames=1, most=3):
    """Sets of targets in the plane, near enough to each other for all kinds of matches; any may be empty."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    found = []
    for count in [draw(st.integers(0, most)) for _ in range(sides)]:
        frame, one = np.nonzero(rng.random((frames, count)) < (1.0 if frames == 1 else 0.8))
        places = rng.uniform(0, 15, (count, 2))[one] + rng.normal(0, 3, (len(one), 2))
        found.append(tracks(*np.column_stack([frame, one, places])))
    return found


# ------------------------------------------------------------------------------------ GOSPA

ORDERS = st.sampled_from([1.0, 2.0, 3.5])


def test_gospa_by_hand():
    """Frame 0: a pair at 3 px. Frame 1: a target missed. Frame 2: a false track. Frame 3: at c, so both."""
    truth = tracks((0, 1, 0, 0), (1, 1, 0, 0), (3, 1, 0, 0))
    found = tracks((0, 5, 3, 0), (2, 5, 0, 0), (3, 5, 0, C))
    score = gospa(pair(truth, found), C, 2.0)
    assert (score.localisation, score.missed, score.false, score.frames) == (9.0, 2, 2, 4)
    assert score.total_px == pytest.approx(np.sqrt((9 + 4 * C**2 / 2) / 4))
    assert score.missed_px == score.false_px == pytest.approx(np.sqrt(2 * C**2 / 2 / 4))
    assert score.localisation_px == pytest.approx(1.5)


def test_frames_without_boxes_count_as_without_error():
    found = gospa(pair(tracks((0, 1, 0, 0), (9, 1, 0, 0)), tracks((9, 1, 0, 0))), C, 1.0)
    assert found.frames == 10 and found.total_px == pytest.approx(C / 2 / 10)


@given(several(2), ORDERS)
def test_gospa_is_the_least_over_all_matchings(sides, order):
    pairs = pair(*sides)
    if not pairs.length:
        return
    distance = distances(*sides)
    sums = [
        sum(distance[i, j] ** order for i, j in enumerate(chosen) if j is not None)
        + C**order / 2 * (sum(distance.shape) - 2 * sum(j is not None for j in chosen))
        for chosen in matchings(*distance.shape)
    ]
    assert gospa(pairs, C, order).total_px == pytest.approx(min(sums) ** (1 / order), abs=1e-9)


@given(several(3, frames=3), ORDERS)
def test_gospa_is_a_metric(sides, order):
    def between(a, b):
        score = gospa(pair(a, b), C, order)
        return score.total_px * score.frames ** (1 / order)

    a, b, c = sides
    assert between(a, a) == 0 and between(a, b) == pytest.approx(between(b, a))
    assert between(a, c) <= between(a, b) + between(b, c) + 1e-9


@given(several(2, frames=3), st.floats(-200, 200), st.floats(0.1, 10))
def test_gospa_moves_and_scales_with_the_image(sides, shift, factor):
    def changed(side):
        places = side.boxes[:, :2] * factor + shift
        return Tracks(side.frames, side.ids, np.hstack([places, side.boxes[:, 2:]]))

    before, after = pair(*sides), pair(*(changed(side) for side in sides))
    for metric in (lambda *a: gospa(*a).total_px, ospa2):
        assert metric(after, C * factor) == pytest.approx(factor * metric(before, C), rel=1e-6, abs=1e-6)


@given(several(2, frames=3))
def test_the_parts_add_up_and_the_order_of_lines_changes_nothing(sides):
    score = gospa(pair(*sides), C)
    parts = (score.localisation_px, score.missed_px, score.false_px)
    assert score.total_px**2 == pytest.approx(sum(part**2 for part in parts))
    turned = [Tracks(side.frames[::-1], 9 - side.ids[::-1], side.boxes[::-1]) for side in sides]
    assert gospa(pair(*turned), C).total_px == pytest.approx(score.total_px)


@pytest.mark.parametrize("metric", [gospa, ospa2, trajectory_gospa])
def test_what_makes_no_metric_is_refused(metric):
    pairs = pair(tracks((0, 1, 0, 0)), tracks())
    with pytest.raises(ValueError, match="cut-off 0; expected a distance above 0 px"):
        metric(pairs, 0.0)
    with pytest.raises(ValueError, match=r"order 0.5; expected a number from 1 on"):
        metric(pairs, C, 0.5)


# ------------------------------------------------------------------------------------ OSPA(2)


def test_ospa2_by_hand():
    """On its target 4 px off in 5 of 10 frames, and not there in the others: (5 x 4 + 5 c) / 10."""
    truth, found = tracks(*along(1, range(10), 0)), tracks(*along(7, range(5), 4), *along(8, range(3), 500))
    distance = (5 * 4 + 5 * C) / 10
    np.testing.assert_allclose(track_distances(pair(truth, found), C), [[distance, C]])
    assert ospa2(pair(truth, found), C, 2.0) == pytest.approx(np.sqrt((distance**2 + C**2) / 2))
    assert ospa2(pair(truth, tracks()), C) == C and ospa2(pair(truth, truth), C) == 0


@given(several(2, frames=4), ORDERS)
def test_ospa2_is_the_least_over_all_matchings(sides, order):
    places = [
        [
            {int(k): box for k, box in zip(side.frames[own], side.boxes[own], strict=True)}
            for own in (side.ids == one for one in np.unique(side.ids))
        ]
        for side in sides
    ]

    def apart(a, b):
        return np.mean(
            [min(C, np.hypot(*(a[k] - b[k])[:2])) if k in a and k in b else C for k in a.keys() | b.keys()]
        )

    few, many = sorted(places, key=len)
    if not many:
        return
    least = min(
        sum(C if j is None else apart(few[i], many[j]) ** order for i, j in enumerate(chosen))
        for chosen in matchings(len(few), len(many))
        if None not in chosen
    )
    expected = ((least + C**order * (len(many) - len(few))) / len(many)) ** (1 / order)
    assert ospa2(pair(*sides), C, order) == pytest.approx(expected, abs=1e-9)


@given(several(3, frames=4))
def test_ospa2_is_a_metric(sides):
    a, b, c = sides
    assert ospa2(pair(a, a), C) == 0 and ospa2(pair(a, b), C) == pytest.approx(ospa2(pair(b, a), C))
    assert ospa2(pair(a, c), C) <= ospa2(pair(a, b), C) + ospa2(pair(b, c), C) + 1e-9


# ------------------------------------------------------------------------------------ trajectory GOSPA


def test_a_switch_costs_as_much_as_a_missed_box():
    """One target of 10 frames, exact, under another number from frame 5 on."""
    truth = tracks(*along(1, range(10), 0))
    found = tracks(*along(1, range(5), 0), *along(2, range(5, 10), 0))
    score = trajectory_gospa(pair(truth, found), C, 2.0)
    assert (score.switches, score.missed, score.false, score.localisation) == (1, 0, 0, 0)
    assert score.total_px == score.switches_px == pytest.approx(np.sqrt(C**2 / 2 / 10))
    missed = tracks(*[row for row in along(1, range(10), 0) if row[0] != 4])
    assert gospa(pair(truth, missed), C).total_px == pytest.approx(score.total_px)


def test_two_exchanged_numbers_are_two_switches():
    before = along(1, range(5), 0) + along(2, range(5), 8)
    truth = tracks(*before, *along(1, range(5, 10), 0), *along(2, range(5, 10), 8))
    found = tracks(*before, *along(1, range(5, 10), 8), *along(2, range(5, 10), 0))
    assert trajectory_gospa(pair(truth, found), C, 2.0, 1.0).switches == pytest.approx(2)


def test_a_flicker_that_is_cheaper_to_miss_is_no_switch():
    """In frame 5 alone another track is on the target: two switches cost more than a miss and a false box."""
    truth = tracks(*along(1, range(10), 0))
    found = tracks(*along(1, [0, 1, 2, 3, 4, 6, 7, 8, 9], 0), (5, 2, 0, 0))
    score = trajectory_gospa(pair(truth, found), C, 2.0, C)
    assert (score.switches, score.missed, score.false) == (0, 1, 1)


def rows_of(side):
    return np.column_stack([side.frames, side.ids, side.boxes[:, :2]])


def switched(before, after):
    """1 for another track, a half from or to none."""
    return 0.0 if before == after else 1.0 - ((before is None) + (after is None)) / 2


def cheapest(sides, order, gamma):
    """The metric without relaxation, over K^(1/p): the best sequence of matchings, by dynamic programming."""
    ids = [np.unique(side.ids) for side in sides]
    rows, columns = map(len, ids)
    chosen = list(matchings(rows, columns))
    steps = [[sum(map(switched, x, y)) for y in chosen] for x in chosen]
    switch = gamma**order * np.array(steps)
    best = np.zeros(len(chosen))
    length = max((int(side.frames.max()) + 1 for side in sides if len(side)), default=0)
    for frame in range(length):
        gain, distance = np.zeros((rows, columns)), distances(*sides, frame)
        here = [
            np.searchsorted(own, side.ids[side.frames == frame]) for own, side in zip(ids, sides, strict=True)
        ]
        gain[np.ix_(*here)] = C**order - np.minimum(distance, C) ** order
        cost = np.array([-sum(gain[i, j] for i, j in enumerate(x) if j is not None) for x in chosen], float)
        cost += C**order / 2 * sum(distance.shape)
        best = cost + (best[:, None] + switch).min(axis=0)
    return (best.min() / length) ** (1 / order) if length else 0.0


@given(several(2, frames=6), st.sampled_from([1.0, 2.0]), st.sampled_from([0.0, 2.0, 7.0, 30.0]))
def test_the_linear_program_finds_the_best_sequence_of_matchings(sides, order, gamma):
    """The relaxation is exact on each of these; in general it is at most as large."""
    pairs = pair(*sides)
    score = trajectory_gospa(pairs, C, order, gamma)
    assert score.total_px == pytest.approx(cheapest(sides, order, gamma), abs=1e-6)


@given(several(2, frames=4))
def test_without_a_cost_of_switches_it_is_gospa_and_with_one_no_less(sides):
    pairs = pair(*sides)
    plain = gospa(pairs, C).total_px
    assert trajectory_gospa(pairs, C, switch_px=0.0).total_px == pytest.approx(plain, abs=1e-6)
    assert trajectory_gospa(pairs, C).total_px >= plain - 1e-6


@settings(max_examples=15)
@given(several(3, frames=3))
def test_trajectory_gospa_is_a_metric(sides):
    def between(a, b):
        score = trajectory_gospa(pair(a, b), C)
        return score.total_px * score.frames**0.5

    a, b, c = sides
    assert between(a, a) == pytest.approx(0, abs=1e-4) and between(a, b) == pytest.approx(
        between(b, a), abs=1e-6
    )
    assert between(a, c) <= between(a, b) + between(b, c) + 1e-6


def test_targets_that_never_meet_are_solved_apart():
    """The sum over the K frames of two scenes far from each other is that of both."""
    near = [tracks(*along(1, range(6), 0)), tracks(*along(1, range(4), 3), *along(2, range(3, 6), 2))]
    far = [tracks(*(rows_of(side) + [0, 10, 1000, 0])) for side in near]
    both = [tracks(*rows_of(a), *rows_of(b)) for a, b in zip(near, far, strict=True)]
    one, two = (trajectory_gospa(pair(*sides), C).total_px for sides in (near, both))
    assert two**2 == pytest.approx(2 * one**2)
