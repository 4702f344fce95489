"""Targets of a group: the bytes of one do not depend on who else is in it, and a fault is its own."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from bayesnet_track import CueDeclaration, GrayPlane, box_means, floored, load_graph
from bayesnet_track.engine import step as steps
from bayesnet_track.journal.codec import to_json
from bayesnet_track.journal.events.faults import Quarantined
from bayesnet_track.observation.planes import Frame
from tests.engine.test_particle_rows import known

PLACES = {"a": (20.0, 20.0), "b": (60.0, 40.0), "c": (118.0, 90.0), "d": (64.0, 44.0), "e": (30.0, 70.0)}
AGENTS = {
    "color_histogram": {},
    "color_kernel_histogram": {},
    "correlation_filter": {},
    "foreground_color": {},
    "intensity": {},
    "motion": {"flow": "dense"},
    "template": {},
    "texture": {},
    "glance": {},
}


class Glance:
    """The cue of nine lines, which fails for the targets of some columns, where and as it is told."""

    needs = (GrayPlane(),)
    fails = None
    fails_at = 118.0

    def learn(self, planes, box):
        """As on the page about cues, and where the target began."""
        self.fail("learn", box[0])
        return {"gray": box_means(planes, GrayPlane(), box[None], 5, 5), "began": box[:1].copy()}

    def blend(self, old, new, rate):
        """A target's own column stays."""
        return {"gray": (1 - rate) * old["gray"] + rate * new["gray"], "began": old["began"]}

    def log_likelihood(self, planes, hypotheses, reference):
        """As on the page about cues."""
        answer = self.fail("score", reference["began"][0])
        apart = box_means(planes, GrayPlane(), hypotheses.boxes, 5, 5) - reference["gray"]
        log = floored(-0.5 * ((apart / 10) ** 2).mean(axis=1))
        return log if answer is None else answer(log)

    def fail(self, during, column):
        """Raise, or what to answer, if this is the target that fails."""
        if self.fails is None or self.fails[0] != during or abs(column - self.fails_at) > 12:
            return None
        if isinstance(self.fails[1], Exception):
            raise self.fails[1]
        return self.fails[1]


class GroupGlance(Glance):
    """With a form for all targets at once, which fails where one of them does."""

    def log_likelihood_of_each(self, planes, hypotheses, starts, references):
        """Those of each below each other."""
        parts = [hypotheses.part(first, end) for first, end in pairwise(starts)]
        asked = zip(planes, parts, references, strict=True)
        return np.concatenate([self.log_likelihood(*one) for one in asked])

    def follow_each(self, planes, boxes, references, rates):
        """Of each."""
        asked = zip(planes, boxes, references, rates, strict=True)
        return [self.blend(known, self.learn(on, box), rate) for on, box, known, rate in asked]


def graph_of(agents, plain=True):
    """A graph of particles; its rules judge the status alone where it is `plain`."""
    root = {
        "belief": {"particles": {"size": 60}},
        "motion": {"constant_velocity": {"sd_velocity_px": 1.0}},
        "fuse": "product",
        "ud_fields": ["x", "y"],
        "learn": {"below": {"ud_px2": 400}, "rate_max": 0.2},
    }
    if not plain:
        root["adapt"] = {"deactivate": {"below": {"ud_px2": 2}, "frames": 2, "drop": "largest_kl"}}
    nodes = {
        name: {"parent": "thing", "agent": {name.split("__")[0]: settings}}
        for name, settings in agents.items()
    }
    return load_graph(
        {"name": "things", "targets": {"thing": {"nodes": {"thing": root, **nodes}}}}, cues=CUES
    )


class Made:
    """Makes the cue of a test."""

    cue = Glance

    def __call__(self):
        return self.cue()


MAKE = Made()
CUES = [CueDeclaration("glance", make=MAKE)]


def frame(index):
    cells = np.random.default_rng(1).integers(0, 255, (6, 8, 3), dtype=np.uint8)
    image = np.kron(cells, np.ones((16, 16, 1), np.uint8))
    return Frame(index, float(index), np.roll(image, 2 * index, axis=1))


FRAME = frame(0)


def run(graph, names, frames=4, tell=None, cap=None):
    """Target -> what is known of it and was written of it, frame by frame, in bytes; and all events.

    `cap`: target -> frame from which it may have 30 hypotheses only.
    """
    engine, state = steps.make_engine(graph, 3), steps.State()
    (plate,) = engine.plates
    for name in names:
        box = np.array([*PLACES[name], 16.0, 16.0])
        state = steps.start_target(engine, state, frame(0), name, plate, box).state
    found, events = {name: [] for name in names}, []
    for index in range(1, frames):
        if tell is not None:
            tell(index)
        for name in names:
            if cap is not None and cap.get(name) == index:
                state = capped(state, name)
        outcome = steps.step(engine, state, frame(index))
        state, lines = outcome.state, {one.target: to_json(one) for one in outcome.metrics}
        events += outcome.events
        for name in names:
            found[name].append((known(state.targets[name]), lines[name]))
    return found, events


def capped(state, name):
    """The state after load was shed at a target."""
    net = replace(state.net.targets[name], most_particles=30)
    return replace(state, net=replace(state.net, targets={**state.net.targets, name: net}))


@pytest.fixture(autouse=True)
def no_fault(monkeypatch):
    monkeypatch.setattr(Glance, "fails", None)
    monkeypatch.setattr(Made, "cue", Glance)


@pytest.mark.slow
@pytest.mark.parametrize("plain", [True, False])
@pytest.mark.parametrize("cue", AGENTS)
def test_the_bytes_of_a_target_do_not_depend_on_who_else_is_in_its_group(cue, plain):
    other = "intensity" if cue == "color_histogram" else "color_histogram"
    graph = graph_of({other: {}, cue: AGENTS[cue]}, plain)
    together, _ = run(graph, PLACES)
    assert len({repr(one) for one in together.values()}) == len(PLACES)
    for name in ("c", "d"):
        assert run(graph, [name])[0] == {name: together[name]}
    some, _ = run(graph, ["e", "c", "a"])
    assert some == {name: together[name] for name in some}


@pytest.mark.parametrize(
    "name", ["general", "color_fusion", "two_colors", "two_squares_velocity", "adaptive"]
)
def test_targets_with_a_motion_of_their_own_and_nodes_below_the_root_go_together(monkeypatch, name):
    """Jumps, reversion to a first size, borders that reflect; pools; scores with a search after a pan."""
    graph, shifts = load_graph(name), [0, 2, 4, 6, 8, 10, 12, 40, 42]
    monkeypatch.setattr(
        f"{__name__}.frame",
        lambda index: replace(
            FRAME, index=index, time=float(index), image=np.roll(FRAME.image, shifts[index], axis=1)
        ),
    )
    alone, apart = steps.ready_each, list[str]()
    monkeypatch.setattr(steps, "ready_each", lambda work, before: apart.extend(before) or alone(work, before))
    together, _ = run(graph, PLACES, len(shifts))
    assert len(apart) < len(PLACES) * len(shifts) // 2  # those that are lost or searched for
    for target in ("c", "d"):
        assert run(graph, [target], len(shifts))[0] == {target: together[target]}


def test_targets_with_fewer_hypotheses_for_want_of_time_are_groups_as_well(monkeypatch):
    """Also of those that are reduced one after the other, and then are alike."""
    graph, cap = graph_of({"color_histogram": {}}), {"a": 1, "c": 2, "d": 3}
    together, _ = run(graph, PLACES, 6, cap=cap)
    for name in ("c", "d", "e"):
        assert run(graph, [name], 6, cap=cap)[0] == {name: together[name]}
    monkeypatch.setattr(steps, "ready_each", lambda work, before: {} if not before else 1 / 0)
    assert run(graph, PLACES, 6, cap=cap)[0] == together


FAULTS = {
    "raises": RuntimeError("too dark"),
    "exits": SystemExit(3),
    "positive": lambda log: log + 5.0,
    "short": lambda log: log[1:],
    "nan": lambda log: log * np.nan,
    "nothing": lambda log: np.full(len(log), -np.inf),
    "text": lambda log: "none",
}


@pytest.mark.parametrize("cue", [Glance, GroupGlance])
@pytest.mark.parametrize("fault", FAULTS)
def test_an_agent_that_fails_is_quarantined_in_its_own_target_alone(monkeypatch, cue, fault):
    monkeypatch.setattr(Made, "cue", cue)
    graph = graph_of({"glance": {}, "intensity": {}})
    usual, _ = run(graph, PLACES)

    def tell(index):
        Glance.fails = ("score", FAULTS[fault]) if index == 2 else None

    found, events = run(graph, PLACES, tell=tell)
    assert [(one.frame, one.target, one.node) for one in events if isinstance(one, Quarantined)] == [
        (2, "c", "glance")
    ]
    assert {name: found[name] == usual[name] for name in PLACES} == {name: name != "c" for name in PLACES}
    alone, _ = run(graph, ["c"], tell=tell)
    assert alone == {"c": found["c"]}


@pytest.mark.parametrize("cue", [Glance, GroupGlance])
@pytest.mark.parametrize("plain", [True, False])
def test_an_agent_that_fails_to_learn_is_quarantined_in_its_own_target_alone(monkeypatch, cue, plain):
    monkeypatch.setattr(Made, "cue", cue)
    graph = graph_of({"glance": {}, "intensity": {}}, plain)
    usual, _ = run(graph, PLACES)

    def tell(index):
        Glance.fails = ("learn", RuntimeError("too dark")) if index == 2 else None

    found, events = run(graph, PLACES, tell=tell)
    assert [(one.frame, one.target, one.node) for one in events if isinstance(one, Quarantined)] == [
        (2, "c", "glance")
    ]
    assert {name: found[name] == usual[name] for name in PLACES} == {name: name != "c" for name in PLACES}


@pytest.mark.parametrize("during", ["score", "learn"])
def test_an_agent_that_failed_in_a_group_is_not_asked_again(monkeypatch, during):
    """Else one that fails now and then would not be found out."""
    asked = []

    def fail(self, now, column):
        if now == during and abs(column - 118.0) < 12 and Glance.fails:
            asked.append(column)
            if len(asked) == 1:
                raise RuntimeError("once")

    monkeypatch.setattr(Glance, "fail", fail)

    def tell(index):
        Glance.fails = index == 2

    _, events = run(graph_of({"glance": {}, "intensity": {}}), PLACES, tell=tell)
    assert len(asked) == 1
    assert [one.target for one in events if isinstance(one, Quarantined)] == ["c"]


def test_a_form_for_all_that_fails_alone_is_nobodys_fault(monkeypatch):
    graph = graph_of({"glance": {}, "intensity": {}})
    usual, _ = run(graph, PLACES)
    monkeypatch.setattr(Made, "cue", GroupGlance)

    def fail(self, *asked):
        raise RuntimeError("of all")

    monkeypatch.setattr(GroupGlance, "log_likelihood_of_each", fail)
    monkeypatch.setattr(GroupGlance, "follow_each", fail)
    found, events = run(graph, PLACES)
    assert found == usual and not [one for one in events if isinstance(one, Quarantined)]
