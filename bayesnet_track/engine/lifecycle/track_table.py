"""The live targets of a frame while births and deaths change them."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from bayesnet_track.adapt.lifecycle import TrackHistory, TrackRecord, find_end_cause
from bayesnet_track.adapt.memory import LOST
from bayesnet_track.engine.outcome import Outcome, State
from bayesnet_track.engine.state import TargetState
from bayesnet_track.graph.settings.lifecycle import Death
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.lives import DuplicateEnded, TargetDied
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.net.net import Decision, Net, apply_decisions
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.planes import Frame

Ending = tuple[str, tuple[str, int, int]]
"""A target and why it ends, as `adapt.lifecycle.find_end_cause` has it."""


class LiveTable(Protocol):
    """The targets while one frame changes them, one by one (`TrackTable`) or as rows (`RowTable`)."""

    net: Net
    history: TrackHistory
    events: list[Event]

    def decide(self, *decisions: Decision) -> None:
        """Write decisions down and carry them out."""

    def count(self, plates: Collection[str], frame: Frame) -> None:
        """One more frame for every live target of these plates."""

    def state(self, target: str) -> TargetState:
        """What is known of a target."""

    def record(self, target: str) -> TrackRecord:
        """What is counted of a target."""

    def of_plate(self, plate: str) -> list[str]:
        """Its live targets, in the order of their births."""

    def held(self, plate: str) -> list[str]:
        """Its live targets that are not lost."""

    def boxes(self, targets: Sequence[str]) -> Floats:
        """(K, 4) estimates of this frame."""

    def beliefs(self, targets: Sequence[str]) -> tuple[Floats, Floats, Sequence[int]]:
        """(K, 4) means and (K, 4, 4) covariances of the boxes, and the frames of the births."""

    def mark_seen(self, targets: Iterable[str]) -> None:
        """Targets have a detection of their own."""

    def add(self, target: str, state: TargetState, record: TrackRecord, metrics: FrameMetrics) -> None:
        """A target starts."""

    def put_back(self, target: str, state: TargetState, record: TrackRecord) -> None:
        """A target starts again."""

    def ending(self, plate: str, rule: Death) -> list[Ending]:
        """Targets whose time is over."""

    def vanishing(self, plate: str, end: float) -> list[tuple[str, float]]:
        """Targets that exist with a smaller probability than `end`, and that probability."""

    def end(self, decision: TargetDied | DuplicateEnded) -> None:
        """A target ends."""

    def outcome(self, before: Outcome, frame: Frame) -> Outcome:
        """The outcome with all that was done here."""


@dataclass(eq=False)
class TrackTable:
    """The targets, an object each.

    Attributes:
        net: the live nets.
        targets: live target -> its state.
        metrics: one entry per target that was live in this frame, the new ones included.
        history: what is remembered.
        events: decisions and other events, in order.
    """

    net: Net
    targets: dict[str, TargetState]
    metrics: list[FrameMetrics]
    history: TrackHistory
    events: list[Event] = field(default_factory=list)

    def decide(self, *decisions: Decision) -> None:
        """Write decisions down and carry them out."""
        self.net = apply_decisions(self.net, decisions)
        self.events += decisions

    def count(self, plates: Collection[str], frame: Frame) -> None:
        """One more frame for every live target of these plates."""
        records = {}
        for target, state in self.targets.items():
            if self.net.targets[target].template not in plates:
                continue
            lost = self.net.targets[target].status == "lost"
            record = self.history.records.get(target)
            if record is None or not (lost or state.memory.count(LOST)):
                since = frame.index if record is None else record.since
                unseen = 0 if record is None else record.unseen_frames
                record = TrackRecord(since, state.belief.mean, state.belief.covariance, frame.time, 0, unseen)
            records[target] = replace(
                record,
                lost_frames=record.lost_frames + 1 if lost else 0,
                unseen_frames=record.unseen_frames + 1,
            )
        numbers = [int(target) for target in self.targets if target.isdecimal()]
        self.history = replace(self.history, records=records, last_id=max([self.history.last_id, *numbers]))

    def state(self, target: str) -> TargetState:
        """What is known of a target."""
        return self.targets[target]

    def record(self, target: str) -> TrackRecord:
        """What is counted of a target."""
        return self.history.records[target]

    def of_plate(self, plate: str) -> list[str]:
        """Its live targets, in the order of their births."""
        return [target for target in self.targets if self.net.targets[target].template == plate]

    def held(self, plate: str) -> list[str]:
        """Its live targets that are not lost."""
        return [target for target in self.of_plate(plate) if self.net.targets[target].status != "lost"]

    def boxes(self, targets: Sequence[str]) -> Floats:
        """(K, 4) estimates of this frame."""
        at = {line.target: line.centre_box for line in self.metrics}
        return np.array([at[target] for target in targets], dtype=np.float64).reshape(-1, 4)

    def beliefs(self, targets: Sequence[str]) -> tuple[Floats, Floats, Sequence[int]]:
        """(K, 4) means and (K, 4, 4) covariances of the boxes, and the frames of the births."""
        beliefs = [self.targets[target].belief for target in targets]
        return (
            np.array([one.mean[:4] for one in beliefs]).reshape(-1, 4),
            np.array([one.covariance[:4, :4] for one in beliefs]).reshape(-1, 4, 4),
            [self.history.records[target].since for target in targets],
        )

    def mark_seen(self, targets: Iterable[str]) -> None:
        """Targets have a detection of their own."""
        seen = {target: replace(self.history.records[target], unseen_frames=0) for target in targets}
        self._keep({**self.history.records, **seen})

    def add(self, target: str, state: TargetState, record: TrackRecord, metrics: FrameMetrics) -> None:
        """A target starts."""
        self.metrics.append(metrics)
        self.put_back(target, state, record)

    def put_back(self, target: str, state: TargetState, record: TrackRecord) -> None:
        """A target starts again."""
        self.targets[target] = state
        self._keep({**self.history.records, target: record})

    def ending(self, plate: str, rule: Death) -> list[Ending]:
        """Targets whose time is over."""
        causes = {
            target: find_end_cause(self.history.records[target], rule) for target in self.of_plate(plate)
        }
        return [(target, why) for target, why in causes.items() if why is not None]

    def vanishing(self, plate: str, end: float) -> list[tuple[str, float]]:
        """Targets that exist with a smaller probability than `end`, and that probability."""
        own = ((target, self.targets[target].existence) for target in self.of_plate(plate))
        return [(target, value) for target, value in own if value is not None and value < end]

    def end(self, decision: TargetDied | DuplicateEnded) -> None:
        """A target ends."""
        self.decide(decision)
        del self.targets[decision.target]
        records = self.history.records.items()
        self._keep({target: record for target, record in records if target in self.targets})

    def outcome(self, before: Outcome, frame: Frame) -> Outcome:
        """The outcome with all that was done here."""
        state = replace(
            before.state, net=self.net, targets=self.targets, previous=frame, history=self.history
        )
        events = (*before.events, *self.events)
        return replace(before, state=state, metrics=tuple(self.metrics), events=events)

    def _keep(self, records: Mapping[str, TrackRecord]) -> None:
        self.history = replace(self.history, records=records)


def table_of(outcome: Outcome) -> TrackTable:
    """The table of targets that are an object each."""
    state: State = outcome.state
    return TrackTable(state.net, dict(state.targets), list(outcome.metrics), state.history)
