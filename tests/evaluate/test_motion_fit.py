"""Maximum evidence of a motion: the evidence is exact, and what boxes were drawn with is found again."""

import numpy as np
import pytest
from scipy import stats

from bayesnet_track.belief.motion.models import make_motion
from bayesnet_track.engine.simulating import Simulation, simulate
from bayesnet_track.evaluate.motion.evidence import Hypothesis, log_evidence
from bayesnet_track.evaluate.motion.fit import ERRORS, fit_motion
from bayesnet_track.evaluate.motion.parameters import MotionFitError, parameters_of, with_value
from bayesnet_track.graph.checks.run import check
from bayesnet_track.graph.spec import Motion
from bayesnet_track.graph.text.read import read_graph

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


def scene(motion, seed, frames=400, error=2.0):
    drawn = simulate(plate(motion), {}, BOX, Simulation(frames, 1, seed)).boxes[:, 0]
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


def test_two_regimes_are_exact_over_two_frames():
    """One mixing before the first measurement loses nothing: enumeration over both regimes."""
    settings = {"random_walk": {"sd_px": {"x": 2, "y": 2}, "heavy_tail": {"weight": 0.3, "factor": 5}}}
    motion = make_motion(Motion.model_validate(settings))
    boxes = BOX + np.array([[0, 0, 0, 0], [6.0, -3.0, 0, 0]])
    found = np.exp(log_evidence(boxes, [Hypothesis((motion,), None, (1.0, 1.0))])[0])
    each = [np.prod(stats.norm.pdf([6, -3], 0, np.sqrt(2.0 + (2 * f) ** 2))) for f in (1, 5)]
    np.testing.assert_allclose(found, 0.7 * each[0] + 0.3 * each[1], rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("motion", [VELOCITY, "{random_walk: {sd_px: {x: 3, y: 5}}}"])
def test_what_boxes_were_drawn_with_is_found_again(motion):
    root = root_of(motion)
    true = dict(parameters_of(root))
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


def test_gaps_and_several_tracks_are_used():
    tracks = [scene(VELOCITY, seed, 50) for seed in (2, 3)]
    tracks[0][20:30] = np.nan
    tracks[1][:5] = np.nan
    fitted = fit_motion(root_of(VELOCITY), tracks, error_sd=2.0)
    (one,) = fitted.estimates
    assert fitted.frames == 51 - 1 - 10 + 51 - 5 - 1 and one.low < 1.5 * 1.2 and one.high > 1.5 / 1.2


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
