"""Rows of beliefs against the same thing done one by one."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.numerics.log_weights import LogWeights, divergences, kl, tilt


def case(seed, rows=5, size=30):
    rng = np.random.default_rng(seed)
    prior = LogWeights.normalise(rng.normal(0, 2, size))[0]
    likelihoods = rng.uniform(-40.0, 0.0, (rows, size))
    likelihoods[rng.random((rows, size)) < 0.2] = -np.inf
    return prior, likelihoods


@given(st.integers(0, 10_000))
def test_rows_are_beliefs_one_by_one(seed):
    prior, likelihoods = case(seed)
    for row, likelihood in zip(tilt(prior.log, likelihoods), likelihoods, strict=True):
        np.testing.assert_allclose(row, prior.times(likelihood)[0].log, rtol=1e-12, atol=1e-12)


@given(st.integers(0, 10_000))
def test_divergences_are_those_one_by_one(seed):
    prior, likelihoods = case(seed)
    rows = tilt(prior.log, likelihoods)
    for f, g in ((rows[0], rows), (rows, prior.log), (rows, rows[::-1])):
        expected = [
            kl(*pair)
            for pair in zip(np.broadcast_to(f, rows.shape), np.broadcast_to(g, rows.shape), strict=True)
        ]
        np.testing.assert_allclose(divergences(f, g), expected, rtol=1e-10, atol=1e-12)


def test_a_likelihood_that_leaves_nothing_says_nothing():
    prior = LogWeights.normalise(np.log([0.2, 0.3, 0.5]))[0]
    rows = tilt(
        prior.log, np.array([[-np.inf] * 3, [0.0, np.nan, 0.0], [0.0, np.inf, 0.0], [0.0, 0.0, -1e9]])
    )
    np.testing.assert_allclose(rows[:3], np.tile(prior.log, (3, 1)))
    np.testing.assert_allclose(np.exp(rows[3]), [0.4, 0.6, 0.0], atol=1e-12)


def test_no_row_at_all():
    prior = LogWeights.uniform(4)
    assert tilt(prior.log, np.empty((0, 4))).shape == (0, 4)
    assert divergences(np.empty((0, 4)), prior.log).shape == (0,)
