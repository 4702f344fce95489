"""How often regions cover the truth under each fusion, in a model with a shared latent state.

Per coordinate, in two dimensions: h from its prior (sd 20), c = h + e (sd 6), two colour agents z = c + e
(sd 3 each), an intensity agent z = h + e (sd 6). A region of 50 % or 90 % is the ellipse of the posterior's
mean and covariance. Beliefs hold 1000 hypotheses from the prior.

Coverage counts over R runs are binomial. The expected figures come from a study of as many runs, so a
difference of the two shares has the variance 2 p (1 - p) / R; 3.5 standard deviations are allowed.
"""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track.inference.compile import compile_plan
from bayesnet_track.inference.messages import evaluate
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.observation.cue import Hypotheses

QUANTILE = {0.5: -2.0 * np.log(0.5), 0.9: -2.0 * np.log(0.1)}
"""Of the squared Mahalanobis distance in two dimensions (chi-squared of 2 degrees of freedom)."""

PRIOR, SHARED, COLOR, INTENSITY = 20.0, 6.0, 3.0, 6.0

CORRELATION = SHARED**2 / (SHARED**2 + COLOR**2)
"""Of the errors of both colour agents: what they share of their variance."""


def graph(fuse):
    nodes = {"root": {"fuse": "product"}, "intensity": "root"}
    if fuse == "learned":
        color = {"parent": "root", "fuse": {"pool": "learned"}, "correlation": CORRELATION}
        return {**nodes, "color": color, "hue": "color", "blobs": "color"}
    if fuse == "flat":
        return {**nodes, "hue": "root", "blobs": "root"}
    color = {"parent": "root", "fuse": fuse}
    if fuse != "pool":
        given = {"sd_px": {"x": SHARED, "y": SHARED}}
        if fuse in ("gaussian", "grid"):
            color = {"parent": "root", "fuse": {"latent": {"given": given}}, "belief": fuse}
        else:
            color["fuse"] = {"latent": {"given": given, "draw": fuse}}
    return {**nodes, "color": color, "hue": "color", "blobs": "color"}


def coverage(fakes, fuse, runs, size=1000):
    """Shares of runs whose 50 % and 90 % regions cover h, and mean squared error over mean trace."""
    plate, _ = fakes.plate(graph(fuse))
    # Above the latent state an agent's error includes the shared one: calibrated, not sharp.
    color = np.hypot(SHARED, COLOR) if fuse in ("flat", "pool", "learned") else COLOR
    plan = compile_plan(plate, plate.agents, {a: fakes.Oracle(fakes.flat()) for a in plate.agents})
    rng = np.random.default_rng(1)
    prior = LogWeights.uniform(size)
    inside, squares, traces = [], [], []
    for run in range(runs):
        h = rng.normal(0.0, PRIOR, 2)
        c = h + rng.normal(0.0, SHARED, 2)
        seen = {
            "hue": (c + rng.normal(0.0, COLOR, 2), color),
            "blobs": (c + rng.normal(0.0, COLOR, 2), color),
            "intensity": (h + rng.normal(0.0, INTENSITY, 2), INTENSITY),
        }
        cues = {agent: fakes.Oracle(fakes.gaussian(*z, sd)) for agent, (z, sd) in seen.items()}
        states = rng.normal(0.0, PRIOR, (size, 2))
        boxes = np.hstack([states, np.full((size, 2), 20.0)])
        evidence = evaluate(plan, fakes.observer(cues, seed=run), Hypotheses(boxes), prior.log)
        w = prior.times(evidence.log_likelihood)[0].weights
        away = h - w @ states
        spread = states - w @ states
        covariance = (spread * w[:, None]).T @ spread
        distance = away @ np.linalg.solve(covariance + 1e-9 * np.eye(2), away)
        inside.append([distance < QUANTILE[0.5], distance < QUANTILE[0.9]])
        squares.append(away @ away)
        traces.append(np.trace(covariance))
    return np.mean(inside, axis=0), float(np.mean(squares) / np.mean(traces))


def assert_covers(shares, expected, runs):
    expected = np.array(expected)
    allowed = 3.5 * np.sqrt(2.0 * expected * (1.0 - expected) / runs)
    assert np.all(np.abs(shares - expected) < allowed), (shares, expected, allowed)


@pytest.mark.slow
def test_a_flat_product_is_overconfident(fakes):
    shares, ratio = coverage(fakes, "flat", 1000)
    assert_covers(shares, [0.34, 0.74], 1000)
    assert 1.4 < ratio < 1.85  # 1.62; squared errors in two dimensions, 1000 runs: sd about 0.06


@pytest.mark.slow
def test_a_pool_covers_nearly_what_it_says(fakes):
    shares, ratio = coverage(fakes, "pool", 1000)
    assert_covers(shares, [0.47, 0.87], 1000)
    assert 0.9 < ratio < 1.25  # 1.06


@pytest.mark.slow
def test_a_learned_pool_covers_what_it_says(fakes):
    """Its Gaussian is the exact marginal of h: of 1000 hypotheses 30 are effective, which costs a point."""
    shares, ratio = coverage(fakes, "learned", 1000)
    assert_covers(shares, [0.485, 0.885], 1000)
    assert 0.9 < ratio < 1.2


def test_a_learned_pool_is_the_marginal_of_the_shared_state_exactly(fakes):
    """log N(h; mean of both, shared variance + own variance / 2), but for a constant."""
    plate, _ = fakes.plate(graph("learned"))
    seen = {"hue": (3.0, -1.0), "blobs": (7.0, 2.0)}
    sd = float(np.hypot(SHARED, COLOR))
    cues = {agent: fakes.Oracle(fakes.gaussian(*z, sd)) for agent, z in seen.items()}
    boxes = np.hstack([np.random.default_rng(3).normal(0.0, PRIOR, (50, 2)), np.full((50, 2), 20.0)])
    beta = LogWeights.uniform(50).log
    evidence = evaluate(
        compile_plan(plate, cues, {**cues, "intensity": cues["hue"]}),
        fakes.observer(cues),
        Hypotheses(boxes),
        beta,
    )
    exact = -0.5 * ((boxes[:, :2] - [5.0, 0.5]) ** 2).sum(axis=1) / (SHARED**2 + COLOR**2 / 2)
    assert np.ptp(evidence.messages["color"] - exact) < 1e-10


@pytest.mark.slow
def test_the_latent_kernel_covers_nearly_what_it_says(fakes):
    runs = 400
    shares, ratio = coverage(fakes, "kernel", runs)
    assert_covers(shares, [0.47, 0.84], runs)
    assert 0.85 < ratio < 1.35  # 1.10


@pytest.mark.parametrize("belief", ["gaussian", pytest.param("grid", marks=pytest.mark.slow)])
def test_a_gaussian_or_a_grid_covers_what_the_kernel_does(fakes, belief):
    """O(N) and O(N + G log G): at least the kernel's coverage, at most what the regions say."""
    runs = 300
    shares, ratio = coverage(fakes, belief, runs)
    assert_covers(np.maximum(shares, [0.47, 0.84]), [0.47, 0.84], runs)
    assert_covers(np.minimum(shares, [0.5, 0.9]), [0.5, 0.9], runs)
    assert 0.8 < ratio < 1.35  # squared errors in two dimensions, 300 runs: sd about 0.08


@pytest.mark.slow
def test_one_draw_needs_many_hypotheses(fakes):
    """Its weights are random: 1000 hypotheses leave about ten effective ones here, which is overconfident;
    with thirty times as many the regions cover what they say.
    """
    few, _ = coverage(fakes, "one", 300)
    assert few[0] < 0.5 - 3.5 * np.sqrt(0.25 / 300) and few[1] < 0.9 - 3.5 * np.sqrt(0.09 / 300)
    many, ratio = coverage(fakes, "one", 120, size=30_000)
    assert_covers(many, [0.5, 0.9], 120)
    assert 0.7 < ratio < 1.35
