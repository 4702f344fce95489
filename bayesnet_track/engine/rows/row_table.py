"""The live targets of a frame as rows while births and deaths change them."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import compress
from typing import Self

import numpy as np

from bayesnet_track.adapt.lifecycle import TrackHistory, TrackRecord, find_end_cause
from bayesnet_track.engine.compiled import Engine
from bayesnet_track.engine.lifecycle.track_table import Ending
from bayesnet_track.engine.outcome import Outcome
from bayesnet_track.engine.rows.columns import RowRecords, Rows, RowStates, make_rows
from bayesnet_track.engine.rows.fitting import nets_fit, states_fit
from bayesnet_track.engine.rows.row_metrics import RowMetrics
from bayesnet_track.engine.state import TargetState
from bayesnet_track.graph.settings.lifecycle import Death
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.lives import DuplicateEnded, TargetDied
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.net.net import Decision, Net, apply_decisions
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.records import changed
from bayesnet_track.observation.planes import Frame


@dataclass(eq=False)
class RowTable:
    """The targets as rows (`track_table.LiveTable`); those that start are objects until the frame is over.

    Attributes:
        engine: the graph ready to run.
        net: the live nets.
        rows: the targets that were advanced in this frame.
        metrics: what was measured of them.
        history: what is remembered, but for the records.
        born: targets that start, or start again: state, record and metrics.
        gone: rows that ended.
        events: decisions and other events, in order.
    """

    engine: Engine
    net: Net
    rows: Rows
    metrics: RowMetrics
    history: TrackHistory
    born: dict[str, tuple[TargetState, TrackRecord]] = field(default_factory=dict)
    lines: list[FrameMetrics] = field(default_factory=list)
    gone: set[int] = field(default_factory=set)
    events: list[Event] = field(default_factory=list)

    @classmethod
    def of(cls, engine: Engine, outcome: Outcome) -> Self:
        """The table of an outcome whose targets were advanced as rows."""
        state, metrics = outcome.state, outcome.metrics
        assert isinstance(metrics, RowMetrics)
        return cls(engine, state.net, metrics.rows, metrics, state.history)

    def decide(self, *decisions: Decision) -> None:
        """Write decisions down and carry them out."""
        self.net = apply_decisions(self.net, decisions)
        self.events += decisions

    def count(self, plates: Collection[str], frame: Frame) -> None:
        """One more frame for every live target of these plates."""
        # Imported here: a graph is validated without compiling anything.
        from bayesnet_track.numerics.kernels.judging_kernels import count_frames

        now = self.rows.columns
        counted = (now.since, now.lost_frames, now.unseen_frames)
        since, lost, unseen, known = count_frames(counted, now.is_lost, now.memory.counts[:, 0], frame.index)
        columns = now.changed(
            since=since,
            known_mean=np.where(known[:, None], now.mean, now.known_mean),
            known_covariance=np.where(known[:, None, None], now.covariance, now.known_covariance),
            known_time=np.where(known, frame.time, now.known_time),
            lost_frames=lost,
            unseen_frames=unseen,
        )
        self.rows = self.rows.with_columns(columns, self.rows.time)
        is_new = now.since < 0
        if is_new.any():  # the numbers of those that a table did not count before
            numbers = [int(target) for target in compress(self.rows.ids, is_new) if target.isdecimal()]
            self.history = changed(self.history, last_id=max([self.history.last_id, *numbers]))

    def state(self, target: str) -> TargetState:
        """What is known of a target."""
        return self.born[target][0] if target in self.born else self.rows.state(self.rows.index[target])

    def record(self, target: str) -> TrackRecord:
        """What is counted of a target."""
        return self.born[target][1] if target in self.born else self.rows.record(self.rows.index[target])

    def of_plate(self, plate: str) -> list[str]:
        """Its live targets, in the order of their births."""
        ids = self.rows.ids if plate == self.rows.rule.plate else ()
        if not self.gone and not self.born:
            return list(ids)
        left = [target for row, target in enumerate(ids) if row not in self.gone]
        own = [one for one in self.born if self.net.targets[one].template == plate]
        return [*left, *(one for one in own if one not in self.rows.index)]

    def held(self, plate: str) -> list[str]:
        """Its live targets that are not lost."""
        lost = {*compress(self.rows.ids, self.rows.columns.is_lost)} - self.born.keys()
        return [target for target in self.of_plate(plate) if target not in lost]

    def boxes(self, targets: Sequence[str]) -> Floats:
        """(K, 4) estimates of this frame."""
        if not self.lines:
            return self.metrics.boxes[self._rows_of(targets)].reshape(-1, 4)
        at: dict[str, Sequence[float]] = {line.target: line.centre_box for line in self.lines}
        index, own = self.rows.index, self.metrics.boxes
        found = [at[target] if target in at else own[index[target]] for target in targets]
        return np.array(found, dtype=np.float64).reshape(-1, 4)

    def _rows_of(self, targets: Sequence[str]) -> list[int] | slice:
        is_all = tuple(targets) == self.rows.ids
        return slice(None) if is_all else [self.rows.index[target] for target in targets]

    def beliefs(self, targets: Sequence[str]) -> tuple[Floats, Floats, Sequence[int]]:
        """(K, 4) means and (K, 4, 4) covariances of the boxes, and the frames of the births."""
        now = self.rows.columns
        own = [target for target in targets if target not in self.born]
        rows = self._rows_of(own)
        assert targets[: len(own)] == own, "those that start come last"
        since = now.since[rows].tolist()
        if len(own) == len(targets):
            return now.mean[rows, :4], now.covariance[rows, :4, :4], since
        new = [self.born[target] for target in targets[len(own) :]]
        means = [now.mean[rows, :4], np.array([one.belief.mean[:4] for one, _ in new]).reshape(-1, 4)]
        spreads = np.array([one.belief.covariance[:4, :4] for one, _ in new]).reshape(-1, 4, 4)
        since += (record.since for _, record in new)
        return np.concatenate(means), np.concatenate([now.covariance[rows][:, :4, :4], spreads]), since

    def mark_seen(self, targets: Iterable[str]) -> None:
        """Targets have a detection of their own."""
        unseen = self.rows.columns.unseen_frames.copy()
        unseen[[self.rows.index[target] for target in targets]] = 0
        self.rows = self.rows.with_columns(self.rows.columns.changed(unseen_frames=unseen), self.rows.time)

    def add(self, target: str, state: TargetState, record: TrackRecord, metrics: FrameMetrics) -> None:
        """A target starts."""
        self.lines.append(metrics)
        self.put_back(target, state, record)

    def put_back(self, target: str, state: TargetState, record: TrackRecord) -> None:
        """A target starts again."""
        self.born[target] = state, record

    def ending(self, plate: str, rule: Death) -> list[Ending]:
        """Targets whose time is over."""
        now = self.rows.columns
        is_over = now.lost_frames >= rule.lost_frames
        if rule.unseen_frames is not None:
            is_over |= now.unseen_frames >= rule.unseen_frames
        if plate != self.rows.rule.plate:
            return []
        over = [row for row in np.flatnonzero(is_over).tolist() if row not in self.gone]
        causes = {self.rows.ids[row]: find_end_cause(self.rows.record(row), rule) for row in over}
        return [(target, why) for target, why in causes.items() if why is not None]

    def vanishing(self, plate: str, end: float) -> list[tuple[str, float]]:
        """Targets that exist with a smaller probability than `end`, and that probability."""
        existence = self.rows.columns.existence
        if plate != self.rows.rule.plate:
            return []
        low = [row for row in np.flatnonzero(existence < end).tolist() if row not in self.gone]
        return [(self.rows.ids[row], float(existence[row])) for row in low]

    def end(self, decision: TargetDied | DuplicateEnded) -> None:
        """A target ends."""
        self.decide(decision)
        if self.born.pop(decision.target, None) is None:
            self.gone.add(self.rows.index[decision.target])

    def outcome(self, before: Outcome, frame: Frame) -> Outcome:
        """The outcome with all that was done here."""
        targets, records = self._left(frame)
        history = changed(self.history, records=records)
        state = changed(before.state, net=self.net, targets=targets, previous=frame, history=history)
        events = (*before.events, *self.events)
        return changed(before, state=state, metrics=self.metrics.with_born(self.lines), events=events)

    def _left(self, frame: Frame) -> tuple[Mapping[str, TargetState], Mapping[str, TrackRecord]]:
        """Who lives on: as rows where those that start fit, too."""
        rows = self.rows
        if self.gone:
            keep = np.ones(len(rows.ids), dtype=np.bool_)
            keep[list(self.gone)] = False
            ids = tuple(compress(rows.ids, keep.tolist()))
            rows = Rows(rows.rule, ids, rows.columns.take(keep), rows.time)
        if self.born:
            states = {target: state for target, (state, _) in self.born.items()}
            records = {target: record for target, (_, record) in self.born.items()}
            own = nets_fit(rows.rule, (self.net.targets[target] for target in states))
            if not own or not states_fit(rows.rule, states, frame.time) or states.keys() & rows.index.keys():
                return {**RowStates(rows), **states}, {**RowRecords(rows), **records}
            new = make_rows(rows.rule, states, records, [False] * len(states), frame.time)
            rows = Rows(rows.rule, (*rows.ids, *new.ids), rows.columns.extend(new.columns), frame.time)
        rows = rows.with_nets(self.net.targets)
        return RowStates(rows), RowRecords(rows)
