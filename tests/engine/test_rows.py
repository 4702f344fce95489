"""Targets as rows of a table: no result depends on who else is in it, nor on who is an object beside it."""

import json

import numpy as np
import pytest

from bayesnet_track import load_graph
from bayesnet_track.adapt.memory import LOST
from bayesnet_track.engine import step as steps
from bayesnet_track.engine.rows import finding
from bayesnet_track.engine.rows.columns import make_rows
from bayesnet_track.engine.rows.fitting import row_rule
from bayesnet_track.engine.starts import start_targets
from bayesnet_track.engine.targets import Records, Targets
from bayesnet_track.graph.checks.run import check_graph
from bayesnet_track.graph.text.write import as_plain
from bayesnet_track.journal.codec import to_json
from bayesnet_track.journal.events.lives import CandidateConfirmed, Reacquired
from bayesnet_track.journal.events.load import LateFrame, Released, Toggled
from bayesnet_track.journal.frame_columns import columns_of
from bayesnet_track.journal.frame_file import record
from bayesnet_track.observation.detector import Detections
from bayesnet_track.observation.planes import Frame
from bayesnet_track.runtime.checkpoints.state_codec import decode_state, encode_state
from bayesnet_track.runtime.recording.tracks import FEW, Tracked, measured
from bayesnet_track.sources.detection_files import FileDetector
from simulated.crowd_detector import DetectorSettings, detect_crowd
from simulated.walkers import CrowdSettings, make_crowd

IMAGE = np.random.default_rng(0).integers(0, 256, (480, 720, 3)).astype(np.uint8)
FRAMES = 45


def has_table(outcome):
    """True where targets are rows of a table of Gaussian beliefs."""
    return bool(Targets.of(outcome.state.targets).gaussians)


@pytest.fixture(scope="module")
def graph():
    """The graph with room for a crowd, quick to give targets up."""
    written = load_graph("kalman_detections").spec.model_dump(exclude_unset=True)
    (plate,) = written["targets"].values()
    plate["birth"]["detector"] = {"detections": {"max_count": 200, "max_overlap": 0.9}}
    plate["death"]["unseen_frames"] = 8
    return load_graph(written)


@pytest.fixture(scope="module")
def found():
    """Detections of people who come, go and run side by side, with misses and false boxes."""
    people = CrowdSettings(720, 480, 110, 9, births=0.2, life=30.0, crossings=2, beside=2)
    reported = detect_crowd(make_crowd(people, 4), DetectorSettings(missed=0.25, clutter=2.0), 4)
    return {index: one.detections for index, one in enumerate(reported[30 : 30 + FRAMES])}


CHANGES = {
    "plain": {},
    "self-check": {"seen": {"self_check": {"above": {"ud_box": 0.02}, "frames": 2}}},
    "unscented": {
        "target": {"belief": {"gaussian": {"filter": "unscented", "likelihood": "sigma_points", "gate": 1}}}
    },
    "gated": {
        "target": {"belief": {"gaussian": {"filter": "kalman", "likelihood": "sigma_points", "gate": 0.9}}}
    },
    "looks": {
        "target": {"fuse": "product", "learn": {"below": {"ud_box": 0.2}, "rate_max": 0.1}},
        "seen": {"agent": {"detection": {"appearance": 0.5}}},
        "color": {"parent": "target", "active": False, "agent": {"color_histogram": {"floor": 0.003}}},
        "shade": {"parent": "target", "active": False, "agent": {"intensity": {"floor": 0.003}}},
    },
    "samples": {"target": {"belief": {"gaussian": {"filter": "kalman", "gate": 0.9, "samples": 41}}}},
}


def with_nodes(graph, name):
    """The graph with other settings of its nodes."""
    written = graph.spec.model_dump(exclude_unset=True)
    (plate,) = written["targets"].values()
    for node, settings in CHANGES[name].items():
        plate["nodes"][node] = plate["nodes"].get(node, {}) | settings
    return load_graph(written)


def outcomes(graph, found, inputs=None, frames=FRAMES):
    """An outcome per frame; `inputs` are those of frames, or a function of the last state."""
    engine = steps.make_engine(graph, 0, detectors={"detections": FileDetector(found)})
    done = []
    for index in range(frames):
        frame = Frame(index=index, time=float(index), time_s=index / 25, image=IMAGE)
        if not done:
            done.append(start_targets(graph, engine, frame, ()))
            continue
        state = done[-1].state
        given = inputs(index, state) if callable(inputs) else (inputs or {}).get(index, ())
        done.append(steps.step(engine, state, frame, given))
    return done


def apart(graph, found, inputs=None, frames=FRAMES):
    """The same where a person keeps every target's agent on, so that none is a row."""

    def keep(index, state):
        other = (inputs or {}).get(index, ())
        switched = {one.target for one in other if isinstance(one, Toggled | Released)}
        off = {target for target, net in state.net.targets.items() if not net.active} - switched
        own = [target for target in state.net.targets if target not in off | switched]
        return (*other, *(Toggled(0, target, "seen", True) for target in own))

    return outcomes(graph, found, keep, frames)


def assert_alike(rows, singles, unlike):
    """Events are the same bytes, in any order; metrics differ by rounding in what is next to nothing.

    The UD of an agent that says nothing is that around any of equal hypotheses, as rounding has it.
    """

    def written(done):
        return sorted(to_json(one) for one in done.events if not isinstance(one, Toggled | Released))

    assert [written(one) for one in rows] == [written(one) for one in singles]
    for own, other in zip(rows, singles, strict=True):
        assert own.state.net.targets.keys() == other.state.net.targets.keys()
        lines = {line.target: line for line in other.metrics}
        assert sorted(lines) == sorted(line.target for line in own.metrics)
        for a in own.metrics:
            a, b = json.loads(to_json(a)), json.loads(to_json(lines[a.target]))
            assert a["agent_ud_px2"].keys() == b["agent_ud_px2"].keys()
            silent = {agent for agent, nats in b["strength"].items() if nats < 1e-12}
            for line in (a, b):
                line["agent_ud_px2"] = {k: v for k, v in line["agent_ud_px2"].items() if k not in silent}
            assert unlike(a, b, rel=1e-8, abs=1e-13) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sort", "bytetrack", "oc_sort"])
def test_trackers_of_the_field_agree_as_rows_and_apart(name, found, unlike):
    """With tentative tracks, passes, directions and re-updates; what is remembered is the same, too."""
    graph = load_graph(name)
    rows, singles = outcomes(graph, found), apart(graph, found)
    assert sum(map(has_table, rows)) > FRAMES - 8
    assert_alike(rows, singles, unlike)
    last, other = rows[-1].state, singles[-1].state
    assert list(last.targets) == list(other.targets)
    for target in other.targets:
        own, its = (one.targets[target].references["seen"] for one in (last, other))
        assert own.keys() == its.keys()
        for key in own:
            np.testing.assert_allclose(own[key], its[key], rtol=1e-8, atol=1e-10)
    mine, theirs = (one.history.candidates["target"] for one in (last, other))
    assert [one.looks for one in mine] == [one.looks for one in theirs]
    again = decode_state(
        encode_state(last), steps.make_engine(graph, 0, detectors={"detections": None}), None
    )
    assert [one.mean.tolist() for one in again.history.candidates["target"]] == [
        one.mean.tolist() for one in mine
    ]


@pytest.mark.slow
def test_rows_and_objects_agree(graph, found, unlike):
    rows, singles = outcomes(graph, found), apart(graph, found)
    assert sum(map(has_table, rows)) > FRAMES - 8
    kinds = {type(event).__name__ for one in rows for event in one.events}
    assert {"TargetStarted", "StatusChanged", "TargetDied"} <= kinds
    assert_alike(rows, singles, unlike)
    last, other = rows[-1].state, singles[-1].state
    assert sorted(last.targets) == sorted(other.targets)  # one that turned is the last row
    for target in other.targets:
        own, its = last.targets[target], other.targets[target]
        np.testing.assert_allclose(own.belief.covariance, its.belief.covariance, rtol=1e-9, atol=1e-12)
        assert own.memory.count(LOST) == its.memory.count(LOST)
        assert own.memory.baselines.keys() == its.memory.baselines.keys()
        assert own.references.keys() == its.references.keys()
        record = last.history.records[target]
        assert (record.since, record.unseen_frames) == (
            other.history.records[target].since,
            other.history.records[target].unseen_frames,
        )


def test_one_that_is_switched_by_hand_is_an_object_and_the_others_stay_rows(graph, found, unlike):
    plain = outcomes(graph, found, None, 30)
    target = next(iter(plain[12].state.targets))
    inputs = {12: (Toggled(0, target, "seen", True),), 18: (Released(0, target, "seen"),)}
    done = outcomes(graph, found, inputs, 30)
    assert all(map(has_table, done[4:]))
    for index, (own, other) in enumerate(zip(done, plain, strict=True)):
        is_object = 12 <= index <= 18
        assert index < 4 or (target in own.state.targets.others) == (12 <= index < 18)
        lines = {line.target: line for line in own.metrics}
        assert lines.keys() == {line.target for line in other.metrics}
        for line in other.metrics:
            a, b = to_json(lines[line.target]), to_json(line)
            if line.target == target and is_object:
                assert unlike(json.loads(a), json.loads(b), rel=1e-8, abs=1e-13) == []
            elif line.target != target:
                assert a == b, f"frame {index}: the bytes of {line.target}"


@pytest.mark.slow
def test_lost_targets_that_are_found_by_their_place_are_rows_again(found, unlike):
    written = load_graph("kalman_detections").spec.model_dump(exclude_unset=True)
    (plate,) = written["targets"].values()
    plate |= {"reidentify": {"lost": True, "min_probability": 0.5}, "death": {"unseen_frames": 30}}
    graph = load_graph(written)
    rows = outcomes(graph, found)
    back = [one.target for done in rows for one in done.events if isinstance(one, Reacquired)]
    assert back and sum(map(has_table, rows)) > FRAMES - 8
    assert not rows[-1].state.targets.others
    assert_alike(rows, apart(graph, found), unlike)


@pytest.mark.slow
def test_one_that_is_switched_off_by_hand_sees_nothing_until_it_is_released(graph, found, unlike):
    target = next(iter(outcomes(graph, found, None, 12)[-1].state.targets))
    inputs = {12: (Toggled(0, target, "seen", False),), 14: (Released(0, target, "seen"),)}
    done = outcomes(graph, found, inputs, 30)
    assert_alike(done, apart(graph, found, inputs, 30), unlike)
    lines = {index: next(one for one in done[index].metrics if one.target == target) for index in (11, 13)}
    assert lines[11].active == ("seen",) and lines[13].active == ()
    assert lines[13].ud_px2 > lines[11].ud_px2


@pytest.mark.slow
def test_a_late_frame_changes_nothing_but_what_is_shed(graph, found, unlike):
    inputs = {20: (LateFrame(0, 0.05, 0.04),)}
    assert_alike(outcomes(graph, found, inputs, 24), apart(graph, found, inputs, 24), unlike)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in CHANGES if name != "plain"])
def test_other_gaussians_agree_as_rows_and_as_objects(name, graph, found, monkeypatch, unlike):
    own = with_nodes(graph, name)
    rows = outcomes(own, found)
    assert sum(map(has_table, rows)) > FRAMES - 8 and not rows[-1].state.targets.others
    kinds = {type(event).__name__ for one in rows for event in one.events}
    assert "StatusChanged" in kinds and ("MeasurementGated" in kinds) == (name in ("gated", "samples"))
    monkeypatch.setattr(finding, "net_fits", lambda rule, net: False)
    singles = outcomes(own, found)
    assert not any(map(has_table, singles))
    assert_alike(rows, singles, unlike)
    for target, state in singles[-1].state.targets.items():
        other = rows[-1].state.targets[target]
        assert other.memory.counts.tolist() == state.memory.counts.tolist()
        assert other.references.keys() == state.references.keys()
        for agent in state.references.keys() - {"seen"}:
            for part, learnt in state.references[agent].items():
                np.testing.assert_allclose(other.references[agent][part], learnt, rtol=1e-8, atol=1e-13)
    assert any(0 < line.learn_rate < 1 for one in rows for line in one.metrics) == (name == "looks")


@pytest.mark.slow
@pytest.mark.parametrize("name", CHANGES)
def test_a_track_is_the_same_bytes_alone_and_in_a_crowd(name, graph):
    graph = with_nodes(graph, name)
    rng = np.random.default_rng(0)
    path = np.column_stack([60 + 3.0 * np.arange(40), np.full(40, 60.0)])
    first = np.column_stack([path, np.tile([30.0, 60.0], (40, 1))]) + rng.normal(0, 1, (40, 4))
    others = np.column_stack([rng.uniform(100, 600, 25), rng.uniform(200, 400, 25), np.full((25, 2), 18.0)])

    def lines(crowd):
        several = {
            frame: np.concatenate(
                [box[None], crowd + rng.normal(0, 1, crowd.shape) if frame > 5 else crowd[:0]]
            )
            for frame, box in enumerate(first)
        }
        found = {
            k: Detections(boxes, np.ones(len(boxes)), ("",) * len(boxes)) for k, boxes in several.items()
        }
        metrics = [one for outcome in outcomes(graph, found, None, 40) for one in outcome.metrics]
        return [to_json(one) for one in metrics if one.target == "1"], len({one.target for one in metrics})

    (alone, one), (among, several) = lines(others[:0]), lines(others)
    assert one == 1 and several > 20 and len(alone) > 30
    assert among == alone


def test_states_and_records_are_made_when_they_are_asked_for(graph, found):
    done = outcomes(graph, found, None, 25)
    state = done[-1].state
    assert isinstance(state.targets, Targets) and isinstance(state.history.records, Records)
    (table,) = state.targets.gaussians
    target = next(iter(state.targets))
    assert state.targets[target] is state.targets[target]
    again = make_rows(
        table.rule,
        dict(state.targets),
        dict(state.history.records),
        [state.net.targets[target].status == "lost" for target in state.targets],
        state.previous.time,
    )
    for name, column in vars(table.columns).items():
        other = getattr(again.columns, name)
        if name == "own":
            column, other = column[again.columns.given == 2], other[again.columns.given == 2]
        if name == "memory":
            for part in ("counts", "nats", "frames", "missed"):
                np.testing.assert_array_equal(getattr(column, part), getattr(other, part), err_msg=part)
        else:
            np.testing.assert_array_equal(column, other, err_msg=name)
    with pytest.raises(KeyError):
        state.targets["nobody"]


def test_no_target_gets_a_detection_where_there_are_none(graph, found):
    nothing = Detections(np.empty((0, 4)), np.empty(0), ())
    for own in (graph, load_graph("sort"), load_graph("jpda")):
        last = outcomes(own, {**found, 15: nothing}, None, 16)[-1]
        assert len(last.metrics) > 5 and all(line.silent == ("seen",) for line in last.metrics)


@pytest.mark.parametrize("name", ["general", "crowd", "kalman_ball"])
def test_other_graphs_go_apart(name):
    checked = load_graph(name)
    given = {"detections": FileDetector({})} if name == "people_detections" else None
    engine = steps.make_engine(checked, 0, detectors=given)
    assert [row_rule(engine, plate) for plate in checked.targets] == [None] * len(checked.targets)


def test_targets_with_a_factor_go_apart():
    plain = as_plain(load_graph("kalman_detections").spec)
    ((plate, target),) = plain["targets"].items()
    root = next(name for name, node in target["nodes"].items() if "parent" not in node)
    for factor in (None, {"parent": root, "factor": "normal(h, 60, 20)"}):
        if factor is not None:
            target["nodes"]["size"] = factor
        engine = steps.make_engine(check_graph(plain), 0, detectors={"detections": FileDetector({})})
        assert (row_rule(engine, plate) is None) == (factor is not None)


def test_a_detector_that_fails_is_left_alone_for_a_while(graph, found):
    asked = []

    class Failing(FileDetector):
        def detect(self, frames, state):
            asked.append(frames.current.index)
            if frames.current.index == 10:
                raise RuntimeError("no camera")
            return super().detect(frames, state)

    engine = steps.make_engine(graph, 0, detectors={"detections": Failing(found)})
    state = None
    for index in range(23):
        frame = Frame(index=index, time=float(index), time_s=index / 25, image=IMAGE)
        outcome = (
            start_targets(graph, engine, frame, ()) if state is None else steps.step(engine, state, frame)
        )
        state = outcome.state
    assert asked == [*range(11), *range(20, 23)]


def test_rows_that_were_stored_go_on_as_rows_to_the_same_bytes(graph, found):
    done = outcomes(graph, found, None, 25)
    engine = steps.make_engine(graph, 0, detectors={"detections": FileDetector(found)})
    frames = [Frame(index=k, time=float(k), time_s=k / 25, image=IMAGE) for k in range(25)]
    state = decode_state(encode_state(done[17].state), engine, frames[17])
    for index in range(18, 25):
        outcome = steps.step(engine, state, frames[index])
        state = outcome.state
        assert has_table(outcome)
        for kind in ("metrics", "events"):
            own, other = getattr(outcome, kind), getattr(done[index], kind)
            assert [to_json(one) for one in own] == [to_json(one) for one in other]


def test_what_was_measured_of_a_row_is_what_is_measured_of_one_target(graph, found):
    said = 0
    for row, one in zip(outcomes(graph, found, frames=15), apart(graph, found, None, 15), strict=True):
        assert row.heard.keys() == one.heard.keys()
        for target, alone in one.heard.items():
            measured = row.heard[target].measured
            assert measured.keys() == alone.measured.keys()
            for agent, exact in alone.measured.items():
                found_here = measured[agent]
                assert found_here.fields == exact.fields
                np.testing.assert_allclose(found_here.mean, exact.mean)
                np.testing.assert_allclose(found_here.covariance, exact.covariance)
                said += has_table(row)
    assert said > 20


def test_columns_of_rows_are_those_of_their_lines(graph, found):
    """Byte for byte, though made without the lines, and without the hypotheses of a crowd."""
    count = 0
    for one in outcomes(graph, found):
        if has_table(one) and len(one.metrics) > FEW:
            columns, tracked = measured(one.metrics)
            lines = tuple(one.metrics)
            assert record(columns) == record(columns_of(lines, hypotheses=False))
            other = Tracked.of(lines)
            assert tracked.corners == other.corners and list(tracked.targets) == other.targets
            for name in ("frame", "time_s", "statuses", "scores", "uds", "actives"):
                assert getattr(tracked, name) == getattr(other, name)
            count += not one.metrics.born
    assert count > 10


def test_where_no_agent_knows_looks_they_say_nothing_of_who_a_detection_is(graph, found):
    events = [event for outcome in outcomes(graph, found) for event in outcome.events]
    weighed = [one.nearest for one in events if isinstance(one, CandidateConfirmed) and one.nearest]
    assert weighed and all(one.agents == () and one.appearance == 0.0 for one in weighed)


@pytest.mark.slow
def test_two_plates_are_a_table_each(found, unlike):
    written = load_graph("kalman_detections").spec.model_dump(exclude_unset=True)
    (plate,) = written["targets"].values()
    plates = {}
    for name in ("person", "bike"):
        own = json.loads(json.dumps(plate).replace('"target"', f'"{name}"'))
        own["birth"]["labels"] = [name]
        plates[name] = own
    written["targets"] = plates
    two = {
        frame: Detections(
            one.boxes, one.scores, tuple(("person", "bike")[int(x) % 2] for x in one.boxes[:, 2])
        )
        for frame, one in found.items()
    }
    graph = load_graph(written)
    rows = outcomes(graph, two, None, 25)
    tables = rows[-1].state.targets.gaussians
    assert sorted(table.rule.plate for table in tables) == ["bike", "person"]
    assert not rows[-1].state.targets.others and all(len(table.ids) > 1 for table in tables)
    assert_alike(rows, apart(graph, two, None, 25), unlike)


@pytest.mark.slow
def test_a_target_whose_looks_cannot_be_learnt_leaves_the_table_alone(graph, found, monkeypatch):
    own, asked = with_nodes(graph, "looks"), []
    engine = steps.make_engine(own, 0, detectors={"detections": FileDetector(found)})
    kind = type(engine.plates["target"].cues["color"])
    blend = kind.blend

    def fail_once(cue, old, new, rate):
        asked.append(rate)
        if len(asked) == 40:
            raise RuntimeError("no colour here")
        return blend(cue, old, new, rate)

    monkeypatch.setattr(kind, "blend", fail_once)
    monkeypatch.delattr(kind, "follow_each", raising=False)
    done = outcomes(own, found, None, 34)
    failed = [event for one in done for event in one.events if type(event).__name__ == "Quarantined"]
    assert [event.node for event in failed] == ["color"] and len(asked) > 200
    at = next(k for k, one in enumerate(done) if failed[0] in one.events)
    after = done[at + 1].state.targets
    assert [*after.others] == [failed[0].target] and len(after.gaussians[0].ids) > 3
