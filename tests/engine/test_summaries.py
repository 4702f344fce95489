"""Targets that are measured together: the same bits as each measured by itself."""

import pickle
from types import SimpleNamespace

import numpy as np
import pytest

from bayesnet_track import load_graph
from bayesnet_track.belief.particles.belief import find_map_states, map_index
from bayesnet_track.engine.filtering import filter_target
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.lines import Lines
from bayesnet_track.engine.metrics import find_covariances, summarise, summarise_one
from bayesnet_track.engine.step import State, make_engine, start_target
from bayesnet_track.inference.measure import StepArrays, is_flat, measure, measure_rows
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache

MOTIONS = {
    "velocity": {"constant_velocity": {"sd_velocity_px": 1.0}},
    "sized": {"constant_velocity": {"sd_velocity_px": 1.0, "sd_px": {"w": 1, "h": 1}}},
    "walk": {
        "random_walk": {
            "sd_box": {"x": 0.1, "y": 0.1},
            "sd_log": {"scale": 0.05},
            "heavy_tail": {"weight": 0.5, "factor": 4},
        }
    },
}
AGENTS = {"color": {"color_histogram": {"floor": 0.003}}, "gray": "intensity"}


def filtered(motion, agents, fuse="product"):
    """Three targets after the first half of a frame."""
    nodes = {
        "root": {
            "belief": {"particles": {"size": 133}},
            "motion": MOTIONS[motion],
            "fuse": fuse,
            "ud_fields": ["x", "y"],
        }
    } | {name: {"parent": "root", "agent": AGENTS[name]} for name in agents}
    engine = make_engine(load_graph({"name": "three", "targets": {"thing": {"nodes": nodes}}}), 3)
    rng = np.random.default_rng(0)
    image = np.kron(rng.integers(0, 255, (6, 8, 3), dtype=np.uint8), np.ones((16, 16, 1), np.uint8))
    first, second = (Frame(n, float(n), np.roll(image, 2 * n, axis=1)) for n in range(2))
    state = State()
    for number, at in enumerate([(20.0, 20.0), (60.0, 40.0), (118.0, 90.0)]):
        state = start_target(engine, state, first, str(number), "thing", np.array([*at, 16.0, 16.0])).state
    work = FrameContext(engine, state.net, PlaneCache(FramePair(second, first)), state.history.births)
    return work, {target: filter_target(work, target, state.targets[target]) for target in state.targets}


def assert_close(one, other):
    """Equal but for the order in which NumPy adds up, which NumPy 1 chooses by the shape of an array."""
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for key in one:
            assert_close(one[key], other[key])
    elif isinstance(one, float):
        assert one == pytest.approx(other, rel=1e-12, abs=1e-12, nan_ok=True)
    else:
        assert one == other


@pytest.mark.parametrize(
    ("motion", "agents"), [("velocity", ["color"]), ("sized", ["color", "gray"]), ("walk", ["gray"])]
)
def test_targets_measured_together_are_measured_as_alone(motion, agents):
    work, found = filtered(motion, agents)
    plate = work.plate_of("0").plate
    steps = [one.step for one in found.values()]
    assert is_flat(plate)
    find_map_states(steps)
    for step in steps:
        find = step.find_map
        best = map_index(
            find.log_likelihood,
            find.states,
            find.inputs.prior.states,
            find.inputs.prior.weights,
            find.inputs.motion,
            find.inputs.dt,
        )
        assert step.__dict__["map_state"].tolist() == find.states[best].tolist()
    plan = found["0"].plan
    together = measure_rows(plate, plan, StepArrays.of(plate, plan, steps), [1.0, 2.0, 3.0])
    for row, (step, area) in enumerate(zip(steps, (1.0, 2.0, 3.0), strict=True)):
        assert_close(vars(together.of(row)), vars(measure(plate, plan, step, area)))
    spreads = find_covariances(found)
    for target, one in summarise(work, found, spreads).items():
        step = found[target].step
        alone = summarise_one(work, found[target], step.posterior.covariance)
        assert one.variances.tobytes() == alone.variances.tobytes()
        assert spreads[target].tobytes() == found[target].step.posterior.covariance.tobytes()
        assert (one.ess, one.surprise, one.regions, one.cloud) == (
            alone.ess,
            alone.surprise,
            alone.regions,
            alone.cloud,
        )


def test_a_weight_of_zero_counts_nothing_in_any_measure():
    work, found = filtered("velocity", ["color", "gray"], "pool")
    plate, plan = work.plate_of("0").plate, found["0"].plan
    steps = [one.step for one in found.values()]
    steps[1].evidence.messages["gray"][::2] = -np.inf
    together = measure_rows(plate, plan, StepArrays.of(plate, plan, steps), [1.0] * 3)
    assert [vars(together.of(row)) for row in range(3)] == [
        vars(measure(plate, plan, step, 1.0)) for step in steps
    ]


class Group:
    """Targets of which lines are made when asked for: here their names, and how often."""

    def __init__(self, **boxes):
        self.ids, self.boxes, self.asked = tuple(boxes), np.array([*boxes.values()], dtype=float), []
        self.is_lost, self.holds_frame = np.array(["l" in one for one in boxes]), True

    def lines(self, hypotheses):
        self.asked.append(hypotheses)
        return [SimpleNamespace(target=one) for one in self.ids]


def names(lines):
    return [one.target for one in lines]


def test_lines_are_made_when_the_first_is_asked_for_and_once():
    group = Group(a=[0] * 4, b=[1] * 4, c=[2] * 4)
    lines = Lines([group], group.ids)
    assert len(lines) == 3 and not group.asked
    assert (lines[1].target, lines[-1].target, names(lines[:2]), names(lines)) == (
        "b",
        "c",
        ["a", "b"],
        ["a", "b", "c"],
    )
    assert group.asked == [True] and lines == tuple(lines) and lines.settled() is lines
    assert pickle.loads(pickle.dumps(Lines(born=(1, 2)))) == (1, 2)


def test_lines_of_several_groups_come_in_the_order_of_the_targets():
    one, other = Group(b=[0] * 4, l=[1] * 4), Group(a=[2] * 4)
    lines = Lines([one, other], ["a", "b", "l"])
    born = SimpleNamespace(target="n", centre_box=(3.0,) * 4, status="tracking", is_gone=False)
    more = lines.with_born([born])
    assert [*more.ids] == ["a", "b", "l", "n"] and len(lines) == 3 and len(more) == 4
    assert more.places.boxes[:, 0].tolist() == [2, 0, 1, 3]
    ids, boxes = more.held()
    assert ids == ["a", "b", "n"] and boxes[:, 0].tolist() == [2, 0, 3]
    assert more.boxes_of(["n", "a"])[:, 0].tolist() == [3, 2] and more.boxes_of([]).shape == (0, 4)
    assert not one.asked and not other.asked
    assert names(lines) == ["a", "b", "l"] and names(lines.with_born([born])) == ["a", "b", "l", "n"]
    assert Lines().places.boxes.shape == (0, 4) and Lines().held()[0] == []


def test_lines_without_hypotheses_are_not_kept():
    group = Group(a=[0] * 4)
    lines = Lines([group], group.ids)
    assert names(lines.without_hypotheses()) == names(lines) == ["a"] and group.asked == [False, True]
    assert lines.without_hypotheses() is lines.without_hypotheses()
