"""Measurements drawn from a model have uniform p-values under it, by every belief; others do not."""

import numpy as np
import pytest
from scipy import stats

from bayesnet_track.belief.contract import Evidence
from bayesnet_track.belief.motion.modes import modes_of
from bayesnet_track.engine.compiled import make_belief, make_plate_motion
from bayesnet_track.graph.checks.run import check
from bayesnet_track.graph.text.load import read_graph
from bayesnet_track.inference.gaussian_messages import measurement_message
from bayesnet_track.inference.predictive import p_values
from bayesnet_track.numerics.streams import Streams
from bayesnet_track.observation.cue import Measurement
from bayesnet_track.observation.protocols import Seen

GRAPH = """\
bayesnet: 1
name: predicted
targets:
  ball:
    nodes:
      ball:
        belief: BELIEF
        motion: {constant_velocity: {sd_velocity_px: 1, start_velocity_sd_px: 2, sd_px: {x: 1, y: 1}}}
        MODES
        estimate: mean
      place: {parent: ball, agent: mean_shift}
"""
TURN = "{constant_velocity: {sd_velocity_px: 4, start_velocity_sd_px: 2, sd_px: {x: 1, y: 1}}}"
MODES = f"modes: {{on: {{mean_frames: 9}}, turn: {{mean_frames: 4, motion: {TURN}}}}}"
BOX = np.array([500.0, 400.0, 30.0, 30.0])
ERROR = np.array([[9.0, 2.0], [2.0, 4.0]])


RADAR = BOX[:2] + [-60.0, 25.0]
POLAR_ERROR = np.diag([3.0, 0.05]) ** 2


def polar(states):
    away = np.stack([states["x"] - RADAR[0], states["y"] - RADAR[1]])
    return np.stack([np.hypot(*away), np.arctan2(away[1], away[0])], axis=1)


def read(state, scale, rng):
    """Range and bearing, from a place left of the target."""
    z = polar({"x": state[:1, 0], "y": state[:1, 1]})[0]
    z = z + scale * rng.multivariate_normal(np.zeros(2), POLAR_ERROR)
    return Measurement(("range", "bearing"), z, POLAR_ERROR, seen=Seen(polar, np.array([np.inf, 2 * np.pi])))


def find(state, scale, rng):
    """The place itself."""
    at = state[0, :2] + scale * rng.multivariate_normal(np.zeros(2), ERROR)
    return Measurement(("x", "y"), at, ERROR)


def p_values_of(belief, frames, scale=1.0, modes="", measure=find):
    text = GRAPH.replace("BELIEF", belief).replace("MODES", modes)
    plate = check(*read_graph(text, "g.yaml")).targets["ball"]
    root, streams, rng = plate.inference("ball"), Streams(0), np.random.default_rng(5)
    motion, belief = make_plate_motion(root, {}), make_belief(root.belief, modes_of(root))
    posterior = belief.start(BOX, motion, lambda purpose: streams.of("1", "ball", 0, purpose))
    state, found = motion.start(BOX, 1, rng), []
    for frame in range(1, frames + 1):
        state = motion.propagate(state, 1.0, rng)
        one = measure(state, scale, rng)

        def evaluate(hypotheses, beta, one=one):
            message = measurement_message(one, hypotheses)
            sampled = np.zeros(len(message))
            return Evidence(message, {"place": message}, gaussians={"place": one}, sampled=sampled)

        def stream(purpose, frame=frame):
            return streams.of("1", "ball", frame, purpose)

        step = belief.step(posterior, motion, 1.0, evaluate, stream)
        posterior = step.posterior
        found.append(p_values(plate, step, ())["place"])
    return found


@pytest.mark.parametrize(
    ("belief", "modes"),
    [
        ("{gaussian: {filter: kalman, gate: 0.999999}}", ""),
        ("{particles: {size: 800}}", ""),
        ("{particles: {size: 800}}", MODES),
        ("{gaussian: {filter: kalman, gate: 0.999999}}", MODES),
    ],
)
def test_they_are_uniform_under_the_model(belief, modes):
    assert stats.kstest(p_values_of(belief, 100, modes=modes), "uniform").pvalue > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("modes", ["", MODES])
@pytest.mark.parametrize(
    "belief", ["{gaussian: {filter: unscented, gate: 0.999999}}", "{particles: {size: 800}}"]
)
def test_those_of_functions_of_the_state_are_uniform_too(belief, modes):
    assert stats.kstest(p_values_of(belief, 100, modes=modes, measure=read), "uniform").pvalue > 1e-3


@pytest.mark.parametrize("measure", [find, read])
@pytest.mark.parametrize("scale", [0.3, 3.0])
def test_errors_of_another_size_show(scale, measure):
    found = p_values_of("{gaussian: {filter: extended, gate: 0.999999}}", 100, scale, measure=measure)
    assert stats.kstest(found, "uniform").pvalue < 1e-3
    assert bool(np.median(found) > 0.5) is (scale < 1)


def test_a_measurement_that_targets_share_has_none():
    text = GRAPH.replace("BELIEF", "{gaussian: {filter: kalman}}").replace("MODES", "")
    plate = check(*read_graph(text, "g.yaml")).targets["ball"]
    root = plate.inference("ball")
    motion, belief = make_plate_motion(root, {}), make_belief(root.belief)
    streams = Streams(0)
    first = belief.start(BOX, motion, lambda purpose: streams.of("1", "ball", 0, purpose))
    one = Measurement(("x", "y"), BOX[:2], ERROR)
    shared = Measurement(("x", "y"), BOX[:2], ERROR, choices=((0.7, one),))

    def evaluate(hypotheses, beta):
        zeros = np.zeros(len(hypotheses.boxes))
        return Evidence(zeros, gaussians={"place": shared}, sampled=zeros)

    step = belief.step(first, motion, 1.0, evaluate, lambda purpose: streams.of("1", "ball", 1, purpose))
    assert p_values(plate, step) == {}
