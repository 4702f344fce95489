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
    """What is known of T targets between frames: what `TargetState` and `TrackRecord` hold of one.

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
        after = object.__new__(type(self))
        after.__dict__.update(self.__dict__)
        after.__dict__.update(columns)
        return after

    def take(self, rows: NDArray[Any]) -> Self:
        """Some rows."""
        arrays = {name: getattr(self, name)[rows] for name in _ARRAYS}
        return type(self)(**arrays, memory=self.memory.take(rows))

    def extend(self, others: Self) -> Self:
        """These rows, then others."""
        arrays = {name: np.concatenate([getattr(self, name), getattr(others, name)]) for name in _ARRAYS}
        return type(self)(**arrays, memory=RuleMemory.join([self.memory, others.memory]))


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
        after = object.__new__(Rows)
        after.__dict__.update(self.__dict__)  # with the index
        after.__dict__.update(fields)
        return after

    def take(self, keep: Bools) -> Rows:
        """The targets for which (T,) `keep` is true."""
        rows = np.flatnonzero(keep)
        references = {agent: ReferenceRows.some(of, rows) for agent, of in self.references.items()}
        ids = tuple(compress(self.ids, keep.tolist()))
        return evolve(self, ids=ids, columns=self.columns.take(keep), references=references)

    def extended(self, others: Rows) -> Rows:
        """These targets, then others of the same time."""
        columns, more = self.columns.extend(others.columns), others.references
        references = {agent: ReferenceRows.joined(of, more[agent]) for agent, of in self.references.items()}
        return Rows(self.rule, (*self.ids, *others.ids), columns, references, self.time)

    def counted(self, frame: int, time: float, looked: bool) -> Rows:
        """The rows with one more frame counted of each; in one that nobody `looked` at none is unseen."""
        # Imported here: a graph is validated without compiling anything.
        from bayesnet_track.numerics.kernels.judging_kernels import count_frames

        now = self.columns
        counted = (now.since, now.lost_frames, now.unseen_frames)
        lost_count = np.ascontiguousarray(now.memory.counts[:, 0])  # one compiled version only
        since, lost, unseen, known = count_frames(counted, now.is_lost, lost_count, frame)
        columns = now.changed(
            since=since,
            known_mean=np.where(known[:, None], now.mean, now.known_mean),
            known_covariance=np.where(known[:, None, None], now.covariance, now.known_covariance),
            known_time=np.where(known, time, now.known_time),
            lost_frames=lost,
            unseen_frames=unseen if looked else np.where(now.since < 0, unseen - 1, now.unseen_frames),
        )
        return self.changed(columns=columns)

    def state(self, row: int) -> TargetState:
        """What is known of one target."""
        now, rule = self.columns, self.rule
        belief = GaussianPosterior(now.mean[row], now.covariance[row], rule.motion.fields, int(now.size[row]))
        existence = None if rule.crowd is None else float(now.existence[row])
        return TargetState(
            belief,
            self.remembered(row),
            now.memory.take([row]),
            rule.plan,
            self.time,
            existence=existence,
            started=int(now.started[row]),
        )

    def remembered(self, row: int) -> Mapping[str, Reference]:
        """What the agents remember of one target."""
        now = self.columns
        own: dict[str, Floats] = {}
        if now.given[row] != NEVER_ASKED:
            own[OWN_DETECTION] = now.own[row : row + 1] if now.given[row] == GIVEN else np.empty((0, 5))
        if now.observed.shape[1]:
            own[OBSERVED] = now.observed[row]
        return {self.rule.agent: own, **{agent: of[row] for agent, of in self.references.items()}}

    def record(self, row: int) -> TrackRecord:
        """What is counted of one target."""
        now = self.columns
        return TrackRecord(
            int(now.since[row]),
            now.known_mean[row],
            now.known_covariance[row],
            float(now.known_time[row]),
            int(now.lost_frames[row]),
            int(now.unseen_frames[row]),
        )


def make_rows(
    rule: RowRule,
    states: Mapping[str, TargetState],
    records: Mapping[str, TrackRecord],
    lost: Sequence[bool],
    time: float,
) -> Rows:
    """The table of targets that fit (`fitting.states_fit`)."""
    several = list(states.values())
    width = len(rule.motion.fields)
    own = [state.references.get(rule.agent, {}).get(OWN_DETECTION) for state in several]
    unknown = TrackRecord(-1, np.zeros(width), np.zeros((width, width)), time)
    known = [records.get(target, unknown) for target in states]
    given = [NEVER_ASKED if one is None else GIVEN if len(one) else GIVEN_NONE for one in own]
    columns = Columns(
        mean=_stack([state.belief.mean for state in several], width),
        covariance=_stack([state.belief.covariance for state in several], width, width),
        size=np.array([len(state.belief) for state in several], dtype=np.int64),
        own=_stack([one[0, :5] if one is not None and len(one) else np.zeros(5) for one in own], 5),
        observed=_stack([observed_of(rule, state) for state in several], observed_width(rule)),
        given=np.array(given, dtype=np.int64),
        memory=RuleMemory.join([state.memory for state in several]),
        is_lost=np.array(lost, dtype=np.bool_),
        since=np.array([one.since for one in known], dtype=np.int64),
        known_mean=_stack([one.mean for one in known], width),
        known_covariance=_stack([one.covariance for one in known], width, width),
        known_time=np.array([one.time for one in known], dtype=np.float64),
        lost_frames=np.array([one.lost_frames for one in known], dtype=np.int64),
        unseen_frames=np.array([one.unseen_frames for one in known], dtype=np.int64),
        existence=np.array([1.0 if one.existence is None else one.existence for one in several]),
        started=np.array([one.started for one in several], dtype=np.int64),
    )
    references = {
        agent: ReferenceRows.of([one.references[agent] for one in several]) for agent in rule.others
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
