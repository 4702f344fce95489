"""The arithmetic of births: claims, overlap of beliefs, and the odds of an identity, against exact values."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track.adapt.association import UNASSIGNED, alike, associate, distances, pair_up
from bayesnet_track.adapt.lifecycle import AppearanceMemory
from bayesnet_track.belief.motion.borders import Confined
from bayesnet_track.belief.motion.models import make_motion
from bayesnet_track.engine.lifecycle.recognise import (
    LOOKALIKE,
    Compared,
    match,
    weigh_appearance,
    weigh_places,
)
from bayesnet_track.graph.spec import Motion, Reidentify


def test_the_cheapest_pairs_come_first_one_to_one():
    cost = np.array([[1.0, 0.5], [0.4, 0.6], [0.3, 9.0]])
    np.testing.assert_array_equal(pair_up(cost, np.full((3, 2), 5.0)), [1, UNASSIGNED, 0])
    np.testing.assert_array_equal(pair_up(cost, np.full((3, 2), 0.4)), [UNASSIGNED, UNASSIGNED, 0])


def test_one_detection_is_claimed_and_near_ones_are_nobodys():
    live = np.array([[50.0, 50, 20, 20]])
    boxes = np.array(
        [[70.0, 50, 20, 20], [58, 50, 20, 20], [54, 57, 8, 8], [90, 50, 20, 20], [52, 50, 20, 20]]
    )
    owner, free = associate(boxes, live, np.array([0.0]), 0.5)
    assert owner.tolist() == [-1, -1, -1, -1, 0] and free.tolist() == [True, False, False, True, False]
    # An unsure target reaches farther for its one detection: 20 px are a side, 2 sd of 5 px half of one.
    owner, free = associate(boxes[:1], live, np.array([5.0]), 0.5)
    assert owner.tolist() == [0] and free.tolist() == [False]


def test_distances_are_in_mean_sides():
    """Sides of 6 and 4 px, the second box 4 px across and 3 px down; and one at the first one's centre."""
    a, b = np.array([[10.0, 20, 9, 4]]), np.array([[14.0, 23, 2, 8], [10, 20, 27, 3]])
    np.testing.assert_allclose(distances(a, b), [[1.0, 0.0]])
    np.testing.assert_allclose(distances(b, a), [[1.0], [0.0]])


def test_boxes_are_alike_that_are_near_or_cover_each_other():
    a = np.array([[50.0, 50, 20, 40]])
    b = np.array(
        [[55.0, 60, 10, 20], [60, 50, 10, 20], [60, 70, 10, 20], [61, 70, 10, 20], [60, 70.1, 10, 20]]
    )
    # The smaller box has 200 px; it lies inside, half inside, a quarter inside and less.
    assert alike(a, b, 0.0).tolist() == [[True, True, False, False, False]]
    assert alike(a, b, 0.0, 0.25).tolist() == [[True, True, True, False, False]]
    assert alike(b, a, 0.0, 0.25).tolist() == [[True], [True], [True], [False], [False]]
    assert alike(a, np.array([[90.0, 50, 20, 40]]), np.sqrt(2.0)).tolist() == [[True]]
    assert alike(a, np.array([[90.0, 50, 20, 40]]), 1.41).tolist() == [[False]]


def test_of_equal_costs_the_lower_row_and_column_come_first():
    assert pair_up(np.ones((2, 3)), np.float64(1.0)).tolist() == [0, 1]
    assert pair_up(np.ones((2, 3)), np.array([[0.5], [1.0]])).tolist() == [UNASSIGNED, 0]


def test_nobody_claims_where_nobody_is():
    boxes = np.array([[70.0, 50, 20, 20]])
    owner, free = associate(boxes, np.empty((0, 4)), np.empty(0), 0.5)
    assert owner.tolist() == [UNASSIGNED] and free.tolist() == [True]
    owner, free = associate(np.empty((0, 4)), boxes, np.array([1.0]), 0.5)
    assert owner.shape == free.shape == (0,)


def test_place_is_a_density_over_the_frame():
    """g N + (1 - g) / A sums to 1 over a frame that holds all of N: the mean of A times it is 1."""
    motion = make_motion(Motion(random_walk={"sd_px": {"x": 2, "y": 3}}))
    x, y = (g.ravel() for g in np.meshgrid(np.arange(0.5, 200), np.arange(0.5, 160)))
    boxes = np.column_stack([x, y, np.full_like(x, 8.0), np.full_like(x, 8.0)])
    known = AppearanceMemory(
        "1", "t", np.array([100.0, 80, 8, 8]), np.diag([4.0, 1, 0, 0]), 10.0, {}, "birth"
    )
    moves, rule = Confined(motion, 200, 160), Reidentify(frames=50)
    (fading,), (place,), (distance,) = weigh_places([known], moves, boxes, 20.0, 200.0 * 160, rule)
    assert fading == pytest.approx(-0.2)
    assert np.mean(np.exp(place)) == pytest.approx(1.0, abs=1e-6)
    # var 4 + 10 steps of 2^2 + (8 / 4)^2, and 1 + 10 of 3^2 + 4; at the mean itself
    peak = np.exp(-0.2) * 200 * 160 / (2 * np.pi * np.sqrt(48.0 * 95.0)) - np.expm1(-0.2)
    assert np.exp(place.max()) == pytest.approx(peak, rel=0.01)
    assert distance.min() == pytest.approx(np.sqrt(0.5))


def test_looks_are_compared_with_what_is_elsewhere():
    boxes = np.array([[10.0, 10, 4, 4]])
    log_l, random = np.log([0.8]), np.array([[50.0, 50, 4, 4], [60, 60, 4, 4], [10, 10, 4, 4]])
    groups = [(random, np.log([0.1, 0.3, 0.9])), (np.array([[30.0, 30, 4, 4]]), np.log([0.6]))]
    expected = 0.8 / ((1 - LOOKALIKE) * (0.2 + 0.6) / 2 + LOOKALIKE)
    assert weigh_appearance(boxes, log_l, groups)[0] == pytest.approx(np.log(expected))
    assert weigh_appearance(boxes, log_l, [])[0] == pytest.approx(np.log(0.8))


def compared(*odds):
    """Targets "1", "2", ... of these odds in each detection."""
    log, count = np.log(odds), len(odds)
    names = [str(number) for number in range(1, count + 1)]
    nothing = np.zeros(log.shape)
    return Compared(names, np.ones(count), nothing, np.zeros(count), log, nothing, [()] * count)


def test_a_target_is_taken_once_and_what_is_left_is_new():
    found = match(compared([9.0, 6.0], [3.0, 0.5]), Reidentify(min_probability=0.5))
    first, second = found
    assert (first.detection, first.recognition.target, first.is_sure) == (0, "1", True)
    assert first.recognition.probability == pytest.approx(9 / 13) and first.recognition.rival == "2"
    # Target 1 is taken: the other detection is 2 with odds of 1 to 2, and so more probably new.
    assert (second.detection, second.recognition.target, second.is_sure) == (1, "2", False)
    assert second.recognition.probability == pytest.approx(1 / 3) and second.recognition.rival == "new"


@pytest.mark.slow
def test_what_is_not_contested_turns_at_its_probability():
    """Any odds of three targets in three detections, matched again at levels beyond each probability."""
    rng, free = np.random.default_rng(0), 0
    for _ in range(300):
        known = compared(*np.exp(rng.normal(0.0, 2.5, (3, 3))))
        level = float(rng.uniform(0.1, 0.9))
        for one in match(known, Reidentify(min_probability=level)):
            by = one.recognition
            if by.contested:
                continue
            free += 1
            high = by.probability + 1e-9
            levels = np.linspace(high, 1.0, 5) if one.is_sure else np.linspace(by.probability, 1e-3, 5)
            for other in levels[levels > 0.0]:
                again = match(known, Reidentify(min_probability=min(float(other), 1.0)))
                sure = {(two.detection, two.recognition.target) for two in again if two.is_sure}
                assert ((one.detection, by.target) in sure) != one.is_sure
                if one.is_sure:
                    assert one.detection not in dict(sure) and by.target not in dict(sure).values()
    assert free > 300


def test_a_match_is_contested_where_a_better_one_would_come_first():
    """At no level is the second detection target 1: the first one, which has better odds, takes it."""
    first, second = match(compared([9.0, 3.0]), Reidentify(min_probability=0.95))
    assert (first.recognition.contested, second.recognition.contested) == (False, True)
    # Since target 1 is taken, the second is target 2 with a probability of 9 in 10, else of 9 in 18.
    both = compared([20.0, 8.0], [1.0, 9.0])
    first, second = match(both, Reidentify(min_probability=0.3))
    assert (first.recognition.contested, second.recognition.contested) == (False, True)
