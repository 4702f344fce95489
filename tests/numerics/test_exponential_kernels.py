"""The exponential without a call against NumPy's."""

import numpy as np

from bayesnet_track.numerics.compiled import compiled
from bayesnet_track.numerics.kernels.joint_kernels import LARGEST, exp_of


@compiled
def exponentials(values):
    found = np.empty(values.shape[0])
    for n in range(values.shape[0]):
        found[n] = exp_of(values[n])
    return found


def test_it_is_within_two_units_in_the_last_place():
    rng = np.random.default_rng(0)
    values = np.concatenate([rng.uniform(-LARGEST, LARGEST, 20_000), rng.normal(0, 2, 20_000), [0.0, -0.0]])
    found, expected = exponentials(values), np.exp(values)
    assert (np.abs(found - expected) <= 2 * np.spacing(expected)).all()
    assert found[-2:].tolist() == [1.0, 1.0]


def test_beyond_its_bound_it_is_that_of_the_bound():
    far = np.array([-np.inf, -1e9, -701.0, 701.0, 1e9, np.inf])
    expected = np.exp(np.clip(far, -LARGEST, LARGEST))
    np.testing.assert_allclose(exponentials(far), expected, rtol=1e-15)
