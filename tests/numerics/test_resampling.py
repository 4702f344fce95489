"""Resampling draws each hypothesis N w times on average, by every scheme."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.numerics.resampling import SCHEMES, resample

WEIGHTS = np.array([0.02, 0.4, 0.0, 0.13, 0.25, 0.2])


def counts(scheme: str, weights: np.ndarray, count: int, seed: int) -> np.ndarray:
    found = resample(scheme, weights, count, np.random.default_rng(seed))
    assert found.dtype == np.int64 and found.shape == (count,)
    return np.bincount(found, minlength=weights.size)


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("count", [1, 7, 50])
def test_every_scheme_is_unbiased(scheme, count):
    runs = 2000
    mean = np.mean([counts(scheme, WEIGHTS, count, seed) for seed in range(runs)], axis=0)
    # No scheme has a larger variance than the binomial; 4.5 sd over 72 comparisons.
    sd = np.sqrt(count * WEIGHTS * (1 - WEIGHTS) / runs)
    assert np.all(np.abs(mean - count * WEIGHTS) <= 4.5 * sd)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_spread_is_what_the_scheme_promises(scheme):
    """Variance of the count of a hypothesis with N w = 10.5: binomial, or that of one coin flip."""
    weights = np.array([0.21, 0.5, 0.29])
    drawn = np.array([counts(scheme, weights, 50, seed)[0] for seed in range(3000)])
    binomial = 50 * 0.21 * 0.79
    # The sample variance of 3000 near-Gaussian counts has a relative sd of sqrt(2 / 3000) = 2.6 %.
    if scheme == "multinomial":
        assert drawn.var() == pytest.approx(binomial, rel=0.12)
    else:
        assert 0.2 < drawn.var() < 0.6


@given(
    st.lists(st.floats(0, 1), min_size=1, max_size=40).filter(lambda w: sum(w) > 1e-3),
    st.integers(1, 200),
    st.integers(0, 2**32 - 1),
)
def test_systematic_is_within_one_of_its_expectation(raw, count, seed):
    weights = np.array(raw) / np.sum(raw)
    drawn = counts("systematic", weights, count, seed)
    assert np.all(np.abs(drawn - count * weights) < 1 + 1e-9)


@given(
    st.sampled_from(sorted(SCHEMES)),
    st.lists(st.floats(0, 1), min_size=1, max_size=40).filter(lambda w: sum(w) > 1e-3),
    st.integers(1, 100),
    st.integers(0, 2**32 - 1),
)
def test_a_weight_of_zero_is_never_drawn(scheme, raw, count, seed):
    weights = np.array(raw) / np.sum(raw)
    drawn = counts(scheme, weights, count, seed)
    assert drawn.sum() == count
    assert np.all(drawn[weights == 0] == 0)


class TopOfTheUnitInterval:
    """A generator whose uniform draws are the largest double below 1."""

    def random(self):
        return np.nextafter(1.0, 0.0)

    def standard_exponential(self, size):
        return np.r_[np.ones(size - 1), 0.0]


@pytest.mark.parametrize("scheme", SCHEMES)
def test_index_stays_in_range_when_the_cumulative_sum_ends_below_one(scheme):
    weights = np.r_[np.full(10, 0.1), 0.0]
    assert np.cumsum(weights)[-1] < 1.0
    assert resample(scheme, weights, 33, TopOfTheUnitInterval()).max() == 9


def test_an_unknown_scheme_names_the_known_ones():
    with pytest.raises(ValueError, match="one of systematic, multinomial"):
        resample("stratifed", WEIGHTS, 3, np.random.default_rng(0))
