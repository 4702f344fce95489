"""Reappearing anywhere: densities, draws, and evidence that stays unbiased wherever hypotheses are drawn."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import integrate, stats

from bayesnet_track.belief.contract import Evidence
from bayesnet_track.belief.motion.borders import Confined
from bayesnet_track.belief.motion.jumps import Jumping, Places, Search, Within
from bayesnet_track.belief.particles.belief import ParticleFilter, ParticleSet
from bayesnet_track.graph import spec
from bayesnet_track.journal.events.beliefs import Reappeared
from bayesnet_track.numerics.log_weights import LogWeights

WIDTH, HEIGHT = 121, 91
AREA = 120.0 * 90.0
BOX = np.array([30.0, 40.0, 20.0, 12.0])
TRUE = np.array([95.0, 20.0])
R = 4.0
NONE = (np.empty((0, 4)), np.empty(0))
AT_BOX = (np.array([[90.0, 25.0, 24.0, 30.0], [20.0, 80.0, 30.0, 40.0]]), np.array([0.9, 0.3]))
SEARCHES = {
    "uniform": Search(0.3, "uniform", 0, *NONE, 900.0, 100.0),
    "agents": Search(0.3, "agents", 60, *NONE, 900.0, 100.0),
    "boxes": Search(0.3, "color_backprojection", 0, *AT_BOX, 900.0, 100.0),
    "few": Search(0.3, "agents", 16, *NONE, 900.0, 100.0),
}
PART = Within(np.array([20.0, 0.0]), np.array([110.0, 60.0]), np.array([10.0, 6.0]), 60.0)


@pytest.fixture
def jumping(motion_of):
    def make(share=0.2, search="uniform", kind="random_walk", within=None, **settings):
        walk = motion_of(kind, **(settings or {"sd_px": {"x": 3.0, "y": 2.0}}))
        return Jumping(walk, share, WIDTH, HEIGHT, SEARCHES[search], within)

    return make


def near(hypotheses, log_prior):
    """Evidence of a centre at TRUE, at most 1; an outlier's share keeps the rest from being impossible."""
    away = (hypotheses.boxes[:, :2] - TRUE) / R
    return Evidence(np.logaddexp(-0.5 * np.sum(away**2, axis=1), np.log(1e-4)))


def mean_of_near(x_low, x_high, y_low, y_high):
    """Mean of the likelihood over a rectangle."""
    mass = 2 * np.pi * R**2
    for low, high, centre in ((x_low, x_high, TRUE[0]), (y_low, y_high, TRUE[1])):
        mass *= np.diff(stats.norm(centre, R).cdf([low, high]))[0]
    # logaddexp of both terms is their sum.
    return mass / ((x_high - x_low) * (y_high - y_low)) + 1e-4


def test_the_density_integrates_to_one(jumping):
    motion, old = jumping(0.3), BOX[None] + [30.0, 5.0, 0.0, 0.0]

    def density(y, x):
        return float(np.exp(motion.log_density(np.array([[x, y, *BOX[2:]]]), old, 1.0))[0, 0])

    x, y = np.arange(0.25, 120, 0.5), np.arange(0.25, 90, 0.5)
    points = np.stack(
        [*(axis.ravel() for axis in np.meshgrid(x, y)), *np.full((2, len(x) * len(y)), 9.0)], axis=1
    )
    total = 0.25 * np.exp(motion.log_density(points, old, 1.0)).sum()
    # The midpoint rule is exact to 1e-9 for sds of 2 cells and more; flat is flat to 1e-4 of 0.3.
    assert total == pytest.approx(1.0, abs=1e-4)
    corner = integrate.dblquad(density, 90, 120, 60, 90, epsabs=1e-10)[0]
    assert corner == pytest.approx(0.3 * 900.0 / AREA, rel=2e-4)


def test_draws_have_the_density(jumping, rng):
    motion, size = jumping(0.4), 4000
    drawn = motion.propagate(np.tile(BOX, (size, 1)), 1.0, rng)
    for column, sd, length in ((0, 3.0, 120.0), (1, 2.0, 90.0)):
        walk = stats.norm(BOX[column], sd)

        def cdf(x, walk=walk, length=length):
            return 0.6 * walk.cdf(x) + 0.4 * np.clip(x / length, 0, 1)

        assert stats.kstest(drawn[:, column], cdf).pvalue > 1e-3
    np.testing.assert_array_equal(drawn[:, 2:], np.tile(BOX[2:], (size, 1)))


def test_the_density_of_a_jump_keeps_velocity_and_size(jumping):
    """With correlated noise of position and velocity: p(jump) is uniform times the motion's marginal."""
    motion = jumping(
        0.3, kind="constant_velocity", sd_velocity_px=1.5, sd_px={"x": 1.0, "y": 1.0, "w": 0.5, "h": 0.4}
    )
    old = np.r_[BOX, 1.0, -2.0][None]
    moves, noise = motion.linearise(old[0], 1.0)
    far = np.r_[110.0, 80.0, BOX[2:] + [0.3, -0.2], 1.5, -1.0]
    rest = [2, 3, 4, 5]
    marginal = stats.multivariate_normal((moves @ old[0])[rest], noise[np.ix_(rest, rest)]).logpdf(far[rest])
    assert motion.log_density(far[None], old, 1.0)[0, 0] == pytest.approx(
        np.log(0.3 / AREA) + marginal, abs=2e-4
    )


def test_places_are_a_density_of_their_draws(rng):
    places = Places(
        np.array([[0.0, 0.0], [5.0, 2.0]]), np.array([[10.0, 10.0], [9.0, 4.0]]), np.array([0.3, 0.7])
    )
    points = places.draw(20_000, rng)
    inside = ((points >= [5.0, 2.0]) & (points < [9.0, 4.0])).all(axis=1)
    exact = 0.7 + 0.3 * 8.0 / 100.0
    assert abs(inside.mean() - exact) < 5 * np.sqrt(exact * (1 - exact) / 20_000)
    # E 1/q over the draws is the area.
    found = 1.0 / places.density(points)
    assert abs(found.mean() - 100.0) < 5 * found.std() / np.sqrt(20_000)


def one_step(motion, stream, weights=None, size=200):
    weights = LogWeights.uniform(size) if weights is None else weights
    states = np.tile(BOX, (size, 1))
    states[:, 0] += np.linspace(-5, 5, size)
    belief = ParticleFilter(spec.Particles(size=size, when=spec.EssBelow(ess_below=1e-6)))
    prior = ParticleSet(states, motion.fields, weights)
    return belief.step(prior, Confined(motion, WIDTH, HEIGHT), 1.0, near, stream)


@pytest.mark.slow
@pytest.mark.parametrize("within", [None, PART], ids=["anywhere", "part"])
@pytest.mark.parametrize("search", sorted(SEARCHES))
def test_the_evidence_is_unbiased(jumping, stream_of, search, within):
    motion = jumping(0.05, search, within=within)
    low, high = ([0, 0], [120, 90]) if within is None else (within.low, within.high)
    weights = LogWeights.normalise(np.linspace(0.0, 2.0, 200))[0]
    steps = [one_step(motion, stream_of(seed, 1), weights) for seed in range(300)]
    found = np.exp([step.log_evidence for step in steps])
    # The mean of what is searched, and the walk's: far from TRUE, only the outliers' share.
    exact = 0.05 * mean_of_near(low[0], high[0], low[1], high[1]) + 0.95 * 1e-4
    assert abs(found.mean() - exact) < 4 * found.std(ddof=1) / np.sqrt(300)
    # The posterior's mean is that by enumeration, as a ratio of two sums: the target is where it is.
    shares = [step.posterior.mass_within(TRUE, 3 * R)[0] for step in steps]
    masses = np.exp([step.log_evidence for step in steps]) * shares
    area = np.prod(np.subtract(high, low))
    inside = 0.05 / area * (2 * np.pi * R**2 * (1 - np.exp(-4.5)) + 1e-4 * np.pi * (3 * R) ** 2)
    assert abs(masses.mean() - inside) < 4 * masses.std(ddof=1) / np.sqrt(300)


def test_what_jumps_stays_in_the_part_that_is_searched_and_is_as_large_as_it_was(jumping, stream_of):
    motion = jumping(0.05, "few", within=PART)
    states = one_step(motion, stream_of(3, 1)).posterior.states
    jumped = states[np.hypot(states[:, 0] - BOX[0], states[:, 1] - BOX[1]) > 25.0]
    assert len(jumped) > 20
    assert ((jumped[:, :2] >= PART.low) & (jumped[:, :2] <= PART.high)).all()
    np.testing.assert_allclose(jumped[:, 2:], np.tile(PART.size, (len(jumped), 1)))


def test_looking_where_agents_see_something_costs_fewer_hypotheses(jumping, stream_of):
    spread = {
        search: np.std(
            [one_step(jumping(0.05, search), stream_of(seed, 1)).log_evidence for seed in range(60)]
        )
        for search in SEARCHES
    }
    assert spread["agents"] < 0.5 * spread["uniform"]
    assert spread["boxes"] < 0.7 * spread["uniform"]


def test_a_jump_that_holds_the_belief_is_told_and_the_map_counts_its_prior(jumping, stream_of):
    step = one_step(jumping(0.05, "agents"), stream_of(3, 1))
    (report,) = step.reports
    event = report(7, "1")
    assert isinstance(event, Reappeared)
    assert (event.frame, event.target, event.by, event.hypotheses) == (7, "1", "agents", 60)
    assert np.hypot(event.x - TRUE[0], event.y - TRUE[1]) < R
    assert np.hypot(*(step.map_state[:2] - TRUE)) < R
    # With a prior of exactly `turning` they would hold half.
    again = jumping(event.turning, "agents")
    halved = one_step(again, stream_of(3, 1))
    assert not halved.reports or halved.reports[0](7, "1").held == pytest.approx(0.5, abs=1e-6)
    slightly = one_step(jumping(1.01 * event.turning, "agents"), stream_of(3, 1))
    assert slightly.reports[0](7, "1").held == pytest.approx(0.5025, abs=1e-3)


def test_nothing_is_told_while_the_motion_explains_the_frame(jumping, stream_of):
    motion = jumping(0.05, "agents")

    def stays(hypotheses, log_prior):
        return Evidence(-0.5 * np.sum((hypotheses.boxes[:, :2] - BOX[:2]) ** 2, axis=1))

    prior = ParticleSet(np.tile(BOX, (200, 1)), motion.fields, LogWeights.uniform(200))
    step = ParticleFilter(spec.Particles(size=200)).step(
        prior, Confined(motion, WIDTH, HEIGHT), 1.0, stays, stream_of(0, 1)
    )
    assert step.reports == ()
    assert len(step.posterior) == 200
