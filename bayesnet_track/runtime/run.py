"""The run loop: frames in, results out, everything written down as it happens."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Protocol

from bayesnet_track.engine.starts import (
    Start,
    StartError,
    check_started,
    check_starts,
    say_blank,
    start_targets,
)
from bayesnet_track.engine.step import Engine, Outcome, State, make_engine, step
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.journal.events.cameras import ClockLearnt
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.runs import JOURNAL_VERSION, FrameSizeChanged, RunEnded, RunStarted
from bayesnet_track.journal.net import Decision
from bayesnet_track.numerics.compile_watch import WATCH
from bayesnet_track.observation.planes import Frame
from bayesnet_track.runtime.checkpoints.origins import versions
from bayesnet_track.runtime.pace import Deadline
from bayesnet_track.runtime.resizing import Resizing
from bayesnet_track.runtime.results import FrameKind, FrameSource, InputsAt, Result, Sink, Summary, nothing
from bayesnet_track.sources.frames import SourceItem

__all__ = ["FrameSource", "Result", "Sink", "Start", "StartError", "Summary", "run"]


@dataclass(frozen=True, eq=False)
class RunPosition:
    """The position of a run between two frames.

    Attributes:
        frame: the last frame, as the engine saw it.
        state: the engine's state after it.
        frames: frames that were tracked.
        reconfigurations: how many times an agent was switched on or off.
        lost_frames: frames in which a target was lost.
    """

    frame: Frame
    state: State
    frames: int
    reconfigurations: int
    lost_frames: int


@dataclass(frozen=True, eq=False)
class Resumed:
    """The state and the position from which a run goes on.

    Attributes:
        reached: how far it was.
        items: what the source gives after that.
        events: what is told first.
    """

    reached: RunPosition
    items: Iterator[SourceItem]
    events: tuple[Event, ...] = ()


class Checkpointer(Protocol):
    """A keeper of a run's position, so that the run can go on from there."""

    def reached(self, position: RunPosition) -> None:
        """A frame is done, and every sink was told of it."""

    def stopped(self) -> None:
        """The caller stops between two frames; the journal's last line is still to come."""

    def ended(self) -> None:
        """The source was read to its end, and the journal has its last line."""


def run(
    graph: CheckedGraph,
    source: FrameSource,
    starts: Sequence[Start],
    *,
    seed: int = 0,
    sinks: Sequence[Sink] = (),
    summary: Summary | None = None,
    engine: Engine | None = None,
    inputs: Mapping[str, str] = MappingProxyType({}),
    external_inputs: InputsAt = nothing,
    deadline: Deadline | None = None,
    checkpointer: Checkpointer | None = None,
    after: Resumed | None = None,
    max_side: int | None = None,
) -> Generator[Result, None, None]:
    """Track through `source`, yielding a result per frame.

    Args:
        graph: a checked graph.
        source: where frames come from.
        starts: boxes in the first frame, one per target; ids are "1", "2", ... in this order. None are needed
            where the graph has `birth`.
        seed: seed of all random streams: the same graph, source, starts and seed give the same results.
        sinks: told of every event and result.
        summary: filled in as the run goes on.
        engine: an engine made from `graph`, to share between runs; made here when None.
        inputs: files from outside that the engine reads, besides the source -> their SHA-256, to be told.
        external_inputs: asked before each frame for what came from outside, by the frame's index: a
            `results.Switchboard` of a live view, or `results.replay_inputs` of an earlier run.
        deadline: the time that a frame may take: what is late is told to the engine, which sheds load.
        checkpointer: told after each frame how far the run is.
        after: go on from there: `source` was read so far, and sinks know already what was before.
        max_side: longest side of the frames that are tracked in, px; see `runtime.resizing`.

    The journal is closed in order also when the caller stops iterating or an error passes through.

    Raises:
        ValueError: a frame is not of the size, the type and the channels of the first one.
        StartError: no target can start so, of which nothing was told to a sink before; or no agent of any
            target can (`check_started`): then sinks were told why.
    """
    check_starts(graph, starts, source.width, source.height)
    totals = summary if summary is not None else Summary()
    resizing = Resizing.to(source.width, source.height, max_side)
    placed = [resizing.start(start) for start in starts]
    engine = engine or make_engine(resizing.graph(graph), seed)

    def emit(event: Event) -> None:
        for sink in sinks:
            sink.event(event)

    state: State | None = None
    has_started = False
    if after is not None:
        state, has_started = after.reached.state, True
        totals.frames, totals.reconfigurations = after.reached.frames, after.reached.reconfigurations
        totals.lost_frames = after.reached.lost_frames
    opened, compiled_before = time.perf_counter(), WATCH.seconds
    first_done: tuple[float, int] | None = None
    kind: FrameKind | None = None
    try:
        for event in () if after is None else after.events:
            emit(event)
        for item in source if after is None else after.items:
            if not isinstance(item, Frame):
                if kind is not None and isinstance(item, FrameSizeChanged):
                    kind = kind.of_either_color  # the source resizes, but leaves gray as it is
                totals.notices.append(item)
                if has_started:
                    emit(item)
                continue
            kind = kind or FrameKind.of(item)
            kind.check(item, "end the source before it")
            began, compiled = time.perf_counter(), WATCH.seconds
            resized = resizing.frame(item)
            if state is None:
                has_started = True
                # What was found wrong before the first frame comes after the journal's first line.
                header = _run_started(graph, engine, source, item, seed, inputs)
                if not resizing.is_none:
                    header = replace(header, tracked=resizing.tracked)
                for event in (header, *totals.notices):
                    emit(event)
                say_blank(item, starts)
                frame_inputs = external_inputs(item.index)
                outcome = start_targets(graph, engine, resized, placed, frame_inputs)
            else:
                frame_inputs = external_inputs(item.index)
                if deadline is not None:
                    frame_inputs = (*frame_inputs, *deadline.inputs_for(item.index, state.net))
                    deadline.begin()
                outcome = step(engine, state, resized, frame_inputs)
                if deadline is not None:
                    deadline.end()
            previous, state = state, outcome.state
            outcome = resizing.outcome(outcome)
            spent = time.perf_counter() - began - (WATCH.seconds - compiled)
            for event in outcome.events:
                emit(event)
            if previous is None:
                check_started(graph, outcome)
            result = _result(item, outcome, spent, previous, tuple(graph.targets))
            totals.add(result)
            for sink in sinks:
                sink.frame(result)
            if first_done is None:
                first_done = _at_work(), totals.frames
            if checkpointer is not None:
                position = RunPosition(
                    resized, state, totals.frames, totals.reconfigurations, totals.lost_frames
                )
                checkpointer.reached(position)
            try:
                yield result
            except GeneratorExit:
                if checkpointer is not None:
                    checkpointer.stopped()
                raise
        totals.reason = source.end_reason
        totals.complete = totals.reason == "end_of_source"
        for event in _clocks(state):
            emit(event)
    except (KeyboardInterrupt, GeneratorExit):
        totals.reason = "interrupted"
        raise
    finally:
        totals.seconds = time.perf_counter() - opened
        totals.compiling_s = WATCH.seconds - compiled_before
        if first_done is not None and totals.frames > first_done[1]:
            totals.frames_per_second = (totals.frames - first_done[1]) / (_at_work() - first_done[0])
        if has_started:
            emit(RunEnded(totals.frames, source.expected_frames, totals.complete, totals.reason))
    if checkpointer is not None and has_started:
        checkpointer.ended()


def _clocks(state: State | None) -> Iterator[Event]:
    """The clocks of cameras after the last frame, where they are learnt."""
    if state is None or state.previous is None or state.history.errors is None:
        return
    for camera, previous in state.history.errors.reported.items():
        reading = state.history.errors.reading(camera)
        if reading != previous:
            yield ClockLearnt(
                state.previous.index, camera, reading.offset_s, reading.sd_s, previous.offset_s, previous.sd_s
            )


def _at_work() -> float:
    """The clock as if it had stood while kernels were compiled."""
    return time.perf_counter() - WATCH.seconds


def _result(
    frame: Frame, outcome: Outcome, spent: float, previous: State | None, plates: tuple[str, ...]
) -> Result:
    # Who ended in this frame was live in it.
    nets = {**(previous.net.targets if previous is not None else {}), **outcome.state.net.targets}
    decisions = tuple(event for event in outcome.events if isinstance(event, Decision))
    return Result(
        frame,
        outcome.metrics.settled(),
        dict(outcome.covariances),
        decisions,
        dict(outcome.seconds),
        spent,
        outcome.external_inputs,
        {target: nets[target].template for target in outcome.metrics.ids if target in nets},
        outcome.state.targets,
        outcome.heard,
        outcome.state.history.births,
        plates,
        {answer.query: answer for answer in outcome.answers},
        outcome.cameras,
    )


def _run_started(
    graph: CheckedGraph,
    engine: Engine,
    source: FrameSource,
    frame: Frame,
    seed: int,
    inputs: Mapping[str, str],
) -> RunStarted:
    from bayesnet_track.graph.text.write import graph_sha256

    costs = {
        compiled.plate.agent(agent).agent.cue: cost
        for compiled in engine.plates.values()
        for agent, cost in compiled.costs_ms.items()
    }
    return RunStarted(
        journal=JOURNAL_VERSION,
        graph=graph.spec.name,
        graph_sha256=graph_sha256(graph.text),
        seed=seed,
        source=source.description,
        width=frame.width,
        height=frame.height,
        has_color=frame.has_color,
        declared_frames=source.expected_frames,
        frame_interval_s=source.frame_interval_s,
        costs_ms=MappingProxyType(costs),
        versions=versions(),
        inputs=inputs,
    )
