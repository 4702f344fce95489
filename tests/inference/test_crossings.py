"""Crossings of a line against enumeration: of paths of particles, and of a chain on cells for Gaussians."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bayesnet_track.belief.asked import GaussianGroup, SingleGroup, WeightedGroup
from bayesnet_track.belief.grid.cells import GridBelief, Lattice
from bayesnet_track.graph.spec import Crossing
from bayesnet_track.inference.crossings import (
    TRACES,
    Sample,
    advance_trail,
    convolved,
    sample_gaussian,
    sample_weighted,
)

FIELDS = ("x", "y", "w", "h")
NONE = np.empty((0, 0))


def line(start="either", hysteresis_px=2.0, ends=((0, 50), (100, 50)), point="center"):
    words = {"line": ends, "from": start, "hysteresis_px": hysteresis_px, "point": point}
    return Crossing.model_validate(words)


def sample(places, weights=None, ancestors=None):
    places = np.asarray(places, dtype=float)
    size = len(places)
    shares = np.full(size, 1 / size) if weights is None else np.asarray(weights, dtype=float)
    return Sample(places, shares, ancestors, np.empty((size, 0)), np.empty(0), NONE)


def follow(crossing, path):
    """The trail of a single hypothesis along a path."""
    trail = None
    for place in path:
        trail = advance_trail(crossing, trail, sample([place], ancestors=np.array([0])), 1.0)
    return trail


@pytest.mark.parametrize(
    ("start", "path", "count"),
    [
        ("either", [(50, 40), (50, 60)], 1),
        ("left", [(50, 40), (50, 60)], 1),  # left of a line to the right is up in the image
        ("right", [(50, 40), (50, 60)], 0),
        ("right", [(50, 60), (50, 40)], 1),
        ("either", [(50, 40), (50, 60), (50, 40)], 2),
        ("left", [(50, 40), (50, 60), (50, 40)], 1),
        ("either", [(50, 40), (50, 51), (50, 49), (50, 51), (50, 60)], 1),  # it hesitates at the line
        ("either", [(50, 40), (50, 51), (50, 40)], 0),  # never surely across
        ("either", [(150, 40), (150, 60)], 0),  # beside the segment
        ("either", [(50, 40), (150, 40), (150, 60), (50, 60)], 0),  # round its end
        ("either", [(90, 40), (104, 60)], 1),  # through the segment near its end
        ("either", [(96, 40), (110, 60)], 0),  # past its end
        ("either", [(50, 50), (50, 60)], 0),  # nobody knows where it came from
        ("either", [(50, 40), (50, 49), (150, 49), (150, 60)], 0),
    ],
)
def test_a_path_crosses_as_often_as_it_is_surely_across(start, path, count):
    assert follow(line(start), path).counts.tolist() == [count]


@pytest.mark.slow
def test_particles_cross_as_all_paths_of_their_ancestors_do():
    rng = np.random.default_rng(4)
    crossing = line("left", hysteresis_px=3.0)
    places = np.stack([rng.uniform(0, 120, 200), rng.uniform(30, 60, 200)], axis=1)
    paths, trail = places[:, None], None
    ancestors = None
    for _ in range(12):
        weights = rng.random(len(places))
        trail = advance_trail(crossing, trail, sample(places, weights / weights.sum(), ancestors), 1.0)
        ancestors = rng.choice(200, 200, p=weights / weights.sum())
        places = paths[ancestors][:, -1] + rng.normal(0, 6, (200, 2))
        paths = np.concatenate([paths[ancestors], places[:, None]], axis=1)
        expected = [follow(crossing, path).counts[0] for path in paths]
        check = advance_trail(crossing, trail, sample(places, None, ancestors), 1.0)
        assert check.counts.tolist() == expected
    assert trail.counts.max() >= 1


class Walk:
    """A random walk of x and y."""

    def __init__(self, sd):
        self.sd = sd

    def drift(self, states, dt):
        return states

    def linearise(self, state, dt):
        return np.eye(len(state)), np.diag([self.sd**2 * dt, self.sd**2 * dt, 0.0, 0.0])


def enumerated(readings, start, motion_sd, reading_sd, crossing):
    """P(it has crossed) after each reading of y, by a chain over cells of y, side and whether it crossed."""
    cells = np.arange(0.0, 100.0, 0.25) + 0.125
    side_of = np.where(np.abs(cells - 50) >= crossing.hysteresis_px, np.sign(cells - 50), 0).astype(int)
    move = np.exp(-0.5 * ((cells[:, None] - cells[None, :]) / motion_sd) ** 2)
    move /= move.sum(axis=0, keepdims=True)
    mass = np.zeros((3, 2, len(cells)))  # side + 1, crossed, cell
    prior = np.exp(-0.5 * ((cells - start) / 1.0) ** 2)
    for side in (-1, 0, 1):
        mass[side + 1, 0] = np.where(side_of == side, prior, 0.0)
    answers = []
    for reading in readings:
        moved = np.einsum("ij,skj->ski", move, mass)
        mass = np.zeros_like(moved)
        for side in (-1, 0, 1):
            for crossed in (0, 1):
                for new in (-1, 0, 1):
                    here = np.where(side_of == new, moved[side + 1, crossed], 0.0)
                    after = side if new == 0 else new
                    is_over = new != 0 and side != 0 and new != side
                    mass[after + 1, 1 if is_over else crossed] += here
        mass *= np.exp(-0.5 * ((cells - reading) / reading_sd) ** 2)
        mass /= mass.sum()
        answers.append(mass[:, 1].sum())
    return answers


def traced(readings, start, motion_sd, reading_sd, crossing, seed):
    """The same of a Kalman filter with draws of its trajectory."""
    mean, covariance = np.array([50.0, start, 10.0, 10.0]), np.diag([1.0, 1.0, 0.0, 0.0])
    rng, trail, answers = np.random.default_rng(seed), None, []
    motion = Walk(motion_sd)
    for reading in (None, *readings):
        if reading is not None:
            spread = covariance + motion.linearise(mean, 1.0)[1]
            gain = spread[:, 1] / (spread[1, 1] + reading_sd**2)
            mean = mean + gain * (reading - mean[1])
            covariance = spread - np.outer(gain, spread[1])
        group = GaussianGroup(["1"], FIELDS, mean[None], covariance[None])
        drawn = sample_gaussian(group, crossing, trail, (motion, 1.0), lambda purpose: rng)
        trail = advance_trail(crossing, trail, drawn, 1.0)
        answers.append(1.0 - trail.distribution[0])
    return answers[1:]


@pytest.mark.parametrize("readings", [[46, 50, 49, 52, 50, 53, 51, 54], [47, 48, 49.5, 50.5, 49, 48, 47, 46]])
def test_a_gaussian_crosses_as_a_chain_over_cells_does(readings):
    """Mean of 20 seeds: 5,120 trajectories, whose error is below .02; one seed is within .1."""
    crossing = line(hysteresis_px=2.0, ends=((-1000, 50), (1000, 50)))
    expected = enumerated(readings, 45.0, 2.0, 2.0, crossing)
    found = np.array([traced(readings, 45.0, 2.0, 2.0, crossing, seed) for seed in range(20)])
    assert 0.03 < max(expected) < 0.99
    assert found.mean(axis=0) == pytest.approx(expected, abs=0.03)
    assert np.abs(found - expected).max() < 0.15


def test_a_grid_crosses_with_its_mass():
    """No ancestors are known: what is across then is what was not before."""
    crossing, trail = line(hysteresis_px=0.5, ends=((-1000, 50), (1000, 50))), None
    for centre, expected in ((44.0, 0.0), (50.0, 0.5), (56.0, 1.0)):
        y = centre + np.arange(-4, 5)
        weights = np.full(9, 1 / 9)
        mass = weights.reshape(1, 1, 1, 9, 1)
        lattice = Lattice((10.0, float(y[0])), 1.0, 0, 0, (8.0, 8.0), np.zeros(1), np.zeros(1))
        belief = GridBelief(mass, lattice, np.ones((1, 1)))
        trail = advance_trail(
            crossing, trail, sample_weighted(SingleGroup(["1"], belief), crossing, None), 1.0
        )
        assert 1.0 - trail.distribution[0] == pytest.approx(expected, abs=0.06)


def test_a_foot_is_the_middle_of_the_lower_edge():
    states = np.array([[[50.0, 40.0, 10.0, 16.0]]])
    group = WeightedGroup(["1"], FIELDS, states, np.ones((1, 1)))
    assert sample_weighted(group, line(point="foot"), None).places.tolist() == [[50.0, 48.0]]


def test_who_may_not_exist_crosses_with_that_probability():
    crossing = line()
    trail = advance_trail(crossing, None, sample([(50, 40)]), 0.2)
    trail = advance_trail(crossing, trail, sample([(50, 60)], ancestors=np.array([0])), 0.8)
    trail = advance_trail(crossing, trail, sample([(50, 70)], ancestors=np.array([0])), 0.1)
    assert trail.distribution == pytest.approx([0.2, 0.8])
    total = convolved(trail.distribution, trail.distribution)
    assert total == pytest.approx([0.04, 0.32, 0.64])


def test_the_trajectory_of_a_known_target_is_known():
    group = GaussianGroup(["1"], FIELDS, np.array([[50.0, 40.0, 9.0, 9.0]]), np.zeros((1, 4, 4)))
    drawn = sample_gaussian(group, line(), None, (Walk(1.0), 1.0), lambda purpose: np.random.default_rng(0))
    assert drawn.places.shape == (TRACES, 2) and math.isclose(drawn.places.std(axis=0).sum(), 0.0)
