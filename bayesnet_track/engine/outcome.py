"""State of the engine between frames, and the outcome of one frame."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from bayesnet_track.adapt.joins import JoinMemory, decide_joins
from bayesnet_track.adapt.lifecycle import TrackHistory
from bayesnet_track.adapt.shedding import Load, balance
from bayesnet_track.engine.external_inputs import ExternalInputs
from bayesnet_track.engine.finishing import Results
from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.joining import JointBelief, reaches_of
from bayesnet_track.engine.metrics import Heard, Lines, WhenAsked
from bayesnet_track.engine.rows.columns import Rows
from bayesnet_track.engine.rows.judging import JudgedRows
from bayesnet_track.engine.rows.row_heard import RowHeard
from bayesnet_track.engine.rows.row_metrics import RowMetrics
from bayesnet_track.engine.shedding import balance_load
from bayesnet_track.engine.state import TargetState, recompile
from bayesnet_track.engine.targets import Records, Targets
from bayesnet_track.journal.events.event import Event, Input
from bayesnet_track.journal.events.load import LateFrame, SpareTime
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.net.net import Net, apply_decisions
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.records import changed
from bayesnet_track.observation.planes import Frame
from bayesnet_track.vision.planes import Scene

Value = TypeVar("Value")


@dataclass(frozen=True, eq=False)
class State:
    """The engine's state between frames.

    Attributes:
        net: the live nets.
        targets: target id -> its state.
        previous: the last frame.
        history: what is remembered of births and deaths.
        joins: what is remembered of targets that depend on each other.
        load: what is remembered of late frames.
        scene: what the last frame showed that showed anything; None where no graph asks for cuts.
    """

    net: Net = field(default_factory=Net)
    targets: Mapping[str, TargetState] = field(default_factory=dict)
    previous: Frame | None = None
    history: TrackHistory = field(default_factory=TrackHistory)
    joins: JoinMemory = field(default_factory=JoinMemory)
    load: Load = field(default_factory=Load)
    scene: Scene | None = None


@dataclass(frozen=True, eq=False)
class Outcome:
    """Outcome of one frame.

    Attributes:
        state: the state after it.
        metrics: one entry per live target, made when they are asked for.
        events: decisions and faults, in order.
        covariances: target id -> covariance (D, D) of its belief.
        seconds: agent (or planes, belief, measure, learn) -> seconds, summed over targets.
        external_inputs: what came from outside: given again with this frame, it repeats.
        heard: target id -> what its agents said.
    """

    state: State
    metrics: Sequence[FrameMetrics]
    events: tuple[Event, ...]
    covariances: Mapping[str, Floats] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    external_inputs: tuple[Input, ...] = ()
    heard: Mapping[str, Heard] = field(default_factory=dict)


def carry_out(
    work: FrameWork,
    state: State,
    results: Results,
    joint: JointBelief,
    judged: Sequence[JudgedRows] = (),
) -> Outcome:
    """The outcome of the targets' frames: decisions are carried out, of rows first."""
    net, others = work.net, dict[str, TargetState]()
    events: list[Event] = [*joint.events]
    for one in judged:
        net = apply_decisions(net, one.decisions)
        events += one.decisions
    for target, (group, row) in results.singles.items():
        decisions = group.decisions(row)
        net = apply_decisions(net, decisions)
        others[target] = recompile(work.engine, net, target, group.state(row))
        events += [*group.events(row), *decisions]
    metrics: Sequence[FrameMetrics] = Lines(results.lines, results.boxes) if results.order else ()
    tables = [group.table for group in results.groups if group.table is not None]
    targets: Mapping[str, TargetState] = others
    if tables:
        targets = Targets((), tables, others, results.order)
    covariances, heard, history = results.covariances, results.heard, state.history
    if judged:
        several = [one.table(work.frame.time, net.targets) for one in judged]
        targets = Targets(several, tables, others, results.order)
        apart = {one: history.records[one] for one in results.order if one in history.records}
        history = changed(history, records=Records(several, apart))
        metrics = _lines_of(work, judged, several, metrics)
        covariances = _joined([WhenAsked(rows.ids, rows.covariance) for rows in several], covariances)
        heard = _joined([RowHeard(rows) for rows in several], heard)
    return Outcome(
        changed(state, net=net, targets=targets, previous=work.frame, joins=joint.memory, history=history),
        metrics,
        tuple(events),
        covariances,
        work.seconds,
        heard=heard,
    )


def _lines_of(
    work: FrameWork, judged: Sequence[JudgedRows], tables: Sequence[Rows], others: Sequence[FrameMetrics]
) -> Sequence[FrameMetrics]:
    """The lines of all: those of the first table as columns."""
    first, *more = (
        RowMetrics(rows, one.measured, work, one.before.columns.is_lost)
        for one, rows in zip(judged, tables, strict=True)
    )
    return first.with_born((*(line for of in more for line in of), *others)) if more or others else first


def _joined(tables: Sequence[Mapping[str, Value]], others: Mapping[str, Value]) -> Mapping[str, Value]:
    if len(tables) == 1 and not others:
        return tables[0]
    several = (*tables, others)
    ids = [target for one in several for target in one]
    return WhenAsked(ids, lambda target: next(one for one in several if target in one)[target])


def with_joins(work: FrameWork, outcome: Outcome) -> Outcome:
    """The outcome after the frame's joins and partings; as it is where the graph has no joins."""
    joins = work.engine.joins
    if not joins:
        return outcome
    state, started = outcome.state, work.engine.clock()
    reaches = reaches_of(*moments_of(state.targets, outcome.covariances))
    decisions, memory = decide_joins(work.frame.index, joins, state.net, reaches, state.joins)
    work.charge("joins", started)
    after = changed(state, net=apply_decisions(state.net, decisions), joins=memory)
    return changed(outcome, state=after, events=(*outcome.events, *decisions), seconds=work.seconds)


def moments_of(
    targets: Mapping[str, TargetState], known: Mapping[str, Floats]
) -> tuple[list[str], Floats, Floats]:
    """The targets, and of their beliefs the means (T, 4) and variances (T, 4) of the boxes.

    `known` has covariances (D, D) that were found before.
    """
    names = list(targets)
    boxes, variances = np.empty((len(names), 4)), np.empty((len(names), 4))
    at = dict(zip(names, range(len(names)), strict=True))
    several = Targets.of(targets)
    for table in several.particles:
        rows = [at[target] for target in table.ids]
        boxes[rows], variances[rows] = table.clouds.box_moments
    for target, one in several.others.items():
        spread = known.get(target)
        boxes[at[target]] = one.belief.mean[:4]
        variances[at[target]] = (one.belief.covariance if spread is None else spread).diagonal()[:4]
    return names, boxes, variances


def with_load(work: FrameWork, outcome: Outcome, timing: Iterable[LateFrame | SpareTime]) -> Outcome:
    """The outcome after what is shed or taken back, where a frame was late or early."""
    timing, state, engine = tuple(timing), outcome.state, work.engine
    if not timing:
        if not state.load.counts:
            return outcome
        _, load = balance(work.frame.index, (), {}, state.load)
        return changed(outcome, state=changed(state, load=load))
    decisions, load = balance_load(engine, state.net, state.targets, timing, state.load, work.frame.index)
    net = apply_decisions(state.net, decisions)
    targets = {target: recompile(engine, net, target, one) for target, one in state.targets.items()}
    after = changed(state, net=net, targets=targets, load=load)
    return changed(outcome, state=after, events=(*outcome.events, *decisions))


def with_external_inputs(outcome: Outcome, given: ExternalInputs) -> Outcome:
    """The outcome with what came from outside, its notices first."""
    notices: tuple[Event, ...] = (*given.availability.events, *given.refused)
    if not notices and not given.to_repeat:
        return outcome
    return changed(outcome, events=(*notices, *outcome.events), external_inputs=given.to_repeat)
