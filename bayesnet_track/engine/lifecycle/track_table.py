"""The live targets of a frame while births and deaths change them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import compress

import numpy as np

from bayesnet_track.adapt.lifecycle import TrackHistory, TrackRecord, find_end_cause
from bayesnet_track.adapt.memory import LOST
from bayesnet_track.belief.motion.modes import has_modes, moments_of
from bayesnet_track.engine.compiled import Engine
from bayesnet_track.engine.lines import Lines
from bayesnet_track.engine.modes import combination_probabilities
from bayesnet_track.engine.outcome import Outcome
from bayesnet_track.engine.rows.columns import Rows
from bayesnet_track.engine.rows.finding import rows_of
from bayesnet_track.engine.state import TargetState
from bayesnet_track.engine.targets import Records, Targets
from bayesnet_track.graph.settings.lifecycle import Death
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.lives import DuplicateEnded, TargetDied
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.net import Decision, Net, apply_decisions
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import Reference
from bayesnet_track.observation.planes import Frame

Ending = tuple[str, tuple[str, int, int]]
"""A target and why it ends, as `adapt.lifecycle.find_end_cause` has it."""


@dataclass(eq=False)
class LiveTable:
    """The live targets: rows of tables, and others, which start or start again in the frame or fit no table.

    Attributes:
        engine: the graph ready to run.
        net: the live nets.
        tables: plate -> its rows as they were advanced in this frame.
        states: other target -> its state.
        records: other target -> what is counted of it.
        metrics: one entry per target that was live in this frame, but for the new ones.
        history: what is remembered, but for the records.
        lines: those of targets that start.
        gone: targets of the tables that ended, or started again.
        events: decisions and other events, in order.
    """

    engine: Engine
    net: Net
    tables: dict[str, Rows]
    states: dict[str, TargetState]
    records: dict[str, TrackRecord]
    metrics: Lines
    history: TrackHistory
    lines: list[FrameMetrics] = field(default_factory=list)
    gone: set[str] = field(default_factory=set)
    events: list[Event] = field(default_factory=list)

    @classmethod
    def of(cls, engine: Engine, outcome: Outcome) -> LiveTable:
        """Table of a frame's outcome."""
        state, targets = outcome.state, Targets.of(outcome.state.targets)
        records = state.history.records
        return cls(
            engine,
            state.net,
            {rows.rule.plate: rows for rows in targets.gaussians},
            targets.apart(),
            dict(records.others if isinstance(records, Records) else records),
            outcome.metrics,
            state.history,
        )

    def decide(self, *decisions: Decision) -> None:
        """Write decisions down and carry them out."""
        self.net = apply_decisions(self.net, decisions)
        self.events += decisions

    def count(self, plates: Mapping[str, bool], frame: Frame) -> None:
        """One more frame for every live target of these plates.

        `plates` says whether anybody looked for detections: else the frame is none in which they are unseen.
        """
        numbers: list[int] = []
        for plate, rows in self.tables.items():
            is_new = rows.columns.since < 0
            if plate in plates:
                self.tables[plate] = rows.counted(frame.index, frame.time, plates[plate])
            if is_new.any():  # the numbers of those that a table did not count before
                targets = (rows.ids[row] for row in np.flatnonzero(is_new).tolist())
                numbers += [int(target) for target in targets if target.isdecimal()]
        records = {}
        for target, state in self.states.items():
            if target.isdecimal():
                numbers.append(int(target))
            if self.net.targets[target].template not in plates:
                continue
            lost = self.net.targets[target].status == "lost"
            record = self.records.get(target)
            if record is None or not (lost or state.memory.count(LOST)):
                start = frame.index if record is None else record.since
                unseen = 0 if record is None else record.unseen_frames
                record = TrackRecord(start, *moments_of(state.belief), frame.time, 0, unseen)
            records[target] = replace(
                record,
                lost_frames=record.lost_frames + 1 if lost else 0,
                unseen_frames=record.unseen_frames + plates[self.net.targets[target].template],
            )
        self.records = records
        if numbers:
            self.history = evolve(self.history, last_id=max([self.history.last_id, *numbers]))

    def state(self, target: str) -> TargetState:
        """State of a target."""
        if target in self.states:
            return self.states[target]
        rows = self._table_of(target)
        return rows.state(rows.index[target])

    def record(self, target: str) -> TrackRecord:
        """Counts of a target."""
        if target in self.records:
            return self.records[target]
        rows = self._table_of(target)
        return rows.record(rows.index[target])

    def mean(self, target: str) -> Floats:
        """(D,) the mean of a target's belief."""
        if target in self.states:
            return self.states[target].belief.mean
        rows = self._table_of(target)
        return np.asarray(rows.columns.mean[rows.index[target]])

    def kinds(self, target: str, plate: str) -> Floats | None:
        """Probabilities of what a target is; None of one that is nothing in particular."""
        belief = self.states[target].belief if target in self.states else None
        if belief is None or not has_modes(belief):
            return None
        return combination_probabilities(belief, self.engine.plates[plate].modes)

    def references(self, target: str) -> Mapping[str, Reference]:
        """References that the agents remember of a target."""
        if target in self.states:
            return self.states[target].references
        rows = self._table_of(target)
        return rows.remembered(rows.index[target])

    def unseen(self, plate: str, width: int) -> tuple[list[str], Ints, Floats]:
        """Live targets of a plate without a detection of their own: (U,) for how many frames, means (U, D).

        A state has `width` fields, D.
        """
        ids, frames, means = list[str](), list[int](), list[Floats]()
        if plate in self.tables:
            rows = self.tables[plate]
            places = np.flatnonzero(rows.columns.unseen_frames > 0).tolist()
            places = [row for row in places if rows.ids[row] not in self.gone] if self.gone else places
            ids, frames = [rows.ids[row] for row in places], rows.columns.unseen_frames[places].tolist()
            means = [*rows.columns.mean[places]]
        for target in self.states:
            is_own = self.net.targets[target].template == plate
            if is_own and self.records[target].unseen_frames > 0:
                ids.append(target)
                frames.append(self.records[target].unseen_frames)
                means.append(self.mean(target))
        return ids, np.array(frames, dtype=np.int64), np.array(means) if ids else np.empty((0, width))

    def _table_of(self, target: str) -> Rows:
        return next(rows for rows in self.tables.values() if target in rows.index)

    def _ids(self, plate: str) -> Sequence[str]:
        """The rows of a plate that are left."""
        ids = self.tables[plate].ids if plate in self.tables else ()
        return [target for target in ids if target not in self.gone] if self.gone else ids

    def of_plate(self, plate: str) -> list[str]:
        """Its live targets, in the order of their births; those that are no row come last."""
        singles = (target for target in self.states if self.net.targets[target].template == plate)
        return [*self._ids(plate), *singles]

    def held(self, plate: str) -> list[str]:
        """Its live targets that are not lost."""
        nets, live = self.net.targets, list[str]()
        if plate in self.tables:
            rows = self.tables[plate]
            live += compress(rows.ids, (~rows.columns.is_lost).tolist())
        if self.gone:
            live = [target for target in live if target not in self.gone]
        singles = (target for target in self.states if nets[target].template == plate)
        return [*live, *(target for target in singles if nets[target].status != "lost")]

    def boxes(self, targets: Sequence[str]) -> Floats:
        """(K, 4) estimates of this frame."""
        return self.metrics.with_born(self.lines).boxes_of(targets)

    def beliefs(self, targets: Sequence[str]) -> tuple[Floats, Floats, Sequence[int]]:
        """(K, 4) means and (K, 4, 4) covariances of the boxes, and the frames of the births.

        All of a plate, those that are no row last.
        """
        singles = [target for target in targets if target in self.states]
        beliefs = [self.states[target].belief for target in singles]
        mean = np.array([belief.mean[:4] for belief in beliefs]).reshape(-1, 4)
        covariance = np.array([belief.covariance[:4, :4] for belief in beliefs]).reshape(-1, 4, 4)
        starts = [self.records[target].since for target in singles]
        in_rows = targets[: len(targets) - len(singles)]
        if not in_rows:
            return mean, covariance, starts
        table = self._table_of(in_rows[0])
        columns = table.columns
        rows = slice(None) if tuple(in_rows) == table.ids else [table.index[target] for target in in_rows]
        births = columns.since[rows].tolist()
        if not singles:
            return columns.mean[rows, :4], columns.covariance[rows, :4, :4], births
        means, spreads = [columns.mean[rows, :4], mean], [columns.covariance[rows][:, :4, :4], covariance]
        return np.concatenate(means), np.concatenate(spreads), births + starts

    def mark_seen(self, targets: Iterable[str]) -> None:
        """Targets have a detection of their own."""
        claimed_rows: dict[str, list[int]] = {}
        for target in targets:
            if target in self.records:
                self.records[target] = replace(self.records[target], unseen_frames=0)
                continue
            plate = self.net.targets[target].template
            claimed_rows.setdefault(plate, []).append(self.tables[plate].index[target])
        for plate, claimed in claimed_rows.items():
            rows = self.tables[plate]
            unseen = rows.columns.unseen_frames.copy()
            unseen[claimed] = 0
            self.tables[plate] = rows.changed(columns=rows.columns.changed(unseen_frames=unseen))

    def add(self, target: str, state: TargetState, record: TrackRecord, metrics: FrameMetrics) -> None:
        """A target starts."""
        self.lines.append(metrics)
        self.put_back(target, state, record)

    def put_back(self, target: str, state: TargetState, record: TrackRecord) -> None:
        """A target starts again."""
        if any(target in rows.index for rows in self.tables.values()):
            self.gone.add(target)
        self.states[target], self.records[target] = state, record

    def ending(self, plate: str, rule: Death) -> list[Ending]:
        """Targets whose time is over."""
        over: list[str] = []
        if plate in self.tables:
            rows = self.tables[plate]
            is_over = rows.columns.lost_frames >= rule.lost_frames
            if rule.unseen_frames is not None:
                is_over |= rows.columns.unseen_frames >= rule.unseen_frames
            over = [rows.ids[row] for row in np.flatnonzero(is_over).tolist()]
        live = [target for target in over if target not in self.gone]
        singles = [target for target in self.states if self.net.targets[target].template == plate]
        causes = {target: find_end_cause(self.record(target), rule) for target in (*live, *singles)}
        return [(target, why) for target, why in causes.items() if why is not None]

    def vanishing(self, plate: str, end: float) -> list[tuple[str, float]]:
        """Targets that exist with a smaller probability than `end`, and that probability."""
        ending: list[tuple[str, float]] = []
        if plate in self.tables:
            rows = self.tables[plate]
            existence = rows.columns.existence
            low = [(rows.ids[row], float(existence[row])) for row in np.flatnonzero(existence < end).tolist()]
            ending = [(target, value) for target, value in low if target not in self.gone]
        singles = [target for target in self.states if self.net.targets[target].template == plate]
        existences = ((target, self.states[target].existence) for target in singles)
        return [
            *ending,
            *((target, value) for target, value in existences if value is not None and value < end),
        ]

    def end(self, decision: TargetDied | DuplicateEnded) -> None:
        """A target ends."""
        self.decide(decision)
        self.records.pop(decision.target, None)
        if self.states.pop(decision.target, None) is None:
            self.gone.add(decision.target)

    def outcome(self, previous: Outcome, frame: Frame) -> Outcome:
        """The outcome with all that was done here: targets that start are rows where they fit."""
        tables, nets = dict(self.tables), self.net.targets
        for plate, rows in self.tables.items():
            ended = self.gone.intersection(rows.ids) if self.gone else ()
            if ended:
                keep = np.array([target not in ended for target in rows.ids], dtype=np.bool_)
                tables[plate] = rows.take(keep)
        if tables:
            fit = rows_of(self.engine, nets, self.states, self.records, frame.time)
            for plate, rows in fit.items():
                tables[plate] = tables[plate].extended(rows) if plate in tables else rows
                for target in rows.ids:
                    del self.states[target], self.records[target]
        checked = previous.state.net.targets
        unsure = {plate for plate, rows in self.tables.items() if rows.checked is not checked}
        gaussians = [
            rows.changed(checked=None if plate in unsure else nets) for plate, rows in tables.items()
        ]
        targets: Mapping[str, TargetState] = self.states
        records: Mapping[str, TrackRecord] = self.records
        if gaussians:
            targets, records = Targets(gaussians, (), self.states), Records(gaussians, self.records)
        history = evolve(self.history, records=records)
        state = evolve(previous.state, net=self.net, targets=targets, previous=frame, history=history)
        metrics = self.metrics.with_born(self.lines)
        return evolve(previous, state=state, metrics=metrics, events=(*previous.events, *self.events))
