"""Modes with motions by expressions, borders and parts: against enumeration of all sequences of modes."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from bayesnet_track import Tracker, load_graph
from bayesnet_track.belief.contract import Evidence
from bayesnet_track.belief.gaussian.modal import ModalFilter
from bayesnet_track.belief.motion.borders import confined
from bayesnet_track.belief.motion.formulas import undefined_in
from bayesnet_track.belief.motion.modes import FIELD, Modal, mode_probabilities
from bayesnet_track.belief.particles.belief import ParticleFilter
from bayesnet_track.engine.compiled import make_plate_motion
from bayesnet_track.graph import spec
from bayesnet_track.observation.cue import Measurement

BOX = np.array([60.0, 90.0, 20.0, 20.0])
SD = 4.0
CHAIN = np.array([[0.9, 0.1], [0.3, 0.7]])
GO, SPRING = ({"next": {"go": p, "spring": q}} for p, q in CHAIN.tolist())
PULLED = {
    "fields": {"vx": {"sd": 6}, "vy": {"sd": 6}, "pull": {"start": 2, "sd": 1}},
    "drift": {"x": "x + vx * dt", "y": "y + vy * dt", "vx": "0.5 * vx + pull * dt"},
    "sd": {"x": 1, "y": 1, "vx": 2, "vy": 2},
}
GOING = {
    **PULLED,
    "drift": {"x": "x + vx * dt", "y": "y + vy * dt"},
    "fields": {"vx": {"sd": 6}, "vy": {"sd": 6}},
}
PLACES = np.array([[66.0, 92.0], [74.0, 95.0], [70.0, 104.0], [88.0, 109.0]])


def matrices():
    """F, offset and Q of both modes in x, y, vx, vy, pull, written out: nothing of the code under test."""
    go, spring = np.eye(5), np.eye(5)
    for moves in (go, spring):
        moves[0, 2] = moves[1, 3] = 1.0
    go[4, 4] = 0.0  # a motion without the field draws it anew
    spring[2, 2], spring[2, 4] = 0.5, 1.0
    noise = np.diag([1.0, 1.0, 4.0, 4.0, 0.0])
    forgets = noise + np.diag([0.0, 0.0, 0.0, 0.0, 1.0])
    return (go, np.r_[0.0, 0.0, 0.0, 0.0, 2.0], forgets), (spring, np.zeros(5), noise)


def enumerated():
    """Exact: mean (x, y, vx, vy), P(mode) and log-evidence of each frame, a Kalman filter a sequence."""
    start = np.array([3.0, 1.0]) / 4.0  # of the chain in the long run
    mean, covariance = np.r_[BOX[:2], 0.0, 0.0, 2.0], np.diag([0.0, 0.0, 36.0, 36.0, 1.0])
    live = [(start[k], mean, covariance, k) for k in range(2)]
    before, look = 0.0, np.eye(2, 5)
    for place in PLACES:
        after = []
        for (weight, mean, covariance, old), new in product(live, range(2)):
            moves, offset, noise = matrices()[new]
            m, p = moves @ mean + offset, moves @ covariance @ moves.T + noise
            s, away = look @ p @ look.T + SD**2 * np.eye(2), place - look @ m
            gain = p @ look.T @ np.linalg.inv(s)
            density = SD**2 / np.sqrt(np.linalg.det(s)) * np.exp(-0.5 * away @ np.linalg.solve(s, away))
            after.append((weight * CHAIN[old, new] * density, m + gain @ away, p - gain @ s @ gain.T, new))
        live = after
        weights = np.array([one[0] for one in live])
        total, shares = np.log(weights.sum()), weights / weights.sum()
        means = np.array([one[1] for one in live])
        yield shares @ means, np.bincount([one[3] for one in live], shares), total - before
        before = total


def root(motion, modes, **further):
    return spec.InferenceNode.model_validate({"motion": motion, "modes": modes, **further})


def in_modes(belief):
    motion = make_plate_motion(
        root({"expressions": GOING}, {"go": GO, "spring": {**SPRING, "motion": {"expressions": PULLED}}}), {}
    )
    assert isinstance(motion, Modal)
    return motion, belief(motion)


def followed(belief, motion, stream_of, seed, measured):
    now = belief.start(BOX, motion, stream_of(seed, 0))
    for frame, place in enumerate(PLACES, start=1):

        def evaluate(hypotheses, prior_log, place=place):
            near = -0.5 * np.sum(((hypotheses.boxes[:, :2] - place) / SD) ** 2, axis=1)
            if not measured:
                return Evidence(near, {"agent": near})
            message = Measurement(("x", "y"), place, SD**2 * np.eye(2))
            flat = np.zeros(len(near))
            return Evidence(near, {"agent": near}, gaussians={"agent": message}, sampled=flat)

        step = belief.step(now, motion, 1.0, evaluate, stream_of(seed, frame))
        now = step.posterior
        yield now.mean[[0, 1, 4, 5]], mode_probabilities(now, 2), step.log_evidence


def test_particles_in_modes_by_expressions_agree_with_enumeration(stream_of):
    """16 runs of 1000: the mean of each number lies within four of its standard errors."""
    motion, belief = in_modes(lambda motion: ParticleFilter(spec.Particles(size=1000)))
    runs = [list(followed(belief, motion, stream_of, seed, False)) for seed in range(16)]
    for number, (mean, shares, log_evidence) in enumerate(enumerated()):
        rows = np.array([np.r_[m, s, np.exp(e)] for m, s, e in (one[number] for one in runs)])
        error = rows.std(axis=0, ddof=1) / 4.0
        slack = np.r_[np.full(4, 0.05), 0.005, 0.005, 0.0]
        wanted = np.r_[mean[:4], shares, np.exp(log_evidence)]
        assert (np.abs(rows.mean(axis=0) - wanted) < 4 * error + slack).all(), number


@pytest.mark.parametrize("kind", ["extended", "unscented"])
def test_gaussians_in_modes_by_expressions_are_exact_in_the_first_frame(kind, stream_of):
    """Later the mixing is an approximation, whose error is bounded here."""
    motion, belief = in_modes(
        lambda motion: ModalFilter(spec.Gaussian(filter=kind, gate=1.0, samples=40), motion.modes)
    )
    steps = followed(belief, motion, stream_of, 0, True)
    for number, ((mean, shares, log_evidence), found) in enumerate(zip(enumerated(), steps, strict=True)):
        close = 1e-5 if number == 0 else 0.05
        assert found[0] == pytest.approx(mean[:4], abs=close if number == 0 else 0.6)
        assert found[1] == pytest.approx(shares, abs=close)
        assert found[2] == pytest.approx(log_evidence, abs=close)


# ------------------------------------------------------------------------------------ the motion


def test_modes_reflect_where_the_motion_does(rng):
    motion = make_plate_motion(
        root(
            {"constant_velocity": {"sd_velocity_px": 1, "borders": "reflect"}},
            {
                "slow": {"mean_frames": 9},
                "fast": {"mean_frames": 9, "motion": {"constant_velocity": {"sd_velocity_px": 9}}},
            },
        ),
        {},
    )
    whole = confined(motion, 100, 100)
    states = np.tile(np.r_[85.0, 50.0, 20.0, 20.0, 12.0, 0.0, 0.0], (2000, 1))
    states[1000:, -1] = 1.0
    moved = whole.propagate(states, 1.0, rng)
    for mode in (0, 1):
        some = moved[moved[:, -1] == mode]
        assert (some[:, 0] <= 89.5).all() and (some[:, 4] < 0).mean() > 0.8


def test_a_value_that_is_none_in_one_mode_is_said():
    broken = {"expressions": {"sd": {"x": 1, "y": 1}, "drift": {"x": "log(-x)"}}}
    motion = make_plate_motion(
        root(
            {"random_walk": {"sd_px": {"x": 1, "y": 1}}},
            {"a": {"mean_frames": 9}, "b": {"mean_frames": 9, "motion": broken}},
        ),
        {},
    )
    whole = confined(motion, 320, 240)
    whole.propagate(np.tile(np.r_[BOX, 1.0], (5, 1)), 1.0, np.random.default_rng(0))
    assert list(undefined_in(whole)) == ["drift x"]


# ------------------------------------------------------------------------------------ front door

BLANK = np.full((240, 320, 3), 40, np.uint8)


def circling(number):
    """Straight, then a turn by .2 rad a frame."""
    return (
        np.array([40.0 + 6 * number, 60.0])
        if number < 12
        else np.array([106.0 + 30 * np.sin(0.2 * (number - 11)), 90.0 - 30 * np.cos(0.2 * (number - 11))])
    )


@pytest.fixture
def turning(tmp_path, rng):
    rows = [f"{k},{x + rng.normal():.3f},{y + rng.normal():.3f}" for k in range(30) for x, y in [circling(k)]]
    (tmp_path / "radio.csv").write_text("\n".join(["frame,x,y", *rows]), encoding="utf-8")
    turn = {
        "fields": {"vx": {"sd": 6}, "vy": {"sd": 6}, "rate": {"start": 0.1, "sd": 0.15}},
        "drift": {
            "x": "x + vx * dt",
            "y": "y + vy * dt",
            "vx": "vx * cos(rate * dt) - vy * sin(rate * dt)",
            "vy": "vx * sin(rate * dt) + vy * cos(rate * dt)",
        },
        "sd": {"x": 0.3, "y": 0.3, "vx": 0.1, "vy": 0.1, "rate": 0.01},
    }
    straight = {
        **turn,
        "fields": dict(list(turn["fields"].items())[:2]),
        "drift": dict(list(turn["drift"].items())[:2]),
        "sd": dict(list(turn["sd"].items())[:4]),
    }
    return {
        "bayesnet": 1,
        "name": "turning",
        "targets": {
            "ball": {
                "nodes": {
                    "ball": {
                        "motion": {"expressions": straight},
                        "modes": {
                            "straight": {"mean_frames": 30},
                            "turn": {"mean_frames": 10, "motion": {"expressions": turn}},
                        },
                        "estimate": "mean",
                    },
                    "s": {
                        "parent": "ball",
                        "agent": {"readings": {"file": str(tmp_path / "radio.csv"), "sd": {"x": 1, "y": 1}}},
                    },
                }
            }
        },
    }


@pytest.mark.parametrize(
    "belief", [{"gaussian": {"filter": "unscented", "gate": 1}}, {"particles": {"size": 800}}], ids=["g", "p"]
)
def test_a_turn_of_unknown_rate_is_a_mode(turning, belief):
    turning["targets"]["ball"]["nodes"]["ball"]["belief"] = belief
    tracker = Tracker(load_graph(turning))
    tracker.init(BLANK, (30, 50, 20, 20))
    turns, away = [], []
    for number in range(1, 30):
        tracker.update(BLANK)
        turns.append(tracker.targets[0].modes["turn"])
        away.append(np.hypot(*(np.array(tracker.targets[0].centre_box[:2]) - circling(number))))
    assert np.mean(turns[5:10]) < 0.5 < np.mean(turns[14:])
    assert np.mean(away[3:]) < 1.5


def test_expressions_of_the_net_may_read_the_fields_of_every_mode(turning):
    turning["targets"]["ball"]["nodes"]["slow"] = {"parent": "ball", "factor": "normal(rate, 0, 0.5)"}
    tracker = Tracker(load_graph(turning))
    tracker.init(BLANK, (30, 50, 20, 20))
    for _ in range(3):
        tracker.update(BLANK)
    assert FIELD not in tracker.targets[0].modes and set(tracker.targets[0].modes) == {"straight", "turn"}
