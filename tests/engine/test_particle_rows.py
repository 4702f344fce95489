"""Targets held by particles: the bytes of a target do not depend on who else is in its group."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from bayesnet_track import load_graph
from bayesnet_track.cues.color_histogram import ColorHistogram
from bayesnet_track.engine import step as steps
from bayesnet_track.engine.frame_context import FrameContext, planes_of_each
from bayesnet_track.engine.rows.filtered_rows import FilteredRows
from bayesnet_track.engine.rows.particle_rows import filter_rows, plate_fits
from bayesnet_track.engine.targets import ParticleTable, Targets
from bayesnet_track.journal.codec import to_json
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, region_of_boxes

NODES = {
    "thing": {
        "belief": {"particles": {"size": 80}},
        "motion": {"constant_velocity": {"sd_velocity_px": 1.0}},
        "fuse": "product",
        "ud_fields": ["x", "y"],
        "learn": {"below": {"ud_px2": 100}},
    },
    "color": {"parent": "thing", "agent": {"color_histogram": {"floor": 0.003}}},
    "coarse": {"parent": "thing", "agent": {"color_histogram": {"bins": 8}}, "temperature": 2.0},
}
GRAPH = load_graph({"name": "things", "targets": {"thing": {"nodes": NODES}}})
PLACES = ((20.0, 20.0), (60.0, 40.0), (118.0, 90.0), (64.0, 44.0))


def frame(index):
    cells = np.random.default_rng(1).integers(0, 255, (6, 8, 3), dtype=np.uint8)
    image = np.kron(cells, np.ones((16, 16, 1), np.uint8))
    return Frame(index, float(index), np.roll(image, 2 * index, axis=1))


def started(graph=GRAPH, plate="thing", names="0123"):
    engine, state = steps.make_engine(graph, 3), steps.State()
    for name in names:
        box = np.array([*PLACES[int(name)], 16.0, 16.0])
        state = steps.start_target(engine, state, frame(0), name, plate, box).state
    return engine, state


def lines(names, frames):
    """Target -> all that is written down of it."""
    engine, state = started(names=names)
    written = {name: [] for name in names}
    for index in frames:
        outcome = steps.step(engine, state, frame(index))
        state = outcome.state
        for one in (*outcome.metrics, *outcome.events):
            written[one.target].append(to_json(one))
    return written, {target: known(one) for target, one in state.targets.items()}


def known(state):
    """What is known of a target, in bytes where it is arrays."""
    belief = state.belief
    references = {
        agent: {name: values.tobytes() for name, values in one.items()}
        for agent, one in state.references.items()
    }
    memory = state.memory
    known = [(key, one.values, one.counts, one.medians) for key, one in memory.baselines.items()]
    arrays = (belief.states, belief.weights.log, belief.weights.weights)
    arrays += (memory.counts, memory.nats, memory.frames, *(array for _, *own in known for array in own))
    keys = [key for key, *_ in known]
    return keys, references, [array.tobytes() for array in arrays], state.time, state.plan.active


@pytest.mark.slow
def test_a_target_has_the_same_bytes_in_a_group_and_alone():
    """So is what the rules remember, also of a target that looks lost, and of one that is found again."""
    frames = [*range(1, 10), *range(40, 44), *range(76, 80)]  # the image repeats after 64 frames
    written, remembered = lines("0123", frames)
    events = [one for of in written.values() for one in of if "status" in one and "cause" in one]
    assert events, "nothing was decided"
    for name in "0123":
        alone = lines(name, frames)
        assert alone[0][name] == written[name] and alone[1][name] == remembered[name]


def test_what_learns_early_in_every_second_frame_learns_the_same_together(monkeypatch):
    root = NODES["thing"] | {"learn": {"below": {"ud_px2": 100}, "every": 2, "early_rate": 0.5}}
    graph = load_graph({"name": "things", "targets": {"thing": {"nodes": NODES | {"thing": root}}}})

    def references(names, late):
        engine, state = started(graph, names=names)
        for index in range(1, 7):
            state = steps.step(engine, state, frame(index)).state
            if index == 3 and late:
                box = np.array([100.0, 20.0, 16.0, 16.0])
                state = steps.start_target(engine, state, frame(3), "late", "thing", box).state
        return {target: known(one) for target, one in state.targets.items()}

    asked, own = [], ColorHistogram.follow_each
    monkeypatch.setattr(
        ColorHistogram, "follow_each", lambda self, *args: asked.append(args[3].tolist()) or own(self, *args)
    )
    together = references("0123", True)
    assert [len(rates) for rates in asked] == [4, 4, 5, 5, 5, 5]  # two agents in frames 2, 4 and 6
    assert max(asked[2][:4]) < asked[2][4]  # the late one's second frame
    for name in "0123":
        assert references(name, False)[name] == together[name]
    assert references("0", True)["late"] == together["late"]


def test_only_targets_that_fit_go_together():
    engine, state = started()
    work = FrameContext(engine, state.net, PlaneCache(FramePair(frame(1), frame(0))), state.history.births)
    (group,) = filter_rows(work, state.targets)
    assert list(group) == ["0", "1", "2", "3"]
    work.availability.known["0", "color", "observing"] = "late"
    assert filter_rows(work, state.targets) == []
    for name, is_fit in (("two_squares", True), ("bouncing_square", False), ("kalman_ball", False)):
        plates = steps.make_engine(load_graph(name)).plates.values()
        assert {plate_fits(plate) for plate in plates} == {is_fit}


@pytest.mark.parametrize("side", [8.0, 200.0])
def test_planes_hold_the_boxes_of_each_target(side):
    engine, state = started()
    work = FrameContext(engine, state.net, PlaneCache(FramePair(frame(1), None)), state.history.births)
    boxes = np.array([[[*at, side, side], [at[0] + 3, at[1], side, side]] for at in PLACES])
    needs = engine.plates["thing"].cues["color"].needs
    starts = np.arange(0, 2 * len(boxes) + 1, 2)
    found = planes_of_each(work, needs, boxes.reshape(-1, 4), starts, 0.5)
    for planes, own in zip(found, boxes, strict=True):
        assert planes.region.contains(region_of_boxes(own, 0.5).within(work.frame))
        assert planes[needs[0]].shape == (
            planes.region.y1 - planes.region.y0,
            planes.region.x1 - planes.region.x0,
        )


def test_targets_are_rows_until_something_is_decided_about_them():
    """The others stay rows; what is asked of a row is made once, and is an object in a copy."""
    engine, state = started()
    for index in (1, 2):
        state = steps.step(engine, state, frame(index)).state
    assert isinstance(state.targets, Targets)
    (table,) = state.targets.particles
    assert sorted([*table.ids, *state.targets.others]) == ["0", "1", "2", "3"] and list(state.targets) == [
        *"0123"
    ]
    assert all(len(own.belief) == 1 and not own.references for own in table.base), "no arrays of old frames"
    one, *rest = table.ids
    assert state.targets[one] is state.targets[one]
    copied = pickle.loads(pickle.dumps(state.targets))
    assert {name: known(own) for name, own in copied.items()} == {
        name: known(own) for name, own in state.targets.items()
    }
    assert state.targets.unchanged(state.net.targets).particles == (table,)
    lost = {**state.net.targets, one: replace(state.net.targets[one], status="lost")}
    after = state.targets.unchanged(lost)
    assert isinstance(after, Targets) and after.others[one] is state.targets[one]
    assert [own.ids for own in after.particles] == [tuple(rest)]
    assert {name: known(own) for name, own in after.items()} == {
        name: known(own) for name, own in state.targets.items()
    }
    together = after.particles[0].extended(ParticleTable.of(table.compiled, {one: state.targets[one]}))
    assert together.ids == (*rest, one)
    assert [known(together.state(row)) for row in range(len(together.ids))] == [
        known(state.targets[name]) for name in together.ids
    ]


@pytest.mark.parametrize(
    "change",
    [{"status": "lost"}, {"quarantined": frozenset({"coarse"})}, {"sampled": {"coarse": 2}}],
)
def test_a_target_of_which_something_may_be_decided_does_not_change_the_others(change):
    def states(names):
        engine, state = started(names=names)
        if "2" in names:
            nets = {**state.net.targets, "2": replace(state.net.targets["2"], **change)}
            state = replace(state, net=replace(state.net, targets=nets))
        for index in (1, 2):
            state = steps.step(engine, state, frame(index)).state
        return {target: known(one) for target, one in state.targets.items()}

    together = states("0123")
    assert all(states(name)[name] == together[name] for name in "0123")


def test_a_group_and_some_of_it_hold_the_same_of_each():
    engine, state = started()
    work = FrameContext(engine, state.net, PlaneCache(FramePair(frame(1), frame(0))), state.history.births)
    (group,) = filter_rows(work, state.targets)
    group.find_maps()
    some = group.take([1, 3])
    assert list(some) == ["1", "3"]
    for target in some:
        one, other = group[target].step, FilteredRows.take(group, [1, 3])[target].step
        assert one.posterior.states.tobytes() == other.posterior.states.tobytes()
        assert one.map_state.tobytes() == other.map_state.tobytes() == one.find_map().tobytes()
        assert one.log_evidence == other.log_evidence


def test_agents_learn_only_of_targets_with_a_rate():
    engine, state = started()
    nets = {**state.net.targets, "2": replace(state.net.targets["2"], status="lost")}
    before = {name: known(one)[1] for name, one in state.targets.items()}
    outcome = steps.step(engine, replace(state, net=replace(state.net, targets=nets)), frame(1))
    rates = {one.target: one.learn_rate for one in outcome.metrics}
    assert rates["2"] == 0.0 and all(rates[name] > 0.0 for name in "013")
    for name, one in outcome.state.targets.items():
        after = known(one)[1]
        moved = [agent for agent in after if after[agent] != before[name][agent]]
        assert moved == ([] if name == "2" else ["color", "coarse"])
