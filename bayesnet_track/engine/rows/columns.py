"""Targets with a Gaussian belief as rows of a table; the state and the record of one are made on request."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import compress
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.adapt.association import first_observed, remembered
from bayesnet_track.adapt.lifecycle import TrackRecord
from bayesnet_track.adapt.memory import RuleMemory
from bayesnet_track.belief.gaussian.belief import GaussianPosterior
from bayesnet_track.engine.rows.fitting import RowRule
from bayesnet_track.engine.state import TargetState
from bayesnet_track.numerics.arrays import Bools, Floats, Ints
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import OBSERVED, OWN_DETECTION, Reference
from bayesnet_track.observation.likelihoods import ReferenceRows

NEVER_ASKED, GIVEN_NONE, GIVEN = 0, 1, 2
"""What a row's agent was given of its last frame's detections."""


@dataclass(frozen=True, eq=False)
class Columns:
    """States of T targets between frames: what `TargetState` and `TrackRecord` hold of one.

    Attributes:
        mean: (T, D) of the belief.
        covariance: (T, D, D).
        size: (T,) hypotheses.
        own: (T, 5) the detection that it was given: centre box and score.
        observed: (T, H) what is remembered of its detections (`adapt.association`).
        given: (T,) whether there was one: `NEVER_ASKED`, `GIVEN_NONE` or `GIVEN`.
        memory: what the rules remember.
        is_lost: (T,) whether the status is lost.
        since: (T,) frame of birth; -1 where nothing is counted of a target yet.
        known_mean: (T, D) the belief when it was last well seen.
        known_covariance: (T, D, D).
        known_time: (T,) that time, frame intervals.
        lost_frames: (T,) consecutive frames in which it is lost.
        unseen_frames: (T,) consecutive frames without a detection of its own.
        existence: (T,) probability that it exists; 1 where the plate has no `existence`.
        started: (T,) number of the frame in which it started.
    """

    mean: Floats
    covariance: Floats
    size: Ints
    own: Floats
    observed: Floats
    given: Ints
    memory: RuleMemory
    is_lost: Bools
    since: Ints
    known_mean: Floats
    known_covariance: Floats
    known_time: Floats
    lost_frames: Ints
    unseen_frames: Ints
    existence: Floats
    started: Ints

    def changed(self, **columns: NDArray[Any] | RuleMemory) -> Self:
        """With some columns in place of its own; `dataclasses.replace` takes ten times as long."""
        copy = object.__new__(type(self))
        copy.__dict__.update(self.__dict__)
        copy.__dict__.update(columns)
        return copy

    def take(self, rows: NDArray[Any]) -> Self:
        """Some rows."""
        arrays = {name: getattr(self, name)[rows] for name in _ARRAYS}
        return type(self)(**arrays, memory=self.memory.take(rows))

    def extend(self, added: Self) -> Self:
        """These rows, then others."""
        arrays = {name: np.concatenate([getattr(self, name), getattr(added, name)]) for name in _ARRAYS}
        return type(self)(**arrays, memory=RuleMemory.join([self.memory, added.memory]))


_ARRAYS = tuple(one.name for one in fields(Columns) if one.name != "memory")


@dataclass(frozen=True, eq=False)
class Rows:
    """The live targets of a plate.

    Attributes:
        rule: what they have in common.
        ids: target ids, in the order of their births.
        columns: what is known of them.
        references: agent -> what it remembers of each, but for detections.
        time: time of the last frame, frame intervals.
        checked: the live nets as they were when they were last found to fit.
    """

    rule: RowRule
    ids: tuple[str, ...]
    columns: Columns
    references: Mapping[str, Sequence[Reference]]
    time: float
    checked: Mapping[str, Any] | None = None

    @cached_property
    def index(self) -> Mapping[str, int]:
        """Target -> its row."""
        return {target: row for row, target in enumerate(self.ids)}

    def changed(self, **fields: Any) -> Rows:
        """The same targets, later."""
        copy = object.__new__(Rows)
        copy.__dict__.update(self.__dict__)  # with the index
        copy.__dict__.update(fields)
        return copy

    def take(self, keep: Bools) -> Rows:
        """The targets for which (T,) `keep` is true."""
        rows = np.flatnonzero(keep)
        references = {
            agent: ReferenceRows.some(reference, rows) for agent, reference in self.references.items()
        }
        ids = tuple(compress(self.ids, keep.tolist()))
        return evolve(self, ids=ids, columns=self.columns.take(keep), references=references)

    def extended(self, added: Rows) -> Rows:
        """These targets, then others of the same time."""
        columns, extra = self.columns.extend(added.columns), added.references
        references = {
            agent: ReferenceRows.joined(reference, extra[agent])
            for agent, reference in self.references.items()
        }
        return Rows(self.rule, (*self.ids, *added.ids), columns, references, self.time)

    def counted(self, frame: int, time: float, looked: bool) -> Rows:
        """The rows with one more frame counted of each; in one that nobody `looked` at none is unseen."""
        # Imported here: a graph is validated without compiling anything.
        from bayesnet_track.numerics.kernels.judging_kernels import count_frames

        current = self.columns
        counted = (current.since, current.lost_frames, current.unseen_frames)
        lost_count = np.ascontiguousarray(current.memory.counts[:, 0])  # one compiled version only
        first_frames, lost, unseen, is_counted = count_frames(counted, current.is_lost, lost_count, frame)
        columns = current.changed(
            since=first_frames,
            known_mean=np.where(is_counted[:, None], current.mean, current.known_mean),
            known_covariance=np.where(
                is_counted[:, None, None], current.covariance, current.known_covariance
            ),
            known_time=np.where(is_counted, time, current.known_time),
            lost_frames=lost,
            unseen_frames=unseen
            if looked
            else np.where(current.since < 0, unseen - 1, current.unseen_frames),
        )
        return self.changed(columns=columns)

    def state(self, row: int) -> TargetState:
        """The state of one target."""
        columns, rule = self.columns, self.rule
        belief = GaussianPosterior(
            columns.mean[row], columns.covariance[row], rule.motion.fields, int(columns.size[row])
        )
        existence = None if rule.crowd is None else float(columns.existence[row])
        return TargetState(
            belief,
            self.remembered(row),
            columns.memory.take([row]),
            rule.plan,
            self.time,
            existence=existence,
            started=int(columns.started[row]),
        )

    def remembered(self, row: int) -> Mapping[str, Reference]:
        """The agents' references to one target."""
        columns = self.columns
        detections: dict[str, Floats] = {}
        if columns.given[row] != NEVER_ASKED:
            detections[OWN_DETECTION] = (
                columns.own[row : row + 1] if columns.given[row] == GIVEN else np.empty((0, 5))
            )
        if columns.observed.shape[1]:
            detections[OBSERVED] = columns.observed[row]
        return {
            self.rule.agent: detections,
            **{agent: reference[row] for agent, reference in self.references.items()},
        }

    def record(self, row: int) -> TrackRecord:
        """The counts of one target."""
        columns = self.columns
        return TrackRecord(
            int(columns.since[row]),
            columns.known_mean[row],
            columns.known_covariance[row],
            float(columns.known_time[row]),
            int(columns.lost_frames[row]),
            int(columns.unseen_frames[row]),
        )


def make_rows(
    rule: RowRule,
    states: Mapping[str, TargetState],
    records: Mapping[str, TrackRecord],
    lost: Sequence[bool],
    time: float,
) -> Rows:
    """The table of targets that fit (`fitting.states_fit`)."""
    targets = list(states.values())
    width = len(rule.motion.fields)
    detections = [state.references.get(rule.agent, {}).get(OWN_DETECTION) for state in targets]
    unknown = TrackRecord(-1, np.zeros(width), np.zeros((width, width)), time)
    counted = [records.get(target, unknown) for target in states]
    answers = [
        NEVER_ASKED if detection is None else GIVEN if len(detection) else GIVEN_NONE
        for detection in detections
    ]
    columns = Columns(
        mean=_stack([state.belief.mean for state in targets], width),
        covariance=_stack([state.belief.covariance for state in targets], width, width),
        size=np.array([len(state.belief) for state in targets], dtype=np.int64),
        own=_stack(
            [
                detection[0, :5] if detection is not None and len(detection) else np.zeros(5)
                for detection in detections
            ],
            5,
        ),
        observed=_stack([observed_of(rule, state) for state in targets], observed_width(rule)),
        given=np.array(answers, dtype=np.int64),
        memory=RuleMemory.join([state.memory for state in targets]),
        is_lost=np.array(lost, dtype=np.bool_),
        since=np.array([record.since for record in counted], dtype=np.int64),
        known_mean=_stack([record.mean for record in counted], width),
        known_covariance=_stack([record.covariance for record in counted], width, width),
        known_time=np.array([record.time for record in counted], dtype=np.float64),
        lost_frames=np.array([record.lost_frames for record in counted], dtype=np.int64),
        unseen_frames=np.array([record.unseen_frames for record in counted], dtype=np.int64),
        existence=np.array([1.0 if state.existence is None else state.existence for state in targets]),
        started=np.array([state.started for state in targets], dtype=np.int64),
    )
    references = {
        agent: ReferenceRows.of([state.references[agent] for state in targets]) for agent in rule.others
    }
    return Rows(rule, tuple(states), columns, references, time)


def observed_of(rule: RowRule, state: TargetState) -> Floats:
    """(H,) what is remembered of a target's detections; of one that had none yet, its box."""
    return remembered(rule.association, state.references.get(rule.agent, {}), state.belief.mean)


def observed_width(rule: RowRule) -> int:
    """H."""
    return int(first_observed(rule.association, np.empty((0, 4)), len(rule.motion.fields)).shape[1])


def _stack(arrays: Sequence[Floats], *shape: int) -> Floats:
    """(T, *shape) arrays as one, also when there are none."""
    return np.array(arrays, dtype=np.float64).reshape(len(arrays), *shape)
