"""Mixtures of Gaussians against SciPy, and quantiles against the distribution that they belong to."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from bayesnet_track.numerics.density import mixture_quantiles

LEVELS = np.array([0.05, 0.25, 0.75, 0.95])


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=30),
    st.floats(1e-3, 1e2),
    st.floats(1e-3, 1e4),
    st.floats(0, 1),
)
def test_so_much_mass_lies_below_a_quantile(points, near, far, share):
    found = mixture_quantiles([points], (near, far), (share, 1 - share), LEVELS)[0]
    # Where a quantile is not exact to the last bit, the mass within that rounding may lie on either side.
    slack = 1e-4 * max(near, far) + 1e-5 * np.ptp(points) + 1e-9

    def below(x):
        centred = x[:, None] - np.array(points)
        return share * norm.cdf(centred / near).mean(1) + (1 - share) * norm.cdf(centred / far).mean(1)

    assert (below(found - slack) <= LEVELS + 2e-7).all()
    assert (below(found + slack) >= LEVELS - 2e-7).all()


def test_each_row_is_a_mixture_of_its_own():
    rows = np.array([[0.0, 1.0, 5.0], [100.0, 101.0, 90.0]])
    both = mixture_quantiles(rows, (1.0, 9.0), (0.7, 0.3), LEVELS)
    for k in range(2):
        assert np.allclose(both[k], mixture_quantiles(rows[k], (1.0, 9.0), (0.7, 0.3), LEVELS)[0], atol=1e-3)
