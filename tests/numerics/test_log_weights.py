"""Log-weights stay normalised whatever the scale, and refuse what says nothing."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from bayesnet_track.numerics.log_weights import DegenerateWeights, LogWeights

log_values = st.one_of(st.floats(-800, 800), st.just(-np.inf))
unnormalised = hnp.arrays(np.float64, st.integers(1, 30), elements=log_values).filter(
    lambda a: np.any(a > -np.inf)
)


@given(unnormalised)
def test_weights_sum_to_one(log):
    weights, total = LogWeights.normalise(log)
    assert weights.weights.sum() == pytest.approx(1, abs=1e-12)
    assert np.logaddexp.reduce(log) == pytest.approx(total, abs=1e-9)
    assert np.array_equal(np.isneginf(weights.log), np.isneginf(log))


@given(unnormalised, st.floats(-700, 700))
def test_a_common_factor_moves_the_total_and_nothing_else(log, shift):
    weights, total = LogWeights.normalise(log)
    shifted, shifted_total = LogWeights.normalise(log + shift)
    np.testing.assert_allclose(shifted.log, weights.log, atol=1e-9)
    assert shifted_total == pytest.approx(total + shift, abs=1e-9)
    assert shifted.ess == pytest.approx(weights.ess, rel=1e-9)


@given(unnormalised)
def test_effective_sample_size_is_between_one_and_n(log):
    weights, _ = LogWeights.normalise(log)
    assert 1 - 1e-9 <= weights.ess <= len(weights) * (1 + 1e-9)
    assert weights.ess == pytest.approx(1 / np.sum(weights.weights**2), rel=1e-9)


@given(st.integers(1, 1000))
def test_equal_weights_have_the_whole_effective_sample_size(size):
    assert LogWeights.uniform(size).ess == pytest.approx(size)


@pytest.mark.parametrize("scale", [1e-300, 1.0, 1e300])
def test_likelihoods_of_any_magnitude(scale):
    weights, total = LogWeights.uniform(3).times(np.log(scale * np.array([1.0, 2.0, 5.0])))
    np.testing.assert_allclose(weights.weights, [0.125, 0.25, 0.625], rtol=1e-12)
    assert total == pytest.approx(np.log(scale) + np.log(8 / 3), rel=1e-12)


@given(unnormalised, st.data())
def test_times_is_bayes_rule(log, data):
    prior, _ = LogWeights.normalise(log)
    likelihood = data.draw(hnp.arrays(np.float64, len(log), elements=st.floats(0.001, 1)))
    posterior, evidence = prior.times(np.log(likelihood))
    product = prior.weights * likelihood
    np.testing.assert_allclose(posterior.weights, product / product.sum(), atol=1e-12)
    assert evidence == pytest.approx(np.log(product.sum()), abs=1e-9)


@pytest.mark.parametrize("bad", [[-np.inf, -np.inf], [0.0, np.nan], [0.0, np.inf], []])
def test_weights_that_say_nothing_are_refused(bad):
    with pytest.raises(DegenerateWeights):
        LogWeights.normalise(np.array(bad, dtype=float))


def test_a_belief_needs_a_hypothesis():
    with pytest.raises(ValueError, match="at least one"):
        LogWeights.uniform(0)


def test_weights_cannot_be_changed_in_place():
    with pytest.raises(ValueError, match="read-only"):
        LogWeights.uniform(3).log[0] = 0.0
