"""Targets in modes that share detections: exact against enumeration, and a crowd that turns, stops, hides."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from bayesnet_track import DetectionsTracker, load_graph
from bayesnet_track.adapt.existence import Pairs
from bayesnet_track.belief.contract import Evidence
from bayesnet_track.belief.gaussian.belief import GaussianPosterior
from bayesnet_track.belief.gaussian.expected import expect
from bayesnet_track.belief.gaussian.modal import ModalFilter, ModalPosterior
from bayesnet_track.belief.motion.averaged import without_modes
from bayesnet_track.belief.motion.modes import FIELD, moments_of
from bayesnet_track.belief.particles.belief import ParticleFilter
from bayesnet_track.engine.compiled import make_plate_motion
from bayesnet_track.engine.lifecycle.detecting import Found
from bayesnet_track.engine.lifecycle.existing import _in_modes
from bayesnet_track.engine.lifecycle.sensing import BoxSensor
from bayesnet_track.graph import spec
from bayesnet_track.inference.hidden import Sight
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import AssociationRule, Measurement

BOXES = np.array([[66.0, 92.0, 20.0, 21.0], [48.0, 90.0, 19.0, 20.0]])
RULE = AssociationRule(0.1, 0.1, 1.0, 0.0, 0.0, 0.0)
WALK = {"constant_velocity": {"sd_velocity_px": 1, "sd_px": {"w": 1, "h": 1}, "start_velocity_sd_px": 4}}
STOP = {"random_walk": {"sd_px": {"x": 0.5, "y": 0.5, "w": 1, "h": 1}}}
MISSED, CLUTTER = 0.2, 1e-6


def plate(**behind):
    modes = {"walk": {"mean_frames": 9}, "stop": {"mean_frames": 5, "motion": STOP}, **behind}
    return make_plate_motion(spec.InferenceNode.model_validate({"motion": WALK, "modes": modes}), {})


@pytest.fixture
def before(rng):
    motion = plate(behind={"mean_frames": 4, "hidden": {"missed": MISSED}})
    fields = motion.fields[:-1]

    def part(vx):
        root = rng.normal(size=(6, 6))
        return GaussianPosterior(
            np.array([60.0, 90, 20, 20, vx, 1.0]), root @ root.T + 2 * np.eye(6), fields, 40
        )

    return motion, ModalPosterior((part(5), part(0), part(-8)), np.array([0.5, 0.3, 0.2]))


def enumerated(motion, prior):
    """P(mode, whose detection) and the Gaussian of each pair, from nothing but NumPy and SciPy."""
    chain = motion.chain.over(1.0)
    joint = chain * prior.mode_probabilities[:, None]
    found = {}
    for mode in range(3):
        share = joint[:, mode] / joint[:, mode].sum()
        mean = sum(s * p.mean for s, p in zip(share, prior.parts, strict=True))
        cov = sum(
            s * (p.covariance + np.outer(p.mean - mean, p.mean - mean))
            for s, p in zip(share, prior.parts, strict=True)
        )
        moves, noise = motion.motions[mode].linearise(mean, 1.0)
        mean, cov = moves @ mean, moves @ cov @ moves.T + noise
        weight = joint[:, mode].sum()
        if motion.modes.hidden[mode]:
            found[mode, None] = weight, mean, cov
            continue
        found[mode, None] = weight * MISSED, mean, cov
        for number, box in enumerate(BOXES):
            spread = cov[:4, :4] + np.diag(RULE.variances(box[None])[0])
            gain = cov[:, :4] @ np.linalg.inv(spread)
            fit = multivariate_normal.pdf(box, mean[:4], spread) * (1 - MISSED) / CLUTTER
            found[mode, number] = weight * fit, mean + gain @ (box - mean[:4]), cov - gain @ cov[:4]
    total = sum(weight for weight, _, _ in found.values())
    return {pair: (weight / total, mean, cov) for pair, (weight, mean, cov) in found.items()}


def test_modes_share_what_was_associated_as_enumeration_does(before, stream_of):
    motion, prior = before
    pairs = enumerated(motion, prior)
    weights = [sum(w for (_, j), (w, _, _) in pairs.items() if j == number) for number in range(2)]
    choices = tuple(
        (weight, Measurement(("x", "y", "w", "h"), box, np.diag(RULE.variances(box[None])[0])))
        for weight, box in zip(weights, BOXES, strict=True)
    )
    whole = Measurement(("x", "y", "w", "h"), BOXES[0], np.eye(4), choices=choices)

    def evaluate(hypotheses, prior_log):
        flat = np.zeros(len(hypotheses))
        seen = Evidence(flat, {"s": flat}, gaussians={"s": whole}, measured={"s": whole}, sampled=flat)
        assert (Sight(motion.modes, 320, 240).log_detected(seen) == 0.0).all()  # the association weighed it
        return seen

    belief = ModalFilter(spec.Gaussian(filter="kalman", gate=1.0, samples=20), motion.modes)
    after = belief.step(prior, motion, 1.0, evaluate, stream_of(0, 1)).posterior
    for mode in range(3):
        own = [(w, m, c) for (k, _), (w, m, c) in pairs.items() if k == mode]
        share = sum(w for w, _, _ in own)
        mean = sum(w * m for w, m, _ in own) / share
        cov = sum(w * (c + np.outer(m - mean, m - mean)) for w, m, c in own) / share
        assert after.mode_probabilities[mode] == pytest.approx(share, abs=1e-9)
        assert after.parts[mode].mean == pytest.approx(mean, abs=1e-7)
        assert after.parts[mode].covariance == pytest.approx(cov, abs=1e-6)


def test_pairs_weigh_a_detection_by_all_modes_in_which_it_can_be_seen(before):
    motion, prior = before
    expected = expect(prior, motion, 1.0, spec.Gaussian(filter="kalman"))
    pairs = enumerated(motion, prior)
    seen = sum(w for (k, j), (w, _, _) in pairs.items() if j == 0) / sum(
        w for (k, j), (w, _, _) in pairs.items() if j == 1
    )
    several = Pairs(np.array([0, 0]), np.array([0, 1]), np.zeros(2))
    found = evolve(Found.none(), values=BOXES, scores=np.ones(2), numbers=np.arange(2))
    values = _in_modes(BoxSensor(RULE), several, {0: expected}, found).values
    assert values[0] - values[1] == pytest.approx(np.log(seen), abs=1e-9)
    chain = motion.chain.over(1.0)
    assert expected.visible == pytest.approx(float((prior.mode_probabilities @ chain)[:2].sum()))


def test_particles_are_expected_as_the_gaussians_of_their_modes(stream_of):
    motion = plate(behind={"mean_frames": 4, "hidden": {}})
    belief = ParticleFilter(spec.Particles(size=20_000)).start(
        np.array([60.0, 90, 20, 20]), motion, stream_of(1, 0)
    )
    gaussians = ModalFilter(spec.Gaussian(filter="kalman"), motion.modes).start(
        np.array([60.0, 90, 20, 20]), motion, stream_of(1, 0)
    )
    drawn, exact = (expect(one, motion, 1.0, spec.Gaussian(filter="kalman")) for one in (belief, gaussians))
    assert drawn.visible == pytest.approx(exact.visible, abs=0.01)
    assert np.sqrt(np.diagonal(drawn.moments[1])) == pytest.approx(
        np.sqrt(np.diagonal(exact.moments[1])), rel=0.05
    )
    mean, covariance = moments_of(belief)
    assert len(mean) == len(covariance) == 6 and belief.fields[-1] == FIELD


def test_what_may_become_a_target_moves_as_the_modes_do_on_average(rng):
    motion = plate()
    averaged = without_modes(motion)
    state = np.array([60.0, 90, 20, 20, 6.0, -2.0])
    moves, noise = averaged.linearise(state, 1.0)
    drawn = averaged.propagate(np.tile(state, (40_000, 1)), 1.0, rng)
    assert averaged.drift(state[None], 1.0)[0] == pytest.approx(drawn.mean(axis=0), abs=0.1)
    assert np.sqrt(np.diagonal(noise)) == pytest.approx(drawn.std(axis=0), rel=0.03)
    assert averaged.fields == motion.fields[:-1] and moves.shape == (6, 6)


# ------------------------------------------------------------------------------------ front door


@dataclass
class Walker:
    """One that walks, stands from frame 15 to 30, turns back, and is behind something from 45 to 55."""

    row: float

    def box(self, frame):
        x = 40 + 6 * min(frame, 15)
        x = x if frame < 30 else x - 5 * (frame - 30)
        return None if 45 <= frame < 55 else [x, self.row, x + 30, self.row + 60]


def crowd(kind, associate, **root):
    modes = {
        "walk": {"mean_frames": 30},
        "stop": {
            "mean_frames": 15,
            "motion": {"random_walk": {"sd_px": {"x": 0.5, "y": 0.5, "w": 1, "h": 1}}},
        },
        "behind": {"mean_frames": 10, "hidden": {}},
    }
    belief = {"gaussian": {"filter": "kalman", "gate": 1}, "particles": {"size": 300}}[kind]
    motion = {"constant_velocity": {"sd_velocity_px": 1, "sd_px": {"w": 1, "h": 1}}}
    target = {
        "birth": {"detector": "detections", "min_distance_box": 0.2},
        "nodes": {
            "p": {"belief": {kind: belief}, "motion": motion, "modes": modes, "estimate": "mean", **root},
            "s": {"parent": "p", "agent": "detection"},
        },
    }
    if associate != "plain":
        target |= {"existence": {"survival": 0.999}, "associate": associate}
    return load_graph({"bayesnet": 1, "name": "crowd", "targets": {"p": target}})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "associate"),
    [
        ("gaussian", "plain"),
        ("gaussian", "assignment"),
        ("gaussian", "marginal"),
        ("particles", "assignment"),
    ],
)
def test_a_crowd_walks_stops_turns_and_hides(kind, associate, rng):
    tracker, walkers = DetectionsTracker(crowd(kind, associate), size=(640, 480)), [Walker(60), Walker(220)]
    modes, ids = {}, []
    for frame in range(60):
        boxes = [b for b in (one.box(frame) for one in walkers) if b is not None]
        boxes = np.array(boxes, dtype=float).reshape(-1, 4) + rng.normal(0, 0.6, (len(boxes), 4))
        given = SimpleNamespace(xyxy=boxes, confidence=np.full(len(boxes), 0.9))
        ids.append(tuple(tracker.update(given).tracker_id))
        modes[frame] = [one.modes for one in tracker.targets]
    assert len(tracker.targets) == 2 and ids[59] == ids[10]
    for walk, stop, behind in zip(modes[12], modes[28], modes[50], strict=True):
        assert walk["walk"] > 0.5 > walk["stop"]
        assert stop["stop"] > 0.5
        assert behind["behind"] > 0.9
    assert all(one.hidden < 0.1 for one in tracker.targets)


@pytest.mark.parametrize("step", [(-3.0, -12.0), (14.0, 9.0), (0.0, 0.4)])
def test_a_target_with_modes_starts_with_the_velocity_of_its_detections(step):
    written = crowd("gaussian", "plain").spec.model_dump(exclude_unset=True)
    written["targets"]["p"]["birth"] |= {"confirm": {"hits": 3, "of": 4}}
    tracker = DetectionsTracker(load_graph(written), size=(640, 480))
    for frame in range(6):
        x, y = np.array([300.0, 240.0]) + frame * np.array(step)
        box = np.array([[x - 10, y - 22, x + 10, y + 22]])
        ids = tracker.update(SimpleNamespace(xyxy=box, confidence=np.array([0.9]))).tracker_id
    assert list(ids) == [1] and len(tracker.targets) == 1
    (target,) = tracker.targets
    assert np.hypot(target.state["vx"] - step[0], target.state["vy"] - step[1]) < 2.5


def test_a_frame_in_which_nobody_detects_hides_nobody():
    graph = crowd("gaussian", "plain")
    spec_of = graph.spec.model_dump(exclude_unset=True)
    spec_of["targets"]["p"]["birth"]["every"] = 5
    tracker = DetectionsTracker(load_graph(spec_of), size=(640, 480))
    hidden = []
    for _ in range(30):
        box = Walker(60).box(20)
        tracker.update(SimpleNamespace(xyxy=np.array([box], dtype=float), confidence=np.array([0.9])))
        hidden += [one.hidden for one in tracker.targets]
    assert hidden and max(hidden) < 0.4
