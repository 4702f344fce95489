"""The mass of a belief around a point: every representation against draws of its own, and closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bayesnet_track.belief.contract import BOX_FIELDS
from bayesnet_track.belief.gaussian.belief import GaussianPosterior
from bayesnet_track.belief.grid.cells import GridBelief, Lattice
from bayesnet_track.belief.particles.particle_set import ParticleSet
from bayesnet_track.numerics.log_weights import LogWeights

MEAN = np.array([50.0, 40.0, 20.0, 20.0])


def particles():
    rng = np.random.default_rng(4)
    states = np.column_stack([MEAN[:2] + rng.normal(0, [6, 3], (20_000, 2)), np.full((20_000, 2), 20.0)])
    return ParticleSet(states, BOX_FIELDS, LogWeights.uniform(20_000))


def gaussian():
    return GaussianPosterior(MEAN, np.diag([36.0, 9.0, 0.0, 0.0]), BOX_FIELDS, 100)


def grid():
    lattice = Lattice((50.0, 40.0), 1.0, -40, -40, (20.0, 20.0), np.zeros(1), np.zeros(1))
    cells = np.arange(-40, 41)
    x, y = np.exp(-0.5 * (cells / 6.0) ** 2), np.exp(-0.5 * (cells / 3.0) ** 2)
    mass = np.outer(y, x)[None, None, None]
    return GridBelief(mass / mass.sum(), lattice, np.ones((1, 1)))


@pytest.mark.parametrize("make", [particles, gaussian, grid])
@pytest.mark.parametrize(
    ("centre", "radius"), [((50.0, 40.0), 5.0), ((53.0, 38.0), 8.0), ((90.0, 40.0), 4.0)]
)
def test_the_same_density_holds_the_same_mass(make, centre, radius):
    """Against 200,000 draws of the density; 5 standard errors, and what the edge of a disc of cells takes."""
    belief = make()
    draws = np.array([50.0, 40.0]) + np.random.default_rng(9).normal(0, [6, 3], (200_000, 2))
    expected = np.mean(np.hypot(*(draws - centre).T) <= radius)
    share, trials = belief.mass_within(np.array(centre), radius)
    size = 20_000 if make is particles else 200_000
    assert share == pytest.approx(expected, abs=5 * 0.5 / math.sqrt(size) + (0.02 if make is grid else 0.0))
    assert trials == (pytest.approx(20_000) if make is particles else math.inf)
    assert belief.mass_within(np.array(centre), 1e4)[0] == pytest.approx(1.0)


def test_trials_are_the_effective_hypotheses():
    states = np.repeat(MEAN[None], 3, axis=0)
    states[2, 0] += 100.0
    weights, _ = LogWeights.normalise(np.log([0.5, 0.25, 0.25]))
    share, trials = ParticleSet(states, BOX_FIELDS, weights).mass_within(MEAN[:2], 10.0)
    assert share == pytest.approx(0.75) and trials == pytest.approx(1 / (0.25 + 2 / 16))
