"""Inverses of functions, followed from a place that is known, and all places with given values."""

import numpy as np
import pytest

from bayesnet_track.numerics.lenses import derivatives, follow_line, shorter_way, solutions

PERIODS = np.array([np.inf, 2 * np.pi])
LESS = shorter_way(PERIODS)
VARIANCES = np.array([4.0, 1e-4])


def polar(states):
    x, y = states[:, 0] - 40.0, states[:, 1] + 7.0
    return np.stack([np.hypot(x, y), np.arctan2(y, x)], axis=1)


def test_derivatives_are_those_by_hand():
    states = np.array([[50.0, 3.0], [-20.0, 60.0]])
    x, y = states[:, 0] - 40.0, states[:, 1] + 7.0
    r = np.hypot(x, y)
    by_hand = np.stack([np.stack([x / r, y / r], 1), np.stack([-y / r**2, x / r**2], 1)], axis=1)
    assert derivatives(polar, states) == pytest.approx(by_hand, abs=1e-8)


def test_every_range_and_bearing_is_found_from_one_place():
    rng = np.random.default_rng(0)
    z = np.stack([rng.uniform(0.5, 900, 500), rng.uniform(-np.pi, np.pi, 500)], axis=1)
    place = np.array([[90.0, -7.0]])
    values = polar(place)[0]
    states = follow_line(polar, LESS, place[0], values, LESS(z, values), VARIANCES)
    wanted = np.stack([40 + z[:, 0] * np.cos(z[:, 1]), -7 + z[:, 0] * np.sin(z[:, 1])], axis=1)
    assert states == pytest.approx(wanted, abs=1e-6)


def test_what_no_place_has_is_not_found():
    place = np.array([[90.0, -7.0]])
    values = polar(place)[0]
    way = np.array([[-5.0 - values[0], 0.3]])  # a range of -5
    assert np.isnan(follow_line(polar, LESS, place[0], values, way, VARIANCES)).all()


def test_two_ranges_have_two_places():
    def ranges(states):
        return np.stack(
            [np.hypot(states[:, 0] + 10, states[:, 1]), np.hypot(states[:, 0] - 10, states[:, 1])], 1
        )

    found = solutions(ranges, shorter_way(np.full(2, np.inf)), np.array([15.0, 15.0]), np.ones(2))
    assert np.sort(found[:, 1]) == pytest.approx([-np.sqrt(125), np.sqrt(125)])


def test_values_that_no_place_has_have_none():
    def ranges(states):
        return np.stack(
            [np.hypot(states[:, 0] + 10, states[:, 1]), np.hypot(states[:, 0] - 10, states[:, 1])], 1
        )

    assert len(solutions(ranges, shorter_way(np.full(2, np.inf)), np.array([1.0, 1.0]), np.ones(2))) == 0


def test_degrees_have_a_period_of_their_own():
    less = shorter_way(np.array([360.0]))
    assert less(np.array([[359.0]]), np.array([[1.0]])).tolist() == [[-2.0]]
