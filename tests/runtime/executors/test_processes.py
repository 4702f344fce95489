"""Agents in worker processes answer as they do in the engine's, whatever happens to the processes."""

from __future__ import annotations

import os
import signal
import time

import pytest

from bayesnet_track.inference.asking import AgentUnavailable
from bayesnet_track.runtime.executors.workers import Limits, Worker

TWO = {"a": ("placed", {}), "b": ("placed_measurer", {})}


@pytest.mark.slow
def test_the_same_to_the_last_bit_though_workers_are_killed_in_every_frame(placed, reports_of):
    with placed.executing(TWO, "processes", workers=2) as (engine, executor):

        def kill(frame):
            workers = executor.processes.workers()
            assert [agents for agents in workers.values()] == [("plate.a",), ("plate.b",)]
            for pid in workers:
                os.kill(pid, signal.SIGKILL)

        assert reports_of(placed.play(engine, before=kill)) == reports_of(placed.run(TWO))


@pytest.mark.slow
def test_all_agents_are_asked_before_the_first_is_heard(placed, monkeypatch):
    calls, ask, answer = [], Worker.ask, Worker.answer
    monkeypatch.setattr(Worker, "ask", lambda worker, call: calls.append(call.agent) or ask(worker, call))
    monkeypatch.setattr(Worker, "answer", lambda worker: calls.append("answer") or answer(worker))
    with placed.executing(TWO, "processes", workers=2) as (engine, _):
        placed.play(engine, 3, before=lambda frame: calls.clear())
    both, heard = {"plate.a", "plate.b"}, ["answer", "answer"]
    assert [set(calls[0:2]), calls[2:4], set(calls[4:6]), calls[6:8], calls[8:]] == [
        both,
        heard,
        both,
        heard,
        [],
    ]


@pytest.mark.slow
@pytest.mark.parametrize("how", ["die", "exit"])
def test_a_worker_that_dies_once_is_asked_again(placed, reports_of, tmp_path, how):
    left = tmp_path / "left"
    left.write_text("once\nand again")
    agents = {**TWO, "c": ("placed", {"how": how, "times": str(left)})}
    outcomes = placed.run(agents, "processes", workers=2)
    assert left.read_text() == ""
    assert reports_of(outcomes) == reports_of(placed.run(agents))


@pytest.mark.slow
@pytest.mark.parametrize("big", [0, 100_000])
def test_a_worker_that_is_stopped_is_replaced(placed, reports_of, big):
    agents = {"a": ("placed", {"big": big}), "b": ("placed_measurer", {})}
    limits = Limits(answer_s=2.0, first_s=5.0)
    with placed.executing(agents, "processes", workers=2, limits=limits) as (engine, executor):

        def stop(frame):
            for pid in executor.processes.workers() if frame == 3 else ():
                os.kill(pid, signal.SIGSTOP)

        assert reports_of(placed.play(engine, before=stop)) == reports_of(placed.run(agents))


TOO_LONG = "gave no answer in 4 s, and was killed"
UNAVAILABLE = {
    "die": "its process was killed by SIGKILL, 3 times",
    "exit": "its process ended with exit code 7, 3 times",
    "hang": TOO_LONG,
    "deaf": TOO_LONG,
    "garble": "gave an answer that cannot be read, 3 times",
    "eat": "needs more than 200 MB above what its process starts with, 3 times",
}


@pytest.mark.slow
@pytest.mark.parametrize("how", UNAVAILABLE)
def test_what_cannot_be_had_is_told_with_the_reason(placed, monkeypatch, how):
    """The limit of those that are waited for is one that a worker that works keeps on a busy machine, too."""
    is_waited_for = UNAVAILABLE[how] == TOO_LONG
    limits = Limits(answer_s=4.0, first_s=4.0) if is_waited_for else Limits(memory_mb=200)
    settings = {"limits": limits, "retries": 0 if is_waited_for else 2}
    send = Worker._send

    def sent_late(worker, *message):
        send(worker, *message)
        time.sleep(0.05)

    monkeypatch.setattr(Worker, "_send", sent_late)
    with placed.executing({"a": ("placed", {"how": how, "at": 0})}, "processes", **settings) as made:
        engine, _ = made
        cue, cache = next(iter(engine.plates["plate"].cues.values())), placed.cache()
        planes = cache.planes(cue.needs, placed.region)
        learnt = cue.learn(planes, placed.box)
        assert learnt["big"].size == 1000
        with pytest.raises(AgentUnavailable) as raised:
            cue.log_likelihood(planes, placed.hypotheses, learnt)
        assert str(raised.value) == UNAVAILABLE[how]
        assert cue.learn(planes, placed.box)["big"].tobytes() == learnt["big"].tobytes()


@pytest.mark.slow
@pytest.mark.parametrize(
    "how", ["raise", "own error", "mute", "leave", "short", "words", "complex", "masked", "objects"]
)
def test_a_fault_is_told_in_the_same_words(placed, reports_of, how):
    agents = {"a": ("placed", {"how": how, "engine": 0}), "b": ("placed_measurer", {})}
    outcomes = placed.run(agents, "processes", workers=1)
    faults = [event.reason for outcome in outcomes for event in outcome.events if hasattr(event, "reason")]
    assert len(faults) == 1
    assert reports_of(outcomes) == reports_of(placed.run(agents))


@pytest.mark.slow
@pytest.mark.parametrize("how", ["paint", "bend", "rename"])
def test_a_cue_that_writes_into_what_others_see_is_out_on_every_executor(placed, reports_of, how):
    """It writes in frame 3; the others go on as without it, and all executors tell the same."""
    agents = {**TWO, "c": ("placed", {"how": how, "engine": 0})}
    expected = placed.run(agents)
    (out,) = [event for outcome in expected for event in outcome.events if hasattr(event, "reason")]
    assert (out.node, out.frame) == ("c", 3)
    for kind, workers in (("processes", 1), ("processes", 2)):
        assert reports_of(placed.run(agents, kind, workers=workers)) == reports_of(expected)


@pytest.mark.slow
def test_a_worker_that_died_while_it_had_nothing_to_do_costs_no_attempt(placed, reports_of):
    with placed.executing(TWO, "processes", workers=2, retries=0) as (engine, executor):
        killed = []

        def kill(frame):
            for pid in executor.processes.workers() if frame == 3 else ():
                os.kill(pid, signal.SIGKILL)
                killed.append(pid)
            while any(pid in executor.processes.workers() for pid in killed):
                time.sleep(0.001)

        assert reports_of(placed.play(engine, before=kill)) == reports_of(placed.run(TWO))
        assert len(killed) == 2
