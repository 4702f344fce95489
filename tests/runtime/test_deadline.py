"""A frame's time against its budget: what is late is told, recorded, and repeats; nobody waits for it."""

from __future__ import annotations

import time
from statistics import median
from types import SimpleNamespace

import pytest

from bayesnet_track import track
from bayesnet_track.inference.asking import AgentUnavailable
from bayesnet_track.journal.events.faults import AgentMissed
from bayesnet_track.journal.events.load import LateFrame, ParticlesLimited, SpareTime
from bayesnet_track.journal.net import Net
from bayesnet_track.journal.reader import read_inputs
from bayesnet_track.journal.target_net import TargetNet
from bayesnet_track.runtime.pace import FOR_AGENTS, FOR_ONE, WARM_UP, Deadline
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.scenes.library import SceneSource

FILES = ("journal.jsonl", "frames.npy.gz", "tracks.txt", "inputs.jsonl")
SHORT = Net({"1": TargetNet("plate", frozenset("a"), shed=("b",))})


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


def frames(deadline, clock, times_ms, net=SHORT):
    inputs = []
    for index, spent in enumerate(times_ms):
        inputs += deadline.inputs_for(index, net)
        deadline.begin()
        clock.now += spent / 1000.0
        deadline.end()
    return inputs


def test_late_frames_are_told_with_the_next_one_and_the_first_ones_are_not_counted():
    clock = Clock()
    inputs = frames(Deadline(10.0, clock=clock), clock, [90.0] * WARM_UP + [9.0, 12.0, 9.0, 9.0])
    assert inputs == [LateFrame(WARM_UP + 2, pytest.approx(12.0), 10.0)]


def test_spare_time_is_told_only_while_something_is_done_without():
    clock = Clock()
    times = [5.0] * 48 + [7.0] + [5.0] * 60
    inputs = frames(Deadline(10.0, clock=clock), clock, times)
    assert inputs == [
        SpareTime(50, pytest.approx(7.0), 10.0, 50),
        SpareTime(100, pytest.approx(5.0), 10.0, 50),
    ]
    assert frames(Deadline(10.0, clock=clock), clock, times, Net()) == []


def test_agents_elsewhere_are_told_by_when_to_answer():
    clock, asking = Clock(), SimpleNamespace(patience=None)
    deadline = Deadline(10.0, asking, clock)
    frames(deadline, clock, [1.0] * WARM_UP)
    deadline.begin()
    patience = asking.patience
    assert patience.until("slow", clock.now) == pytest.approx(clock.now + FOR_ONE * 0.010)
    patience.waited("slow", FOR_ONE * 0.010)
    assert patience.until("slow", clock.now + 0.005) == pytest.approx(clock.now + 0.005), "in one frame"
    assert patience.until("other", clock.now + 0.006) == pytest.approx(clock.now + FOR_AGENTS * 0.010)
    deadline.end()
    assert asking.patience is None


def play(out, **settings):
    scene = make_scene("two_squares", seed=3)
    return list(track("two_squares", SceneSource(scene, "scene", 14), scene.start_box, out=out, **settings))


def test_a_run_that_is_too_slow_sheds_and_repeats_from_its_inputs(tmp_path):
    """No frame takes a nanosecond: all that can go goes, and the same inputs give the same bytes."""
    results = play(tmp_path / "live", budget_ms=1e-6)
    decided = [d for result in results for d in result.decisions]
    limits = [d.most for d in decided if isinstance(d, ParticlesLimited)]
    assert limits == [250, 125, 100][: len(limits)] and limits
    cut = {d.frame: d.most for r in results for d in r.decisions if isinstance(d, ParticlesLimited)}
    for frame, most in cut.items():
        assert results[min(frame + 1, 13)].targets[0].particles == most or frame == 13
    inputs = list(read_inputs(tmp_path / "live" / "inputs.jsonl"))
    assert [one.frame for one in inputs] == list(range(WARM_UP + 2, 14))
    play(tmp_path / "again", inputs=tmp_path / "live" / "inputs.jsonl")
    for name in FILES:
        assert (tmp_path / "again" / name).read_bytes() == (tmp_path / "live" / name).read_bytes(), name


def test_a_budget_and_inputs_are_refused_together(tmp_path):
    play(tmp_path / "live", budget_ms=1e-6)
    with pytest.raises(ValueError, match="no budget"):
        play(tmp_path / "again", budget_ms=5.0, inputs=tmp_path / "live" / "inputs.jsonl")


class Waiting:
    """Asks a slow agent in another thread's stead: it waits until the deadline, then gives up."""

    patience = None

    def each(self, work, pieces):
        return [work(piece) for piece in pieces]


def test_a_frame_comes_in_time_though_an_agent_is_ten_times_slower(fakes):
    """Within the deadline and 10 %, and what it would have answered late is used in no frame."""
    budget_ms, waiting, answered = 50.0, Waiting(), []

    def slow(planes, hypotheses, reference):
        needed = 10.0 * budget_ms / 1000.0
        now, patience = time.monotonic(), waiting.patience
        left = None if patience is None else patience.until("b", now) - now
        if left is not None and left < needed:
            time.sleep(max(left, 0.0))
            raise AgentUnavailable("gave no answer by the deadline")
        answered.append(planes.frame.index)
        return fakes.flat(-0.1)(planes, hypotheses, reference)

    nodes = {"root": {"fuse": "product", "belief": {"particles": {"size": 60}}}, "a": "root", "b": "root"}
    engine, _ = fakes.engine(nodes, {"a": fakes.gaussian(52, 41, 9), "b": slow})
    deadline, spent, outcomes = Deadline(budget_ms, waiting), [], fakes.play(engine, 0)
    from bayesnet_track.engine.step import step

    for index in range(1, 12):
        given = deadline.inputs_for(index, outcomes[-1].state.net)
        deadline.begin()
        began = time.monotonic()
        outcomes.append(step(engine, outcomes[-1].state, fakes.frame(index), given))
        deadline.end()
        spent.append(1000.0 * (time.monotonic() - began))
    missed = [
        one.frame for outcome in outcomes for one in outcome.external_inputs if isinstance(one, AgentMissed)
    ]
    assert answered == list(range(1, WARM_UP + 1)) and missed == [6, 7, 8]
    # The middle of the three that wait: a neighbour may hold the processor in one of them.
    assert median(spent[WARM_UP : WARM_UP + 3]) < 1.1 * budget_ms
    assert [outcome.metrics[0].active for outcome in outcomes[6:]] == [("a",)] * 6
