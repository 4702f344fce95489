"""Births, returns and deaths in the engine: counts, caps, identities and replay, with fake detectors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import islice, pairwise

import numpy as np
import pytest

from bayesnet_track import CueDeclaration, CueParameters, Tracker, load_graph
from bayesnet_track.engine.lines import Lines
from bayesnet_track.engine.outcome import Outcome, State
from bayesnet_track.engine.step import first_look, make_engine, start_target, step
from bayesnet_track.graph.checks.run import check_graph
from bayesnet_track.journal.events.lives import (
    BirthsRefused,
    CandidateConfirmed,
    DetectionsCut,
    DetectorFailed,
    DuplicateEnded,
    Reacquired,
    Returned,
    TargetDied,
    TargetStarted,
)
from bayesnet_track.journal.events.statuses import StatusChanged
from bayesnet_track.journal.net import Decision, replay
from bayesnet_track.observation.detector import Detections
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.scenes.library import SceneSource

SIDE = 12.0


@dataclass(frozen=True)
class Script:
    """A detector that finds what `says(frame)` holds: (x, y) or (x, y, score) each."""

    says: object

    def start(self):
        return {"frames": np.zeros(())}

    def detect(self, frames, state):
        found = self.says(frames.current.index)
        boxes = np.array([[one[0], one[1], SIDE, SIDE] for one in found]).reshape(-1, 4)
        scores = np.array([one[2] if len(one) > 2 else 0.9 for one in found])
        return Detections(boxes, scores, ("",) * len(found)), {"frames": state["frames"] + 1}


@dataclass(frozen=True)
class Painted:
    """A cue that likes boxes whose centre pixel has the gray level it learnt; none outside the picture."""

    needs: tuple = ()

    def learn(self, planes, box):
        return {"level": np.array(float(level_at(planes.frame, box[:2])))}

    def blend(self, old, new, rate):
        return old

    def log_likelihood(self, planes, hypotheses, reference):
        levels = np.array([level_at(planes.frame, xy) for xy in hypotheses.boxes[:, :2]], dtype=float)
        return np.where(np.abs(levels - reference["level"]) < 10, 0.0, np.log(0.01))


def level_at(frame, xy):
    x = int(np.clip(np.rint(xy[0]), 0, frame.width - 1))
    y = int(np.clip(np.rint(xy[1]), 0, frame.height - 1))
    return frame.image[y, x, 0]


def picture(index, *things):
    """Frame with squares of a gray level at (x, y, level) on black."""
    image = np.zeros((100, 120, 3), np.uint8)
    for x, y, level in things:
        x, y, r = round(x), round(y), int(SIDE // 2)
        image[max(y - r, 0) : y + r, max(x - r, 0) : x + r] = level
    return Frame(index, float(index), image)


def engine_of(says, seed=0, birth=None, **life):
    cue = CueDeclaration("painted", "", CueParameters, lambda p: Painted())
    kind = {
        "birth": {"detector": "detections", **(birth or {})},
        **life,
        "nodes": {
            "s": {
                "motion": {"random_walk": {"sd_px": {"x": 3, "y": 3}}},
                "belief": {"particles": {"size": 150}},
            },
            "a": {"parent": "s", "agent": "painted"},
        },
    }
    cues = {"painted": cue}
    graph = check_graph({"name": "g", "targets": {"square": kind}}, cues)
    return make_engine(graph, seed, cues, detectors={"detections": Script(says)})


def play(engine, frames):
    outcomes = [first_look(engine, Outcome(State(), Lines(), ()), frames[0])]
    for frame in frames[1:]:
        outcomes.append(step(engine, outcomes[-1].state, frame))
    return outcomes


def events_of(outcomes, kind):
    return [event for outcome in outcomes for event in outcome.events if isinstance(event, kind)]


def at(*places, first=0, until=10**6):
    return lambda frame: places if first <= frame < until else ()


def still(count, *things):
    return [picture(n, *things) for n in range(count)]


# ------------------------------------------------------------------------------------ births


@pytest.mark.parametrize(("looks", "of", "born"), [(1, 1, 0), (3, 4, 5), (2, 2, 5)])
def test_a_target_is_born_when_it_was_seen_often_enough(looks, of, born):
    """Seen in frames 0, 2, 4, 5, 6: three of four looks first at 5 (2, 4, 5), two of two at 5."""
    says = lambda frame: ((50, 40),) if frame in (0, 2, 4, 5, 6) else ()  # noqa: E731
    engine = engine_of(says, birth={"confirm": {"hits": looks, "of": of}})
    outcomes = play(engine, still(8, (50, 40, 200)))
    (event,) = events_of(outcomes, CandidateConfirmed)
    assert (event.frame, event.target, event.seen, event.nearest) == (born, "1", looks, None)
    (started,) = events_of(outcomes, TargetStarted)
    assert (started.frame, started.target, started.box) == (born, "1", (50.0, 40.0, SIDE, SIDE))
    assert [len(o.metrics) for o in outcomes] == [int(n >= born) for n in range(8)]


def test_looks_are_as_far_apart_as_the_graph_says():
    engine = engine_of(at((50, 40)), birth={"every": 3, "confirm": {"hits": 2, "of": 2}})
    outcomes = play(engine, still(8, (50, 40, 200)))
    assert [e.frame for e in events_of(outcomes, TargetStarted)] == [3]
    assert int(outcomes[-1].state.history.detectors["detections"]["frames"]) == 3


def test_a_live_target_claims_its_detection_and_ids_go_on():
    """The start box is target 1; only the other detection is born, as 2, at the first look."""
    engine = engine_of(at((50, 40), (90, 70)), birth={"confirm": {"hits": 1, "of": 1}})
    frames = still(6, (50, 40, 200), (90, 70, 120))
    begun = start_target(engine, State(), frames[0], "1", "square", np.array([50.0, 40, SIDE, SIDE]))
    outcomes = [first_look(engine, begun, frames[0])]
    for frame in frames[1:]:
        outcomes.append(step(engine, outcomes[-1].state, frame))
    assert [(e.frame, e.target) for e in events_of(outcomes, TargetStarted)] == [(0, "1"), (0, "2")]
    assert all([m.target for m in o.metrics] == ["1", "2"] for o in outcomes)


def test_the_same_object_detected_twice_is_one_target():
    engine = engine_of(at((50, 40), (53, 40, 0.5)), birth={"confirm": {"hits": 2, "of": 2}, "detector": RAW})
    outcomes = play(engine, still(8, (50, 40, 200)))
    assert [e.box[0] for e in events_of(outcomes, TargetStarted)] == [50.0]


RAW = {"detections": {"max_overlap": 1, "max_count": 1000, "min_score": 0}}


def test_a_detector_that_fires_everywhere_gives_no_more_nets_than_the_graph_allows():
    rng = np.random.default_rng(0)
    crowd = [tuple(map(tuple, rng.uniform((5, 5), (115, 95), (1000, 2)))) for _ in range(6)]
    birth = {"confirm": {"hits": 1, "of": 1}, "max_targets": 5, "detector": RAW}
    engine = engine_of(lambda frame: crowd[frame], birth=birth, reidentify={"lost": False})
    outcomes = play(engine, still(6))
    assert max(len(o.state.targets) for o in outcomes) == 5
    assert max(len(o.state.history.candidates["square"]) for o in outcomes) <= 10
    refused = events_of(outcomes, BirthsRefused)
    assert 1 <= len(refused) <= 3 and refused[0].live == refused[0].max_targets == 5
    assert [e.refused for e in refused] == sorted(e.refused for e in refused)


def test_an_object_that_is_detected_twice_is_refused_once():
    birth = {"confirm": {"hits": 1, "of": 1}, "detector": RAW}
    says = lambda n: ((90, 70), *(((30, 40, 0.8), (33, 40, 0.5)) if n else ()))  # noqa: E731
    frames = still(3, (90, 70, 200), (30, 40, 200))
    refused = events_of(play(engine_of(says, birth={**birth, "max_targets": 1}), frames), BirthsRefused)
    assert (refused[0].frame, refused[0].waiting) == (1, 1)
    assert refused[0].describe().endswith("would have started at max_targets ≥ 2")
    enough = play(engine_of(says, birth={**birth, "max_targets": 2}), frames)
    assert events_of(enough, BirthsRefused) == [] and len(enough[-1].state.targets) == 2


def test_detections_beyond_the_number_that_is_used_are_told_of_by_powers_of_ten():
    birth = {"detector": {"detections": {"max_count": 4, "max_overlap": 1}}, "max_targets": 9}
    crowded = tuple((20 + 14 * number, 40, 0.9 - 0.01 * number) for number in range(6))
    engine = engine_of(lambda frame: crowded if frame != 2 else crowded[:4], birth=birth)
    outcomes = play(engine, still(12, *((x, y, 200) for x, y, _ in crowded)))
    cut = events_of(outcomes, DetectionsCut)
    assert cut == [DetectionsCut(0, "detections", 4, 2, 1), DetectionsCut(10, "detections", 4, 2, 10)]
    assert len(outcomes[-1].state.targets) == 4


def test_a_detector_that_finds_nothing_leaves_no_target_and_no_event():
    outcomes = play(engine_of(at()), still(5))
    assert all(o.metrics == () and o.events == () and not o.state.targets for o in outcomes)


@pytest.mark.parametrize("fault", ["raise", "shape", "nan"])
def test_a_detector_that_fails_is_out_and_the_run_goes_on(fault):
    class Broken:
        def start(self):
            return {}

        def detect(self, frames, state):
            if fault == "raise":
                raise OSError("no such thing")
            boxes = np.full((1, 4), np.nan) if fault == "nan" else np.ones(4)
            return Detections(boxes, np.ones(1), ("",)), state

    engine = engine_of(at())
    engine = replace(engine, detectors=dict.fromkeys(engine.detectors, Broken()))
    outcomes = play(engine, still(4))
    (failed,) = events_of(outcomes, DetectorFailed)
    assert (failed.frame, failed.detector, failed.until) == (0, "detections", 10)


def test_a_detector_that_fails_is_tried_again_after_a_while_that_doubles():
    asked = []

    class Broken:
        def start(self):
            return {"seen": np.zeros(1)}

        def detect(self, frames, state):
            index = frames.current.index
            asked.append((index, float(state["seen"][0])))
            if 3 <= index < 20:
                raise OSError("no such thing")
            return Detections(np.array([[50.0, 40.0, 20.0, 20.0]]), np.ones(1), ("",)), {
                "seen": state["seen"] + 1
            }

    engine = engine_of(at())
    engine = replace(engine, detectors=dict.fromkeys(engine.detectors, Broken()))
    outcomes = play(engine, still(36))
    failed = events_of(outcomes, DetectorFailed)
    assert [(e.frame, e.until, e.times) for e in failed] == [(3, 13, 1), (13, 33, 2)]
    # It goes on with what it remembered before it failed.
    assert asked == [(0, 0.0), (1, 1.0), (2, 2.0), (3, 3.0), (13, 3.0), (33, 3.0), (34, 4.0), (35, 5.0)]


# ------------------------------------------------------------------------------------ ends and returns

FAST = {"birth": {"confirm": {"hits": 1, "of": 1}}, "death": {"lost_frames": 4}}


def vanishing(level_after, back=20, x_after=50):
    """A square of level 200 until frame 5, then nothing, then one of `level_after` from `back` on."""
    things = lambda n: [(50, 40, 200)] if n < 5 else [(x_after, 40, level_after)] if n >= back else []  # noqa: E731
    frames = [picture(n, *things(n)) for n in range(back + 4)]
    says = lambda n: ((50, 40),) if n < 5 else ((x_after, 40),) if n >= back else ()  # noqa: E731
    return frames, says


def test_a_lost_target_dies_and_returns_with_its_identity_when_it_looks_the_same():
    frames, says = vanishing(200)
    outcomes = play(engine_of(says, **FAST), frames)
    (lost,) = events_of(outcomes, StatusChanged)
    (died,) = events_of(outcomes, TargetDied)
    assert (died.frame, died.target, died.reason) == (lost.frame + 3, "1", "lost") and died.remembered
    assert outcomes[died.frame].state.net.targets == {}
    (back,) = events_of(outcomes, Returned)
    assert (back.frame, back.target, back.recognition.rival) == (20, "1", "new")
    by = back.recognition
    odds = np.exp(by.fading + by.place + by.appearance)
    assert by.probability == pytest.approx(odds / (1 + odds)) and by.probability > 0.9
    # The level is seen nowhere else, of likelihood .01 there; one new target in 20 would look the same.
    assert by.appearance == pytest.approx(-np.log(0.05 + 0.95 * 0.01), abs=1e-9)
    assert outcomes[-1].state.targets["1"].references["a"]["level"] == 200
    assert outcomes[-1].metrics[0].status == "tracking"
    assert len(events_of(outcomes, TargetStarted)) == 1


def test_another_object_is_a_new_target():
    frames, says = vanishing(90, x_after=75)
    outcomes = play(engine_of(says, **FAST), frames)
    first, second = events_of(outcomes, CandidateConfirmed)
    assert (first.target, second.target, second.nearest.target) == ("1", "2", "1")
    assert second.nearest.appearance == pytest.approx(np.log(0.01 / (0.05 + 0.95 * 0.01)), abs=1e-9)
    assert second.nearest.probability < 0.3 and second.nearest.distance_px == pytest.approx(25, abs=4)
    assert events_of(outcomes, Returned) == []


def test_a_dead_target_is_forgotten_in_time():
    frames, says = vanishing(200)
    outcomes = play(engine_of(says, **FAST, reidentify={"frames": 10}), frames)
    assert [e.target for e in events_of(outcomes, CandidateConfirmed)] == ["1", "2"]
    assert outcomes[-1].state.history.dead == ()


def test_a_lost_target_is_found_again_where_a_detection_looks_like_it():
    frames, says = vanishing(200, back=12, x_after=65)
    life = {**FAST, "death": {"lost_frames": 100}}
    outcomes = play(engine_of(says, **life), frames)
    (found,) = events_of(outcomes, Reacquired)
    assert (found.frame, found.target, found.box[0]) == (12, "1", 65.0)
    assert [m.target for m in outcomes[-1].metrics] == ["1"]
    assert outcomes[-1].metrics[0].status == "tracking"
    assert abs(outcomes[-1].metrics[0].centre_box[0] - 65) < SIDE / 2
    off = engine_of(says, **life, reidentify={"lost": False})
    assert events_of(play(off, frames), Reacquired) == []


def test_a_target_that_is_not_detected_dies_where_the_graph_says_so():
    engine = engine_of(
        at((50, 40), until=3), birth={"confirm": {"hits": 1, "of": 1}}, death={"unseen_frames": 4}
    )
    outcomes = play(engine, still(9, (50, 40, 200)))
    (died,) = events_of(outcomes, TargetDied)
    assert (died.frame, died.reason, died.frames) == (6, "unseen", 4)


def test_of_two_nets_that_hold_one_object_the_younger_ends():
    """A second net starts apart from the first, on a square that then moves onto the first one's."""
    near = [(50 + max(40 - 4 * n, 0), 40) for n in range(25)]
    frames = [picture(n, (*near[n], 200), (50, 40, 200)) for n in range(25)]
    birth = {"confirm": {"hits": 1, "of": 1}, "min_distance_box": 0.5}
    engine = engine_of(
        lambda n: ((50, 40), near[n])[: 1 + (n > 0)], birth=birth, merge_duplicates={"frames": 3}
    )
    outcomes = play(engine, frames)
    (ended,) = events_of(outcomes, DuplicateEnded)
    assert (ended.target, ended.kept, ended.frames) == ("2", "1", 3)
    assert 0.7 <= ended.overlap <= 1 and list(outcomes[-1].state.targets) == ["1"]
    assert outcomes[-1].state.history.overlaps == {}


def test_the_overlap_of_two_nets_is_forgotten_when_both_end():
    """Both end in one frame and return: the younger ends after as many frames as a new one would."""
    detected = ((50, 40), (53, 40, 0.5))
    engine = engine_of(
        lambda n: detected if n < 5 or n >= 12 else (),
        birth={"confirm": {"hits": 1, "of": 1}, "min_distance_box": 0.1, "max_overlap": 1, "detector": RAW},
        death={"unseen_frames": 2},
        reidentify={"lost": False, "min_probability": 0.01, "frames": 300},
        merge_duplicates={"overlap": 0.01, "frames": 8},
    )
    outcomes = play(engine, still(24, (50, 40, 200)))
    assert [(e.frame, e.target) for e in events_of(outcomes, TargetDied)] == [(6, "1"), (6, "2")]
    assert outcomes[5].state.history.overlaps and not outcomes[6].state.history.overlaps
    assert {(e.frame, e.target) for e in events_of(outcomes, Returned)} == {(12, "1"), (12, "2")}
    assert events_of(outcomes, DuplicateEnded)[0].frame == 19


# ------------------------------------------------------------------------------------ as a whole


def busy(seed):
    frames, says = vanishing(200)
    more = lambda n: (*says(n), *(((90, 75),) if n > 8 else ()))  # noqa: E731
    return play(engine_of(more, seed, **FAST), frames)


def test_the_decisions_rebuild_the_net_of_every_frame():
    outcomes = busy(0)
    decisions = [e for e in events_of(outcomes, Decision)]
    for before, outcome in pairwise(outcomes):
        frame = int(outcome.state.previous.index)
        born = [d for d in outcome.events if isinstance(d, TargetStarted | Returned)]
        began = replay(decisions, frame).targets
        assert {t: one for t, one in began.items() if t not in {d.target for d in born}} == dict(
            before.state.net.targets
        )
    assert replay(decisions).targets == outcomes[-1].state.net.targets
    assert {type(d) for d in decisions} >= {TargetStarted, Returned, TargetDied}


def test_the_same_seed_gives_the_same_life():
    one, two = busy(3), busy(3)
    assert [o.metrics for o in one] == [o.metrics for o in two]
    assert [o.events for o in one] == [o.events for o in two]


def test_a_step_leaves_what_is_remembered_as_it_was():
    frames, says = vanishing(200)
    engine = engine_of(says, **FAST)
    state = play(engine, frames[:21])[-2].state
    first, second = step(engine, state, frames[20]), step(engine, state, frames[20])
    assert first.events == second.events and events_of([first], Returned)


def test_targets_held_by_the_image_are_not_unseen_between_looks_of_their_detector():
    """The detector runs in every sixth frame: `unseen_frames: 4` counts its runs, and none misses them."""
    written = load_graph("orange_and_gray_detected").spec.model_dump(exclude_unset=True)
    for plate in written["targets"].values():
        plate["birth"]["every"], plate["death"] = 6, {"unseen_frames": 4}
    source, tracker = SceneSource(make_scene("orange_and_gray"), "scene"), Tracker(load_graph(written))
    ended = []
    for number, frame in enumerate(islice(source, 36)):
        tracker.update(frame.image) if number else tracker.init(frame.image)
        ended += [event for event in tracker.events if isinstance(event, TargetDied)]
    assert ended == [] and [one.target for one in tracker.targets] == ["1", "2"]
