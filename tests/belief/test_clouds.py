"""The particles of many targets as arrays: the same bytes as each target's own."""

import numpy as np

from bayesnet_track.belief.particles.particle_set import Clouds, ParticleSet, some
from bayesnet_track.numerics.log_weights import LogWeights

FIELDS = ("x", "y", "w", "h", "vx")


def beliefs(count=5, size=33):
    rng = np.random.default_rng(0)
    return [
        ParticleSet(rng.normal(size=(size, 5)), FIELDS, LogWeights.normalise(rng.normal(size=size))[0])
        for _ in range(count)
    ]


def test_rows_hold_what_the_beliefs_held():
    own = beliefs()
    for clouds in (Clouds.of(own), Clouds.of(own[:2]).extended(Clouds.of(own[2:]))):
        assert len(clouds) == len(own)
        for row, one in enumerate(own):
            found = clouds.belief(row)
            assert found.states.tobytes() == one.states.tobytes() and found.fields == FIELDS
            assert found.weights.log.tobytes() == one.weights.log.tobytes()
            assert found.weights.weights.tobytes() == one.weights.weights.tobytes()
            assert clouds.means[row].tobytes() == one.mean.tobytes()
            assert clouds.covariances[row].tobytes() == one.covariance.tobytes()
            means, variances = clouds.box_moments
            np.testing.assert_allclose(means[row], one.mean[:4], rtol=1e-13)
            np.testing.assert_allclose(variances[row], one.covariance.diagonal()[:4], rtol=1e-13)
            assert not found.weights.log.flags.writeable and clouds.log.flags.writeable


def test_some_rows_are_those_and_the_first_are_not_copied():
    clouds = Clouds.of(beliefs())
    assert np.shares_memory(clouds.take([0, 1]).states, clouds.states)
    assert clouds.take([3, 1]).states.tobytes() == clouds.states[some([3, 1])].tobytes()
