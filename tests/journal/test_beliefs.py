"""Sentences of beliefs name the level that would have prevented what happened, on the right side of it."""

from __future__ import annotations

import re

import pytest

from bayesnet_track.journal.events.beliefs import BeliefReset, MeasurementGated


@pytest.mark.parametrize("gamma", [0.0123456, 0.0499996])
def test_the_level_that_spares_a_belief_is_no_larger_than_its_gamma(gamma):
    sentence = BeliefReset(7, "1", gamma, 0.05, "belief", 400.0, "reset").describe()
    assert 0 < float(re.search(r"would not have happened at below ≤ (\S+)", sentence)[1]) <= gamma


@pytest.mark.parametrize("turning", [0.991, 0.9999912345])
def test_the_gate_that_lets_a_measurement_pass_is_no_smaller_than_it_must_be(turning):
    sentence = MeasurementGated(7, "1", "place", 21.0, 9.21, 0.99, 2, turning, 0).describe()
    assert turning <= float(re.search(r"used at gate ≥ (\S+)", sentence)[1]) < 1
    assert "nothing else was measured" in sentence
