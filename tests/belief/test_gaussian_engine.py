"""The Gaussian belief as the root of a net: agents that measure and agents that score, in the engine."""

from dataclasses import dataclass

import cv2
import numpy as np
import pytest

from bayesnet_track import GraphSpec, Tracker, track
from bayesnet_track.belief.gaussian.belief import GaussianPosterior
from bayesnet_track.belief.motion.formulas import FunctionMotion
from bayesnet_track.engine.step import make_engine
from bayesnet_track.journal.codec import from_json, to_json
from bayesnet_track.journal.events.beliefs import DegenerateBelief, MeasurementGated
from bayesnet_track.journal.text.sentences import explain
from bayesnet_track.observation.cue import Measurement, Reference, blend_arrays

SPEED = 2.0


@dataclass(frozen=True)
class Finder:
    """Measures the true place, x = 50 + 2 t and y = 40, but for `wrong` (frame -> x, or None: unseen)."""

    wrong: dict
    plane: object
    sd: float = 2.0

    @property
    def needs(self):
        return (self.plane,)

    def learn(self, planes, box):
        return {"box": box}

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        return blend_arrays(old, new, rate)

    def measure(self, planes, hypotheses, weights, reference):
        frame = planes.frame.index
        x = self.wrong.get(frame, 50.0 + SPEED * frame)
        return (
            None if x is None else Measurement(("x", "y"), np.array([x, 40.0]), self.sd**2 * np.eye(2), 0.02)
        )


@pytest.fixture
def finder_engine(fakes):
    """(wrong places, what else sees, settings of the root) -> engine and the finder's plane."""

    def make(wrong, sees=None, seed=0, motion=None, **root):
        plane = fakes.Plane("window")
        cues = {"finder": Finder(wrong, plane)}
        cues |= {name: fakes.Oracle(see) for name, see in (sees or {}).items()}
        nodes = {
            "root": {
                "belief": {"gaussian": {"filter": "kalman"}},
                "motion": {"constant_velocity": {"sd_px": {"x": 1.0, "y": 1.0}, "sd_velocity_px": 0.5}},
                **({"fuse": "product"} if sees else {}),
                "estimate": "mean",
                "ud_fields": ["x", "y"],
                **root,
            },
            **dict.fromkeys(cues, "root"),
        }
        declared = {name: fakes.declare(cue) for name, cue in cues.items()}
        own = None if motion is None else {"plate": motion}
        return make_engine(fakes.graph(nodes, declared), seed, declared, own), plane

    return make


def errors(outcomes):
    """Distances of the estimates from the truth, px, frame by frame."""
    boxes = np.array([outcome.metrics[0].centre_box for outcome in outcomes])
    return np.hypot(boxes[:, 0] - 50 - SPEED * np.arange(len(boxes)), boxes[:, 1] - 40).tolist()


def scorer(fakes, sd):
    """What an agent sees that scores hypotheses around the true place."""
    return lambda p, h, r: fakes.gaussian(50 + SPEED * p.frame.index, 40, sd, 0.02)(p, h, r)


def test_it_follows_an_agent_that_measures(finder_engine, fakes):
    outcomes = fakes.play(finder_engine({})[0], 25)
    assert max(errors(outcomes)) < 2.0  # measured without error: what the unknown velocity leaves
    assert max(errors(outcomes)[8:]) < 0.1
    for outcome in outcomes[1:]:
        (line,) = outcome.metrics
        assert line.map == pytest.approx(line.centre_box)
        assert line.ud_px2 == pytest.approx(line.sd[0] ** 2 + line.sd[1] ** 2)
        assert line.region50[0] < line.centre_box[0] < line.region50[1]
        assert line.particles == 200 and len(line.cloud) == 48
        assert isinstance(outcome.state.targets["1"].belief, GaussianPosterior)
        assert not outcome.events


def test_measures_are_finite_with_both_kinds_of_agents(finder_engine, fakes):
    """KL, contribution, UD and strength of an agent that measures, one that scores, one that is blind."""
    sees = {
        "scorer": scorer(fakes, 6.0),
        "blind": fakes.flat(-0.3),
    }
    engine, _ = finder_engine({}, sees)
    outcomes = fakes.play(engine, 12)
    assert max(errors(outcomes)) < 4.0
    for outcome in outcomes[1:]:
        (line,) = outcome.metrics
        for numbers in (line.kl, line.contribution, line.agent_ud_px2, line.strength):
            assert set(numbers) == {"finder", "scorer", "blind"}
            assert np.isfinite(list(numbers.values())).all() and min(numbers.values()) >= 0
        # The blind one says nothing; the sharp one says the most.
        assert line.contribution["blind"] < 1e-9 < line.contribution["scorer"] < line.contribution["finder"]
        assert line.kl["finder"] < line.kl["scorer"] < line.kl["blind"]
        assert np.isfinite([line.log_evidence, line.surprise, line.score, line.ess]).all()


def test_an_outlier_is_written_down_and_not_followed(finder_engine, fakes):
    engine, _ = finder_engine({10: 110.0})
    outcomes = fakes.play(engine, 14)
    assert max(errors(outcomes)) < 2.0
    events = [event for outcome in outcomes for event in outcome.events if not hasattr(event, "template")]
    (event,) = events
    assert isinstance(event, MeasurementGated)
    assert (event.frame, event.target, event.node, event.used, event.degrees) == (10, "1", "finder", 0, 2)
    assert event.d2 > event.limit == pytest.approx(-2 * np.log(0.01))
    assert "finder measured d²" in explain(event) and "only" not in explain(event)
    again = from_json(to_json(event))
    assert to_json(again) == to_json(event) and again.d2 == pytest.approx(event.d2, rel=1e-8)
    # Without a gate it is followed.
    engine, _ = finder_engine({10: 110.0}, belief={"gaussian": {"filter": "kalman", "gate": 1}})
    assert max(errors(fakes.play(engine, 14))) > 10


def test_through_an_occlusion_it_predicts(finder_engine, fakes):
    """Unseen for ten frames: the covariance grows, the window with it, the status is lost and found again."""
    unseen = dict.fromkeys(range(15, 25))
    engine, plane = finder_engine(unseen, lost={"above": {"ud_px2": 1e6}, "frames": 3})
    outcomes = fakes.play(engine, 32)
    uds = [outcome.metrics[0].ud_px2 for outcome in outcomes]
    assert all(np.diff(uds[14:25]) > 0)
    assert uds[25] < 0.2 * uds[24]
    assert max(errors(outcomes)) < 6.0  # a random walk of velocity that did not happen: nothing pulls it away
    statuses = [outcome.metrics[0].status for outcome in outcomes]
    assert statuses[14] == "tracking" and "lost" in statuses[15:25] and statuses[-1] == "tracking"
    # The planes of each frame cover the prediction: grown while unseen (the first plane is the reference's).
    width = [region.x1 - region.x0 for region in plane.computed[1:]]
    assert width[23] > 1.5 * width[13]


@pytest.mark.parametrize("kind", ["extended", "unscented"])
@pytest.mark.parametrize("likelihood", ["samples", "sigma_points"])
def test_every_filter_follows_scores(kind, likelihood, fakes):
    sees = {"scorer": scorer(fakes, 5.0)}
    belief = {"gaussian": {"filter": kind, "likelihood": likelihood}}
    noise = {"sd_box": {"x": 0.1, "y": 0.1}, "sd_log": {"scale": 0.02}}
    nodes = {
        "root": {"belief": belief, "motion": {"constant_velocity": noise}, "estimate": "mean"},
        "scorer": "root",
    }
    engine, _ = fakes.engine(nodes, sees)
    outcomes = fakes.play(engine, 25)
    # Steady sd below 4 px on each axis; 4 of it.
    assert max(errors(outcomes)) < 4 * 4
    assert not [e for o in outcomes for e in o.events if isinstance(e, DegenerateBelief)]
    assert all(np.linalg.eigvalsh(o.covariances["1"]).min() >= -1e-9 for o in outcomes[1:])


def test_a_motion_of_ones_own_takes_the_graphs_place(finder_engine, fakes):
    """A target that is said to move by 2 px per frame needs no time to find its velocity."""
    motion = FunctionMotion(
        ("x", "y", "w", "h"),
        lambda states, dt: states + np.array([SPEED * dt, 0, 0, 0]),
        np.diag([0.01, 0.01, 0.0, 0.0]),
    )
    engine, _ = finder_engine({}, motion=motion, belief={"gaussian": {"filter": "extended"}})
    assert max(errors(fakes.play(engine, 10))) < 1e-6
    with pytest.raises(ValueError, match="'other'; the graph has plate"):
        make_engine(
            fakes.graph({"root": {}, "a": "root"}, {"a": fakes.declare(None)}), 0, {}, {"other": motion}
        )


def test_trackers_take_a_motion(rng, tmp_path):
    picture = rng.integers(0, 255, (80, 100, 3), dtype=np.uint8)
    graph = GraphSpec.model_validate(
        {
            "name": "g",
            "targets": {
                "t": {
                    "nodes": {
                        "root": {
                            "belief": {"gaussian": {"filter": "unscented"}},
                            "motion": {"random_walk": {"sd_px": {"x": 1}}},
                            "estimate": "mean",
                        },
                        "a": {"parent": "root", "agent": "intensity"},
                    }
                }
            },
        }
    )
    motion = FunctionMotion(
        ("x", "y", "w", "h"), lambda states, dt: states + np.array([3.0, 0, 0, 0]), 1e-8 * np.eye(4)
    )
    tracker = Tracker(graph, motion=motion)
    tracker.init(picture, (20, 20, 24, 24))
    ok, box = tracker.update(picture)
    assert ok and box == pytest.approx((23, 20, 24, 24), abs=0.01)
    for n in range(3):
        cv2.imwrite(str(tmp_path / f"{n}.png"), picture)
    boxes = [
        result.targets[0].centre_box for result in track(graph, tmp_path, (20, 20, 24, 24), motion=motion)
    ]
    assert np.diff([x for x, *_ in boxes]) == pytest.approx([3, 3], abs=0.01)


def test_the_same_seed_gives_the_same_run(fakes):
    sees = {"scorer": fakes.gaussian(52, 42, 5.0, 0.02)}
    nodes = {"root": {"belief": "gaussian"}, "scorer": "root"}

    def play(seed):
        return [o.metrics for o in fakes.play(fakes.engine(nodes, sees, seed)[0], 5)]

    assert play(1) == play(1) != play(2)


def test_a_likelihood_of_zero_everywhere_keeps_the_prediction(fakes):
    """One agent kills the left half, another the right: nothing is left, and the log says so."""
    sees = {
        "left": lambda p, h, r: np.where(h.boxes[:, 0] < 50, -np.inf, 0.0),
        "right": lambda p, h, r: np.where(h.boxes[:, 0] < 50, 0.0, -np.inf),
    }
    nodes = {"root": {"belief": "gaussian", "fuse": "product"}, "left": "root", "right": "root"}
    outcomes = fakes.play(fakes.engine(nodes, sees)[0], 3)
    for n, outcome in enumerate(outcomes[1:], start=1):
        assert any(isinstance(event, DegenerateBelief) for event in outcome.events)
        # The random walk of the fakes: 64 px^2 a frame.
        assert outcome.metrics[0].sd[0] == pytest.approx(np.sqrt(64 * n))
