"""Maximum evidence of a motion: the evidence is exact, and what boxes were drawn with is found again."""

from itertools import pairwise, product

import numpy as np
import pytest
from scipy import stats

from bayesnet_track.belief.motion.models import make_motion
from bayesnet_track.engine.simulating import Simulation, simulate
from bayesnet_track.evaluate.motion_evidence import Hypothesis, log_evidence
from bayesnet_track.evaluate.motion_fit import (
    ERRORS,
    MotionFitError,
    fit_motion,
    fitted_parameters,
    with_value,
)
from bayesnet_track.graph.checks.run import check
from bayesnet_track.graph.spec import Motion
from bayesnet_track.graph.text.load import read_graph

GRAPH = """\
bayesnet: 1
name: moves
targets:
  ball:
    nodes:
      ball:
        belief: particles
        motion: MOTION
        MODES
      gray: {parent: ball, agent: intensity}
"""
VELOCITY = "{constant_velocity: {sd_velocity_px: 1.5, start_velocity_sd_px: 3}}"
BOX = np.array([5000.0, 4000.0, 60.0, 40.0])


def plate(motion, modes=""):
    return check(*read_graph(GRAPH.replace("MOTION", motion).replace("MODES", modes), "g.yaml")).targets[
        "ball"
    ]


def root_of(motion, modes=""):
    return plate(motion, modes).inference("ball")


def scene(motion, seed, frames=400, error=2.0, modes="", draws=1):
    """The first of several trajectories; in each frame a whole number of them moves by a heavy tail."""
    drawn = simulate(plate(motion, modes), {}, BOX, Simulation(frames, draws, seed)).boxes[:, 0]
    return drawn + np.random.default_rng(seed).normal(0, error, drawn.shape)


def test_the_evidence_is_that_of_the_joint_gaussian():
    motion = make_motion(
        Motion.model_validate(
            {
                "constant_velocity": {
                    "sd_velocity_px": 1.5,
                    "start_velocity_sd_px": 3,
                    "sd_px": {"x": 1, "y": 0.5, "w": 2},
                }
            }
        )
    )
    boxes = np.random.default_rng(0).normal(0, 5, (5, 4)) + BOX
    boxes[2] = np.nan
    found = log_evidence(boxes, [Hypothesis((motion,), None, (2.0, 1.0))])[0]
    expected = 0.0
    move = np.array([[1.0, 1.0], [0.0, 1.0]])
    for column, error, own in ((0, 2.0, 1.0), (1, 2.0, 0.25)):
        noise = 1.5**2 * np.array([[1 / 3, 1 / 2], [1 / 2, 1]]) + np.diag([own, 0])
        expected += joint(boxes[:, column], move, noise, np.diag([error**2, 9.0]), error)
    walk = np.eye(2)
    expected += joint(boxes[:, 2], walk, np.diag([4.0, 0]), np.diag([1.0, 0]), 1.0)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def joint(values, move, noise, start, error):
    """Log density of a field's measured values given the first, from the covariance of them all."""
    size, states = len(values), [start]
    cov = np.zeros((size, size))
    for _ in range(size - 1):
        states.append(move @ states[-1] @ move.T + noise)
    for i in range(size):
        for j in range(i, size):
            cov[i, j] = cov[j, i] = (states[i] @ np.linalg.matrix_power(move.T, j - i))[0, 0]
    cov += error**2 * np.eye(size)
    seen = [k for k in range(1, size) if np.isfinite(values[k])]
    return stats.multivariate_normal(np.full(len(seen), values[0]), cov[np.ix_(seen, seen)]).logpdf(
        values[seen]
    )


def test_regimes_are_exact_over_three_frames_and_close_over_eight():
    """Against the enumeration of every sequence of regimes, which are merged from the third frame on."""
    settings = {"random_walk": {"sd_px": {"x": 2, "y": 2}, "heavy_tail": {"weight": 0.3, "factor": 5}}}
    motion = make_motion(Motion.model_validate(settings))
    moved = np.random.default_rng(0).normal(0, [6.0, 3.0], (8, 2)).cumsum(axis=0)
    boxes = BOX + np.pad(moved, ((0, 0), (0, 2)))
    for frames, tolerance in ((2, 1e-9), (3, 1e-9), (8, 0.01)):
        found = log_evidence(boxes[:frames], [Hypothesis((motion,), None, (1.0, 1.0))])[0]
        each = []
        for factors in product((1, 5), repeat=frames - 1):
            shares = sum(np.log(0.7 if factor == 1 else 0.3) for factor in factors)
            each.append(shares + sum(walk_density(boxes[:frames, axis], 2.0, factors) for axis in (0, 1)))
        np.testing.assert_allclose(found, np.logaddexp.reduce(each), atol=tolerance)


def walk_density(values, sd, factors):
    """Log density of a random walk's values, measured with an error of 1, given the first."""
    steps = np.cumsum((sd * np.array(factors, dtype=float)) ** 2)
    covariance = 1.0 + np.minimum.outer(steps, steps) + np.eye(len(steps))
    return stats.multivariate_normal(np.full(len(steps), values[0]), covariance).logpdf(values[1:])


def test_the_evidence_of_a_long_track_is_that_on_a_grid():
    """Rounding errors, which used to double in every frame, do not add up over 400 of them."""
    rng = np.random.default_rng(9000)
    sd, weight, factor, error = 0.1 * np.sqrt(60 * 40), 0.3, 6.0, 2.0
    tails = np.where(rng.random((400, 1)) < weight, factor, 1.0)
    place = np.vstack([np.zeros(2), np.cumsum(tails * sd * rng.normal(size=(400, 2)), axis=0)])
    boxes = BOX + np.pad(place + error * rng.normal(size=place.shape), ((0, 0), (0, 2)))
    noise = {"sd_box": {"x": 0.1, "y": 0.1}, "heavy_tail": {"weight": weight, "factor": factor}}
    motion = make_motion(Motion.model_validate({"random_walk": noise}))
    found = log_evidence(boxes, [Hypothesis((motion,), None, (error, error))])[0]
    expected = evidence_on_a_grid(boxes[:, :2], sd, {1.0: 1 - weight, factor: weight}, error)
    np.testing.assert_allclose(found, expected, atol=1e-3)


def evidence_on_a_grid(points, sd, tails, error):
    """Log-evidence of a random walk in two dimensions: its density at points around each measured one."""
    offsets = np.arange(-14.0, 14.1, 0.7)
    seen = stats.norm.pdf(offsets, 0, error) * 0.7
    seen = np.outer(seen, seen)
    density, total = seen / seen.sum(), 0.0
    for before, now in pairwise(points):
        moved = np.zeros_like(seen)
        for factor, share in tails.items():
            across, down = (
                stats.norm.pdf((now - before)[axis] + offsets[:, None] - offsets, 0, factor * sd)
                for axis in (0, 1)
            )
            moved += share * across @ density @ down.T
        density = moved * seen
        total += np.log(density.sum())
        density = density / density.sum()
    return total


@pytest.mark.slow
@pytest.mark.parametrize("motion", [VELOCITY, "{random_walk: {sd_px: {x: 3, y: 5}}}"])
def test_what_boxes_were_drawn_with_is_found_again(motion):
    root = root_of(motion)
    true = dict(fitted_parameters(root))
    off = root
    for path, value in true.items():
        off = with_value(off, path, 6 * value)
    fitted = fit_motion(off, [scene(motion, 1)])
    found = {one.path: one for one in fitted.estimates}
    assert set(found) == {*true, ERRORS[0]} and fitted.frames == 400
    for path, value in {**true, ERRORS[0]: 2.0}.items():
        assert abs(np.log(found[path].value / value)) < 0.35
        assert found[path].low < found[path].value < found[path].high and found[path].is_known
    assert fitted.log_evidence > fitted.log_evidence_before


TAIL = "{random_walk: {sd_box: {x: 0.1, y: 0.1}, heavy_tail: {weight: 0.3, factor: 6}}}"
TURN = "{constant_velocity: {sd_velocity_px: 6, start_velocity_sd_px: 3}}"
STRAIGHT = "{constant_velocity: {sd_velocity_px: 0.5, start_velocity_sd_px: 3}}"
MODES = f"modes: {{straight: {{mean_frames: 20}}, turn: {{mean_frames: 10, motion: {TURN}}}}}"


@pytest.mark.slow
@pytest.mark.parametrize(("motion", "modes"), [(TAIL, ""), (STRAIGHT, MODES)])
def test_tails_and_modes_are_found_again(motion, modes):
    """Two tracks of 400 frames, the search far from the true values.

    Were the regimes known, 240 frames in the tail would give log(weight) an sd of sqrt(0.7 / 240) = 0.05,
    and 27 visits to each mode a log duration one of 1 / sqrt(27) = 0.19. Eight and four times as much are
    allowed, since regimes are hidden. Sds are of at least 240 frames, but small ones stand against errors of
    2 px.
    """
    root = root_of(motion, modes)
    away = {"weight": 1 / 3, "factor": 2.0, "mean_frames": 3.0}
    true = dict(fitted_parameters(root))
    far = root
    for path, value in true.items():
        far = with_value(far, path, away.get(path[-1], 6.0) * value)
    tracks = [scene(motion, seed, modes=modes, draws=20) for seed in (9000, 9001)]
    found = {one.path: one for one in fit_motion(far, tracks).estimates}
    tolerances = {"weight": 0.4, "mean_frames": 0.8}
    for path, value in true.items():
        one = found[path]
        assert one.is_known and one.low < one.value < one.high, path
        assert abs(np.log(one.value / value)) < tolerances.get(path[-1], 0.35), path


def test_gaps_and_several_tracks_are_used():
    tracks = [scene(VELOCITY, seed, 50) for seed in (2, 3)]
    tracks[0][20:30] = np.nan
    tracks[1][:5] = np.nan
    fitted = fit_motion(root_of(VELOCITY), tracks, error_sd=2.0)
    (one,) = fitted.estimates
    assert fitted.frames == 51 - 1 - 10 + 51 - 5 - 1 and one.low < 1.5 * 1.2 and one.high > 1.5 / 1.2


@pytest.mark.slow
def test_what_boxes_do_not_tell_is_said():
    still = np.tile(BOX, (50, 1)) + np.random.default_rng(0).normal(0, 2, (50, 4))
    (one, error) = fit_motion(root_of("{random_walk: {sd_px: {x: 3}}}"), [still]).estimates
    assert not one.is_known and error.is_known


@pytest.mark.parametrize(
    ("motion", "modes", "said"),
    [
        ("{expressions: {sd: {x: 1}}}", "", "expressions cannot be fitted; allowed: random_walk"),
        ("{random_walk: {sd_px: {x: 1}, camera: compensate}}", "", "camera: boxes do not tell"),
        ("{random_walk: {sd_log: {scale: 0.1}, size_reversion: {sd_scale: 1}}}", "", "size_reversion"),
        ("{constant_velocity: {borders: reflect}}", "", "borders: reflection has no closed form"),
        (
            VELOCITY,
            "modes: {seen: {mean_frames: 5}, gone: {mean_frames: 5, hidden: {}}}",
            "modes.gone.hidden",
        ),
    ],
)
def test_other_motions_are_refused(motion, modes, said):
    with pytest.raises(MotionFitError, match=said):
        fit_motion(root_of(motion, modes), [scene(VELOCITY, 1, 40)])


def test_few_frames_are_refused():
    with pytest.raises(MotionFitError, match="4 frames with a box after the first; at least 20 are needed"):
        fit_motion(root_of(VELOCITY), [scene(VELOCITY, 1, 4)])
