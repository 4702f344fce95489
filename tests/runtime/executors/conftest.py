"""Graphs of cues that worker processes can import, tracked by any executor."""

from __future__ import annotations

import importlib
import os
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bayesnet_track import Start
from bayesnet_track.engine.step import State, make_engine, start_target, step
from bayesnet_track.observation.cue import Hypotheses
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Region
from bayesnet_track.runtime.executors import make_executor
from bayesnet_track.runtime.recording.record import Recorder
from bayesnet_track.runtime.recording.rundir import RunDirectory
from bayesnet_track.runtime.run import run as run_loop


@pytest.fixture
def placed(monkeypatch, fakes):
    """`placed.cues`; `placed.engine(executor, nodes)`; `placed.play(...)`, every frame's outcome."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent / "cues"))
    cues = importlib.import_module("placed_cues").CUES

    def nodes(**agents):
        own = {
            name: {"parent": "root", "agent": {cue: {"engine": os.getpid(), **more}}}
            for name, (cue, more) in agents.items()
        }
        root = {"fuse": "product", "belief": {"particles": {"size": 50}}, "learn": {"below": {"ud_px2": 1e6}}}
        return {"root": root, **own}

    def graph(agents):
        return fakes.graph(nodes(**agents), cues)

    @contextmanager
    def executing(agents, kind, **settings):
        with make_executor(kind, cues=cues, **settings) as executor:
            yield executor.engine(make_engine(graph(agents), 0, cues)), executor

    def frames(count=6):
        rng = np.random.default_rng(4)
        return [Frame(n, float(n), rng.integers(0, 255, (100, 120, 3), dtype=np.uint8)) for n in range(count)]

    def play(engine, count=6, before=lambda frame: None, given=lambda index, state: ()):
        """Every frame's outcome; `before` is called with the number of each but the first.

        `given` says what comes from outside with each but the first.
        """
        state, outcomes = State(), []
        for frame in frames(count):
            if not outcomes:
                outcome = start_target(engine, state, frame, "1", "plate", np.array(fakes.START))
            else:
                before(frame.index)
                outcome = step(engine, state, frame, given(frame.index, state))
            state = outcome.state
            outcomes.append(outcome)
        return outcomes

    def run(agents, kind="serial", count=6, **settings):
        with executing(agents, kind, **settings) as (engine, _):
            return play(engine, count)

    @dataclass
    class Pictures:
        """As many frames as wanted, as a source."""

        expected_frames: int
        description: str = "pictures"
        frame_interval_s: float = 0.04
        width: int = 120
        height: int = 100
        end_reason: str = "end_of_source"

        def __iter__(self):
            yield from frames(self.expected_frames)

    def record(engine, agents, out, count=20, **settings):
        """The results of a run over the frames, written down in `out`."""
        checked, source = graph(agents), Pictures(count)
        x, y, w, h = fakes.START
        start = Start((x - w / 2, y - h / 2, w, h))
        with Recorder(RunDirectory.create(out), checked, 0.04) as recorder:
            return list(run_loop(checked, source, [start], engine=engine, sinks=[recorder], **settings))

    return SimpleNamespace(
        cues=cues,
        record=record,
        graph=graph,
        executing=executing,
        frames=frames,
        play=play,
        run=run,
        cache=lambda: PlaneCache(FramePair(frames(1)[0], None)),
        region=Region(0, 0, 120, 100),
        box=np.array(fakes.START),
        hypotheses=Hypotheses(np.array([fakes.START, (60.0, 40.0, 20.0, 20.0)])),
    )


@pytest.fixture
def reports_of():
    """What an outcome says, to be compared bit by bit."""

    def of(outcomes):
        return [
            (
                [(m.centre_box, m.ud_px2, m.active) for m in outcome.metrics],
                outcome.events,
                {
                    target: {
                        agent: {n: v.tobytes() for n, v in ref.items()} for agent, ref in s.references.items()
                    }
                    for target, s in outcome.state.targets.items()
                },
            )
            for outcome in outcomes
        ]

    return of
