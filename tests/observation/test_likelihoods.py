"""What cues share: the logistic of a distance, the size penalty, the floor, blends."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track import floored
from bayesnet_track.observation.cue import blend_arrays, blend_sizes, log_logistic, log_size_penalty

ratios = st.floats(0.1, 10.0)


@given(st.floats(0.0, 5.0), st.floats(0.0, 5.0), st.floats(0.01, 2.0))
def test_a_logistic_is_best_at_distance_0_and_falls(near, far, halved_at):
    log = log_logistic(np.array([0.0, min(near, far), max(near, far)]), halved_at)
    assert log[0] == 0.0 and log[0] >= log[1] >= log[2]


def test_a_logistic_is_half_of_its_height_at_the_given_distance():
    """1 / 2 over 1 / (1 + e^-4)."""
    assert np.exp(log_logistic(np.array([0.3]), 0.3))[0] == pytest.approx(0.5 * (1 + np.exp(-4.0)))


@given(ratios, ratios)
def test_a_size_and_its_inverse_cost_the_same(across, down):
    size = np.array([30.0, 20.0])
    boxes = np.array([[0, 0, 30 * across, 20 * down], [9, 9, 30 / across, 20 / down], [5, 5, 30, 20]])
    log = log_size_penalty(boxes, size)
    assert log[0] == pytest.approx(log[1], abs=1e-9) and log[0] <= log[2] == 0.0


@given(st.floats(-50.0, 0.0), st.floats(0.001, 0.9))
def test_a_floor_is_reached_from_above_and_a_perfect_match_stays(log, floor):
    found = floored(np.array([log, 0.0]), floor)
    assert np.log(floor) <= found[0] + 1e-12 and found[0] <= 0.0 and found[1] == 0.0


@given(ratios, st.floats(0.0, 1.0))
def test_blends_go_from_the_old_to_the_new(ratio, rate):
    old, new = {"size": np.array([10.0])}, {"size": np.array([10.0 * ratio])}
    assert blend_arrays(old, new, rate)["size"][0] == pytest.approx(10 + rate * (10 * ratio - 10))
    assert blend_sizes(old, new, rate)[0] == pytest.approx(10 * ratio**rate)
