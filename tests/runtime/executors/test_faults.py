"""Agents in real processes that raise, are killed, hang or are late, and all of them dead at once."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from bayesnet_track.inference.asking import AgentUnavailable
from bayesnet_track.journal.events.faults import AgentMissed, Quarantined
from bayesnet_track.journal.events.statuses import StatusChanged
from bayesnet_track.journal.reader import read_inputs
from bayesnet_track.runtime.pace import WARM_UP, Deadline
from bayesnet_track.runtime.results import replay_inputs

pytestmark = pytest.mark.slow

FILES = ("journal.jsonl", "frames.npy.gz", "tracks.txt", "inputs.jsonl")
TWO = {"a": ("placed", {}), "b": ("placed_measurer", {})}
SEEN_S, BACK_S = 0.05, 1.0
ATTEMPTS = 3
"""Times are measured again where a neighbour held the processors: the machine is no real-time system."""


def waited_ms():
    """For how long the threads of this process have waited for a processor."""
    waits = [path.read_text().split() for path in Path("/proc/self/task").glob("*/schedstat")]
    return sum(float(delay) for _, delay, _ in waits) / 1e6


class SlowReferences(Deadline):
    """Remembers what each frame took, less what it waited for a processor that others held."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.own_ms = []

    def begin(self):
        self.before = time.monotonic(), waited_ms()
        super().begin()

    def end(self):
        super().end()
        began, waited = self.before
        self.own_ms.append(1e3 * (time.monotonic() - began) - (waited_ms() - waited))


@pytest.fixture
def files():
    return lambda folder: {name: (folder / name).read_bytes() for name in FILES if (folder / name).exists()}


def test_a_killed_worker_is_seen_within_50_ms_and_back_within_a_second(placed):
    """Killed ten times while it works; the median counts, since others use this machine, too."""
    agents = {"c": ("placed", {"how": "hang", "at": 0})}
    seen, back = [], []
    with placed.executing(agents, "processes", retries=0) as (engine, executor):
        cue, cache = next(iter(engine.plates["plate"].cues.values())), placed.cache()
        planes = cache.planes(cue.needs, placed.region)
        learnt = dict(cue.learn(planes, placed.box))
        for _ in range(10):
            (worker,) = executor.processes.workers()
            moment = []

            def kill(worker=worker, moment=moment):
                moment.append(time.monotonic())
                os.kill(worker, signal.SIGKILL)

            timer = threading.Timer(0.1, kill)
            timer.start()
            with pytest.raises(AgentUnavailable, match="killed by SIGKILL"):
                cue.log_likelihood(planes, placed.hypotheses, learnt)
            seen.append(time.monotonic() - moment[0])
            dict(cue.learn(planes, placed.box))
            back.append(time.monotonic() - moment[0])
            timer.join()
    print(f"seen: median {np.median(seen) * 1e3:.1f} ms, most {max(seen) * 1e3:.1f} ms")
    print(f"answering again: median {np.median(back) * 1e3:.1f} ms, most {max(back) * 1e3:.1f} ms")
    assert np.median(seen) < SEEN_S and np.median(back) < BACK_S


@pytest.mark.parametrize("how", ["die", "exit"])
def test_on_a_file_the_frame_is_tried_again_and_no_byte_changes(placed, files, tmp_path, how):
    left = tmp_path / "left"
    left.write_text("once")
    agents = {**TWO, "c": ("placed", {"how": how, "times": str(left)})}
    with placed.executing(agents, "processes", workers=2) as (engine, _):
        placed.record(engine, agents, tmp_path / "killed")
    assert left.read_text() == ""
    with placed.executing(agents, "serial") as (engine, _):
        placed.record(engine, agents, tmp_path / "whole")
    assert files(tmp_path / "killed") == files(tmp_path / "whole")
    assert "inputs.jsonl" not in files(tmp_path / "killed")


def test_live_a_frame_without_an_agent_is_that_of_the_agent_off(placed, files, tmp_path):
    """No retry: its frame is finished without it, and the lines of inputs.jsonl give the same bytes."""
    left = tmp_path / "left"
    left.write_text("once")
    agents = {**TWO, "c": ("placed", {"how": "die", "at": 7, "times": str(left)})}
    with placed.executing(agents, "processes", workers=2, retries=0) as (engine, _):
        live = placed.record(engine, agents, tmp_path / "live")
    recorded = list(read_inputs(tmp_path / "live" / "inputs.jsonl"))
    reason = "its process was killed by SIGKILL"
    assert AgentMissed(7, "1", "c", reason, "observing") in recorded and {one.frame for one in recorded} == {
        7
    }
    assert [result.targets[0].active for result in live[6:9]] == [
        ("a", "b", "c"),
        ("a", "b"),
        ("a", "b", "c"),
    ]
    with placed.executing(agents, "serial") as (engine, _):
        placed.record(
            engine, agents, tmp_path / "off", external_inputs=lambda frame: recorded if frame == 7 else ()
        )
    assert files(tmp_path / "off") == files(tmp_path / "live")
    # What the others say in that frame is, bit for bit, what a net without the agent says there.
    with placed.executing(agents, "serial") as (engine, _):
        missed = [AgentMissed(frame, "1", "c", "off") for frame in range(1, 20)]
        known = {one.frame: (one,) for one in missed}
        without = placed.play(engine, 8, given=lambda frame, state: known[frame])
    with placed.executing(TWO, "serial") as (engine, _):
        other = placed.play(engine, 8)
    assert [o.metrics[0].centre_box for o in without] == [o.metrics[0].centre_box for o in other]


def test_an_agent_that_raises_in_its_process_is_out_and_the_others_are_as_without_it(placed, files, tmp_path):
    agents = {**TWO, "c": ("placed", {"how": "raise", "at": 7, "engine": 0})}
    for kind, workers in (("serial", 1), ("processes", 2)):
        with placed.executing(agents, kind, workers=workers) as (engine, _):
            results = placed.record(engine, agents, tmp_path / kind)
    assert files(tmp_path / "serial") == files(tmp_path / "processes")
    (out,) = [d for result in results for d in result.decisions if isinstance(d, Quarantined)]
    assert (out.frame, out.node, out.until) == (7, "c", 17)
    assert [result.targets[0].active for result in results[7:17]] == [("a", "b")] * 10


BUDGET_MS = 100.0


@pytest.mark.parametrize("workers", [3, 2, 1])
def test_no_frame_waits_for_an_agent_ten_times_slower_than_the_budget(placed, files, tmp_path, workers):
    agents = {**TWO, "c": ("placed", {"how": "slow", "at": 7, "seconds": 10 * BUDGET_MS / 1e3})}
    for attempt in range(ATTEMPTS):
        out = tmp_path / f"{attempt}"
        with placed.executing(agents, "processes", workers=workers, retries=0) as (engine, executor):
            deadline = SlowReferences(BUDGET_MS, executor.processes)
            results = placed.record(engine, agents, out, 50, deadline=deadline)
        spent = np.array(deadline.own_ms[WARM_UP:])
        recorded = list(read_inputs(out / "inputs.jsonl"))
        # Whatever the machine did: a late answer is used in no frame, since the same inputs give the same.
        with placed.executing(agents, "serial") as (engine, _):
            placed.record(
                engine,
                agents,
                tmp_path / f"{attempt} again",
                50,
                external_inputs=replay_inputs(out / "inputs.jsonl"),
            )
        assert files(tmp_path / f"{attempt} again") == files(out)
        missed = [one for one in recorded if isinstance(one, AgentMissed)]
        slow = {one.frame for one in missed if one.node == "c" and one.during == "observing"}
        assert len(slow) >= 6 and all("c" not in results[frame].targets[0].active for frame in slow)
        others = {one.frame for one in missed if one.node != "c" and one.during == "observing"}
        late = np.array([results[frame].total_seconds * 1e3 for frame in sorted(slow)])
        most = max(result.total_seconds for result in results[1 + WARM_UP :]) * 1e3
        print(
            f"{workers} workers: {len(slow)} frames: median {np.median(late):.1f} ms, most {late.max():.1f};"
            f" all: most {most:.1f}, less waits {spent.max():.1f} of {BUDGET_MS:g}; others: {len(others)}"
        )
        # Those that share a worker with it may miss the frame in which it is found to be late, and the next,
        # in which a worker starts for them.
        if spent.max() <= 1.1 * BUDGET_MS and len(others) <= 2 * (workers < 3):
            return
    pytest.fail(f"in none of {ATTEMPTS} attempts")


@pytest.mark.parametrize("how", ["die", "hang"])
def test_with_all_processes_dead_there_is_prediction_only(placed, files, tmp_path, how):
    """From frame 6 on, every worker that is asked dies, or hangs until its time is over."""
    agents = {name: (cue, {"how": how, "at": -6}) for name, (cue, _) in TWO.items()}
    with placed.executing(agents, "processes", workers=2, retries=0) as (engine, executor):
        deadline = None if how == "die" else Deadline(BUDGET_MS, executor.processes)
        results = placed.record(engine, agents, tmp_path / "run", 40, deadline=deadline)
    assert len(results) == 40
    assert [result.targets[0].active for result in results[6:]] == [()] * 34
    assert results[5].targets[0].status == "tracking" and results[5].targets[0].score > 0.3
    (lost,) = [d.frame for r in results for d in r.decisions if isinstance(d, StatusChanged)]
    assert lost <= 16 and all(result.targets[0].status == "lost" for result in results[lost + 1 :])
    assert max(result.targets[0].score for result in results[6:]) < 0.01
    ud = np.array([result.targets[0].ud_px2 for result in results[5:]])
    # Fifty hypotheses tell a variance to within a fifth, so that means of eleven frames are compared.
    assert ud[1] > ud[0] and (np.diff(ud[1:34].reshape(3, 11).mean(axis=1)) > 0).all()
    with placed.executing(agents, "serial") as (engine, _):
        placed.record(
            engine,
            agents,
            tmp_path / "again",
            40,
            external_inputs=replay_inputs(tmp_path / "run" / "inputs.jsonl"),
        )
    assert files(tmp_path / "again") == files(tmp_path / "run")
