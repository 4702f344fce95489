"""Targets that exist with a probability and share detections, as rows and one by one."""

import json

import numpy as np
import pytest

from bayesnet_track import load_graph
from bayesnet_track.adapt.existence import DetectionModel, UnconfirmedTracks
from bayesnet_track.adapt.lifecycle import Candidate
from bayesnet_track.engine import step as steps
from bayesnet_track.engine.lifecycle.confirming import with_belief
from bayesnet_track.engine.lifecycle.sensing import Found
from bayesnet_track.engine.lifecycle.sensing import gate_boxes as gate
from bayesnet_track.engine.lifecycle.track_management import memory_of
from bayesnet_track.engine.lifecycle.track_table import LiveTable
from bayesnet_track.engine.lifecycle.unconfirmed import PRESENT, CrowdRule, confirmed, first_population
from bayesnet_track.engine.rows import finding
from bayesnet_track.engine.starts import start_targets
from bayesnet_track.engine.targets import Targets
from bayesnet_track.journal.codec import to_json
from bayesnet_track.journal.events.lives import CandidateConfirmed, TargetDied
from bayesnet_track.journal.events.statuses import StatusChanged
from bayesnet_track.observation.detector import Detections
from bayesnet_track.observation.planes import Frame
from bayesnet_track.runtime.checkpoints.state_codec import decode_state, encode_state
from bayesnet_track.sources.detection_files import FileDetector
from simulated.crowd_detector import DetectorSettings, detect_crowd
from simulated.walkers import CrowdSettings, make_crowd

IMAGE = np.zeros((480, 720, 3), np.uint8)
FRAMES = 20


def has_table(outcome):
    """True where targets are rows of a table of Gaussian beliefs."""
    return bool(Targets.of(outcome.state.targets).gaussians)


@pytest.fixture(scope="module")
def found():
    """Detections of people who come, go and run side by side, with misses and false boxes."""
    people = CrowdSettings(720, 480, 110, 9, births=0.2, life=30.0, crossings=2, beside=2)
    reported = detect_crowd(make_crowd(people, 4), DetectorSettings(missed=0.25, clutter=2.0), 4)
    return {index: one.detections for index, one in enumerate(reported[30 : 30 + FRAMES])}


def outcomes(graph, found, frames=FRAMES, times=None):
    """An outcome per frame; `times` of the frames in nominal intervals, where they are not 0, 1, 2, ..."""
    engine = steps.make_engine(graph, 0, detectors={"detections": FileDetector(found)})
    done = []
    for index in range(frames):
        time = float(index if times is None else times[index])
        frame = Frame(index=index, time=time, time_s=time / 25, image=IMAGE)
        if done:
            done.append(steps.step(engine, done[-1].state, frame))
        else:
            done.append(start_targets(graph, engine, frame, ()))
    return done


def assert_alike(rows, singles, unlike):
    """The same decisions; numbers differ by rounding, in what is next to nothing.

    Lines stand in any order: a target that goes on elsewhere is the last row.
    """

    def of(outcome):
        return [*outcome.events, *sorted(outcome.metrics, key=lambda line: line.target)]

    for own, other in zip(rows, singles, strict=True):
        assert own.state.net == other.state.net
        for a, b in zip(of(own), of(other), strict=True):
            assert unlike(json.loads(to_json(a)), json.loads(to_json(b)), rel=1e-7, abs=1e-12) == []


def jpda(**changes):
    written = load_graph("jpda").spec.model_dump(exclude_unset=True)
    (plate,) = written["targets"].values()
    plate["existence"] = {**plate["existence"], **changes.pop("existence", {})}
    plate |= changes
    return load_graph(written)


@pytest.fixture(scope="module")
def graph():
    return jpda(existence={"confirm": 0.9})


def seen_at(boxes):
    boxes = np.array(boxes, dtype=float).reshape(-1, 4)
    return Detections(boxes, np.ones(len(boxes)), ("",) * len(boxes))


def events_of(done, kind):
    return [event for one in done for event in one.events if isinstance(event, kind)]


@pytest.mark.slow
@pytest.mark.parametrize("associate", ["marginal", "assignment"])
def test_targets_have_the_same_results_as_rows_and_as_objects(associate, found, monkeypatch, unlike):
    own = jpda(associate=associate)
    rows = outcomes(own, found)
    assert sum(map(has_table, rows)) > FRAMES - 8
    assert events_of(rows, StatusChanged) and events_of(rows, TargetDied)
    monkeypatch.setattr(finding, "net_fits", lambda rule, net: False)
    assert_alike(rows, outcomes(own, found), unlike)


def test_an_end_names_every_rule_that_holds():
    says = {k: seen_at([100 + k, 200, 40, 80]) for k in range(10)}

    def death(**rules):
        graph = jpda(death=rules, existence={"missed_frames": 1})
        return events_of(outcomes(graph, says, 20), TargetDied)[0]

    alone, last = death(lost_frames=2), death(lost_frames=100)
    assert alone.describe().endswith("would have continued at lost_frames ≥ 3"), "it still exists"
    assert last.reason == "existence" and last.describe().endswith("continued at existence.end ≤ 0.0104")
    both = death(lost_frames=3)
    assert both.frame == last.frame and both.describe().startswith("lost for 3 frames")
    assert both.describe().endswith("continued at lost_frames ≥ 4 and existence.end ≤ 0.0104")
    unseen = death(lost_frames=3, unseen_frames=5)
    assert unseen.frame == last.frame and unseen.reason == "lost"
    assert "lost_frames ≥ 4 and unseen_frames ≥ 6 and existence.end ≤ 0.0104" in unseen.describe()


def test_births_statuses_and_ends_are_levels_of_existence(graph):
    says = {k: seen_at([100 + 2 * k, 100, 30, 60]) for k in range(20)}
    done = outcomes(graph, says, 40)
    (born,), (died,) = events_of(done, CandidateConfirmed), events_of(done, TargetDied)
    assert 1 <= born.frame <= 6 and born.existence >= born.confirm == 0.9
    assert "existence" in born.describe() and "is new" in born.describe()
    (lost,) = events_of(done, StatusChanged)
    assert 20 < lost.frame < died.frame < 40
    assert "existence in box 0." in lost.describe()
    assert "would not have been lost at lost.existence_in_box_below ≤" in lost.describe()
    assert died.reason == "existence" and died.existence < died.end == 0.05
    assert "would have continued at existence.end ≤" in died.describe()
    values = [line.existence for one in done for line in one.metrics if line.existence is not None]
    assert values[5] > 0.99 and values[-1] == pytest.approx(died.existence)
    assert '"existence": ' in to_json(done[10].metrics[0])


def test_more_false_detections_make_births_later(graph):
    def first_birth(clutter):
        rng = np.random.default_rng(3)
        says = {}
        for k in range(25):
            heights = rng.uniform(50, 70, clutter)
            false = np.column_stack(
                [rng.uniform(0, 700, clutter), rng.uniform(0, 470, clutter), heights / 2, heights]
            )
            says[k] = seen_at(np.concatenate([[[100.0 + 2 * k, 100, 30, 60]], false]))
        born = [one for one in events_of(outcomes(graph, says, 25), CandidateConfirmed)]
        return min(one.frame for one in born), len(born)

    (early, one), (late, several) = first_birth(0), first_birth(30)
    assert early <= late and one == 1 and several <= 2


def test_a_target_that_another_covers_is_kept_through_misses(graph):
    boxes = [[[100, 100, 30, 60], [160 - 3 * min(k, 18), 100, 30, 60]] for k in range(40)]
    says = {k: seen_at(both if k < 15 else both[:1]) for k, both in enumerate(boxes)}
    kept = outcomes(graph, says, 24)
    far = {k: seen_at([[100, 100, 30, 60], [400, 100, 30, 60]][: 2 if k < 15 else 1]) for k in range(40)}
    gone = outcomes(graph, far, 40)
    assert len(kept[-1].state.targets) == 2 and len(gone[-1].state.targets) == 1
    known = kept[-1].state.history.detection_models["target"].known
    in_front, behind = known.of(tuple(kept[-1].state.targets)).hidden
    assert in_front < 0.1 and behind > 0.8


@pytest.mark.slow
def test_second_boxes_on_a_person_become_targets_less_often_once_they_are_known():
    """Runs of five frames, twelve frames apart, at another place of the person each time."""
    rng, says = np.random.default_rng(5), {}
    shift = rng.uniform(-0.3, 0.3, (20, 2))
    for k in range(150):
        person = np.array([100.0 + 2 * k, 200, 60, 150])
        second = person + [*(shift[k // 12] * [60, 150]), -15, -40]
        boxes = [person, second] if k % 12 < 5 else [person]
        says[k] = seen_at(np.array(boxes) + rng.normal(0, 2, (len(boxes), 4)))

    def reported(**existence):
        done = outcomes(jpda(existence=existence), says, 150)
        return sum(len(one.metrics.held()[0]) - 1 for one in done[75:])

    lasting, single = reported(), reported(false_frames=1)
    assert lasting < 0.7 * single, (lasting, single)


def test_a_target_whose_place_is_no_longer_known_is_lost_although_it_exists():
    """Hidden behind one who walks along, it is kept, and not reported."""
    front = [[100.0 + 3 * k, 200, 60, 150] for k in range(60)]
    says = {
        k: seen_at([front[k], [120.0 + 3 * k, 205, 60, 150]] if k < 12 else [front[k]]) for k in range(60)
    }
    done = outcomes(jpda(existence={"survival": 1}), says, 60)
    kept = [
        line for one in done[15:] for line in one.metrics if line.status == "lost" and line.existence > 0.5
    ]
    assert kept and len({line.target for line in kept}) == 1


def test_a_frame_without_a_look_is_no_miss():
    own = jpda(birth={**jpda().spec.targets["target"].birth.model_dump(), "every": 2, "confirm": {}})
    says = {k: seen_at([100, 100, 30, 60]) for k in range(0, 30, 2)}
    done = outcomes(own, says, 30)
    after_birth = [line.existence for one in done[8:] for line in one.metrics]
    assert len(after_birth) == 22 and min(after_birth) > 0.95


@pytest.mark.parametrize("gap", [1, 3])
def test_survival_is_per_nominal_interval_not_per_frame(gap):
    """Exact in a frame without a look: nothing but the time since the last one bears on existence."""
    birth = {**jpda().spec.targets["target"].birth.model_dump(), "every": 2, "confirm": {}}
    own = jpda(birth=birth, existence={"survival": 0.9})
    says = {k: seen_at([100, 100, 30, 60]) for k in range(0, 12, 2)}
    done = outcomes(own, says, 12, [*range(11), 10 + gap])
    (before,), (after,) = ([line.existence for line in one.metrics] for one in done[-2:])
    assert 0.9 < before <= 1.0
    assert after == pytest.approx(before * 0.9**gap, rel=1e-9)


@pytest.mark.parametrize("births", [0.1, 2.0])
def test_detections_of_nobody_are_false_but_for_the_share_of_new_targets(births):
    """Each is somewhere else in each frame, so that it is free for sure."""
    says = {k: seen_at([[20 + 110 * k + 340 * far, 40 + 60 * k, 30, 60] for far in (0, 1)]) for k in range(4)}
    done = outcomes(jpda(existence={"births": births}), says, 4)
    before, after = (done[k].state.history.detection_models["target"] for k in (2, 3))
    false = 2 * (1 - births / (births + before.clutter))
    assert after.frames == before.frames + 1
    expected = before.clutter + (false - before.clutter) / after.frames
    assert after.clutter == pytest.approx(expected, rel=1e-3)


def test_false_detections_of_a_first_frame_leave_out_the_share_of_new_targets():
    births, start = 2.0, DetectionModel(UnconfirmedTracks.none(4))
    done = outcomes(
        jpda(existence={"births": births}), {0: seen_at([[20, 40, 30, 60], [400, 40, 30, 60]])}, 1
    )
    after, if_false = done[0].state.history.detection_models["target"], start.after_look(2.0).clutter
    false = 2 * (1 - births / (births + if_false))
    assert after.clutter == pytest.approx(start.clutter + (false - start.clutter) / after.frames)


def log_odds_without_rates(clutter, births):
    """Log of N(z; m, P + R) over a density of boxes, from a prospect's existence after its second look."""
    own = jpda(
        existence={"clutter": clutter, "births": births, "detection": 0.5, "confirm": 0.999999}
        | {"missed_frames": 1, "false_frames": 1}
    )
    says = {0: seen_at([[100, 100, 30, 60]]), 1: seen_at([[112, 106, 30, 60]])}
    done = outcomes(own, says, 2)
    first, second = (one.state.history.detection_models["target"].unconfirmed.existence for one in done)
    hit = 0.995 * first[0] * 0.5
    silent = hit / (1 - hit)
    seen = (second[0] - silent) / (1 - silent)
    return np.log(seen / (1 - seen) / (hit / (1 - hit)) * (clutter + births))


def test_a_detection_that_is_no_targets_is_false_or_of_a_new_one():
    """Both rates stand against a target: what is left of its odds is the same for all of them."""
    odds = [log_odds_without_rates(*rates) for rates in ((2.0, 2.0), (0.5, 2.0), (2.0, 0.5), (0.1, 6.0))]
    np.testing.assert_allclose(odds, odds[0], atol=1e-6)


def test_a_state_that_was_stored_goes_on_to_the_same_bytes(graph, found):
    done = outcomes(graph, found, 25)
    engine = steps.make_engine(graph, 0, detectors={"detections": FileDetector(found)})
    frames = [Frame(index=k, time=float(k), time_s=k / 25, image=IMAGE) for k in (23, 24)]
    state = decode_state(encode_state(done[23].state), engine, frames[0])
    again = steps.step(engine, state, frames[1])
    assert [to_json(one) for one in again.metrics] == [to_json(one) for one in done[24].metrics]
    own, other = (one.state.history.detection_models["target"] for one in (again, done[24]))
    assert (own.clutter, own.hits) == (other.clutter, other.hits)
    np.testing.assert_array_equal(own.unconfirmed.existence, other.unconfirmed.existence)


def test_looks_say_whose_a_detection_is_where_the_agent_asks_for_them(monkeypatch):
    from bayesnet_track.engine.lifecycle import association

    written = load_graph("people_detections").spec.model_dump(exclude_unset=True)
    (plate,) = written["targets"].values()
    del plate["birth"]["confirm"]
    plate |= {"existence": {}, "associate": "marginal"}
    own = load_graph(written)
    asked = []

    def looks(work, compiled, targets, known, boxes, starts):
        asked.extend(targets)
        assert {*known} >= {"color", "shade"} and starts[-1] == len(boxes)
        return np.zeros(len(boxes))

    monkeypatch.setattr(association, "score_looks", looks)
    image = np.random.default_rng(0).integers(0, 255, (200, 300, 3)).astype(np.uint8)
    engine = steps.make_engine(
        own, 0, detectors={"detections": FileDetector({k: seen_at([90, 90, 30, 60]) for k in range(8)})}
    )
    state = None
    for k in range(8):
        frame = Frame(index=k, time=float(k), time_s=k / 25, image=image)
        outcome = start_targets(own, engine, frame, ()) if state is None else steps.step(engine, state, frame)
        state = outcome.state
    assert list(state.targets) == ["1"] and set(asked) == {"1"}


def test_a_plate_without_existence_has_no_such_rule():
    engine = steps.make_engine(load_graph("kalman_detections"), 0, detectors={"detections": FileDetector({})})
    (compiled,) = engine.plates.values()
    assert CrowdRule.of(compiled) is None and compiled.first_existence is None
    rule = next(iter(compiled.association_rules.values()))
    assert len(gate(rule, np.empty((0, 4)), np.empty((0, 4, 4)), np.ones((2, 4))).rows) == 0


def test_a_prospect_begins_with_the_share_of_new_targets_among_free_detections():
    own = jpda(existence={"clutter": 0.3})
    compiled = steps.make_engine(own, 0, detectors={"detections": FileDetector({})}).plates["target"]
    rule = CrowdRule.of(compiled)
    boxes = np.array([[100.0, 100, 30, 60], [300, 200, 30, 60]])
    seventh = Frame(7, 7.0, np.zeros((480, 640, 3), np.uint8))
    model = first_population(rule, Found(boxes, np.ones(2), np.arange(2)), seventh)
    unconfirmed = model.unconfirmed
    np.testing.assert_allclose(model.begin(rule.existence, np.zeros(2), 1.0).target, 0.1 / (0.1 + 0.3))
    np.testing.assert_allclose(unconfirmed.existence, PRESENT / (PRESENT + 1.0))  # who is there is not new
    np.testing.assert_array_equal(unconfirmed.mean[:, :4], boxes)
    assert unconfirmed.first.tolist() == [7, 7] and confirmed(rule, unconfirmed, "target", 7.0) == {}


def test_a_target_starts_and_is_remembered_with_the_belief_that_it_has(graph):
    done = outcomes(graph, {k: seen_at([100, 100, 30, 60]) for k in range(8)}, 8)[-1]
    ((target, state),) = done.state.targets.items()
    mean, spread = state.belief.mean + 3.0, 2.0 * state.belief.covariance
    waiting = Candidate(mean[:4], np.zeros(2), (1.0,), 5, "birth")
    assert with_belief(state, waiting, ()) is state  # it has no belief
    born = with_belief(state, Candidate(mean[:4], np.zeros(2), (1.0,), 5, "birth", mean, spread, 0.93), ())
    assert born.existence == 0.93
    np.testing.assert_array_equal(born.belief.mean, mean)
    np.testing.assert_array_equal(born.belief.covariance, spread)
    memory = memory_of(LiveTable.of(None, done), target, "target")
    np.testing.assert_array_equal(memory.mean, done.state.history.records[target].mean)
