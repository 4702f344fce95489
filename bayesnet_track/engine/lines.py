"""The lines of metrics of a frame, made when somebody asks for them; boxes and statuses are known before."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from itertools import compress
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol, overload

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.journal.frame_columns import identity_column, per_node
from bayesnet_track.journal.metrics import Answers, FrameMetrics, numbers_of
from bayesnet_track.numerics.arrays import Bools, Floats
from bayesnet_track.numerics.records import evolve

Identities = Mapping[str, Mapping[str, float]]
NO_DOUBT: Identities = MappingProxyType({})


class LineGroup(Protocol):
    """Targets that were finished together."""

    @property
    def ids(self) -> Sequence[str]:
        """The targets."""

    @property
    def boxes(self) -> Floats:
        """(T, 4) estimates, centre boxes in px."""

    @property
    def is_lost(self) -> Bools:
        """(T,) whether the status was lost in the frame."""

    @property
    def holds_frame(self) -> bool:
        """True where the frame and its planes are held."""

    def lines(self, hypotheses: bool) -> Sequence[FrameMetrics]:
        """Their lines; without `hypotheses` those may be left out."""

    def columns(self) -> Mapping[str, NDArray[Any]] | None:
        """The columns of `journal.frame_columns` without hypotheses; None where lines have to be made."""


class FrameBoxes(NamedTuple):
    """Boxes and statuses of the targets of a frame.

    Attributes:
        ids: T targets.
        boxes: (T, 4) centre boxes, px.
        is_lost: (T,) whether the status was lost.
    """

    ids: Sequence[str]
    boxes: Floats
    is_lost: Bools


class Lines(Sequence[FrameMetrics]):
    """The lines of one frame.

    Args:
        groups: of targets that were finished together.
        order: their targets, in the order of their lines.
        born: lines that are made already, such as those of targets that start.
        answers: answers to queries, for the lines of all groups.
        identities: target that may be another one -> identity -> its probability.

    >>> lines = Lines(born=("first", "second"))
    >>> len(lines), lines[1], lines == ("first", "second")
    (2, 'second', True)
    """

    def __init__(
        self,
        groups: Sequence[LineGroup] = (),
        order: Sequence[str] = (),
        born: Sequence[FrameMetrics] = (),
        answers: Sequence[Answers] = (),
        identities: Identities = NO_DOUBT,
    ) -> None:
        self._groups, self._order, self.born, self.answers = groups, order, tuple(born), answers
        self.identities = identities
        self._made: tuple[FrameMetrics, ...] | None = None

    @classmethod
    def of(cls, lines: Sequence[FrameMetrics]) -> Lines:
        """Any lines as these."""
        return lines if isinstance(lines, Lines) else cls(born=lines)

    def with_born(self, born: Sequence[FrameMetrics]) -> Lines:
        """These, and targets that start."""
        if not born:
            return self
        groups = self._groups  # read before `_made`: another thread may make them
        if self._made is not None:
            return Lines(born=(*self._made, *born))
        return Lines(groups, self._order, (*self.born, *born), self.answers, self.identities)

    def with_answers(self, answers: Sequence[Answers]) -> Lines:
        """These, with answers to queries."""
        groups = self._groups
        if self._made is not None:
            return Lines(born=_answered(self._made, answers))
        return Lines(groups, self._order, _answered(self.born, answers), answers, self.identities)

    def with_identities(self, identities: Identities) -> Lines:
        """These, with who may be whom."""
        groups = self._groups
        if self._made is not None:
            return Lines(born=_identified(self._made, identities))
        born = _identified(self.born, identities)
        return Lines(groups, self._order, born, self.answers, identities)

    @property
    def ids(self) -> Sequence[str]:
        """The target of each."""
        return (*self._order, *(line.target for line in self.born)) if self.born else self._order

    @cached_property
    def places(self) -> FrameBoxes:
        """Boxes and statuses of the targets; makes no lines."""
        groups, ids = self._groups, self.ids
        born = self.born if self._made is None else self._made
        parts = (
            []
            if self._made is not None
            else [FrameBoxes(group.ids, group.boxes, group.is_lost) for group in groups]
        )
        if born:
            boxes = np.array([line.centre_box for line in born])
            lost = np.array([line.is_gone for line in born])
            parts.append(FrameBoxes([line.target for line in born], boxes, lost))
        if len(parts) == 1:
            (places,) = parts
        elif not parts:
            places = FrameBoxes((), np.empty((0, 4)), np.empty(0, dtype=np.bool_))
        else:
            places = FrameBoxes(
                [target for part in parts for target in part.ids],
                np.concatenate([part.boxes for part in parts]),
                np.concatenate([part.is_lost for part in parts]),
            )
        if places.ids is ids or tuple(places.ids) == tuple(ids):
            return places
        index = dict(zip(places.ids, range(len(places.ids)), strict=True))
        rows = [index[target] for target in ids]
        return FrameBoxes(ids, places.boxes[rows], places.is_lost[rows])

    def boxes_of(self, targets: Sequence[str]) -> Floats:
        """(K, 4) centre boxes of some targets, px."""
        ids, boxes, _ = self.places
        if tuple(targets) == tuple(ids):
            return boxes
        index = dict(zip(ids, range(len(ids)), strict=True))
        return boxes[[index[target] for target in targets]].reshape(-1, 4)

    def held(self) -> tuple[list[str], Floats]:
        """Ids and (K, 4) centre boxes, px, of the targets that are not lost."""
        ids, boxes, is_lost = self.places
        return [*compress(ids, (~is_lost).tolist())], boxes[~is_lost]

    def columns(self) -> Mapping[str, NDArray[Any]] | None:
        """The columns of `journal.frame_columns` without hypotheses; None where lines have to be made."""
        groups = self._groups
        columns = groups[0].columns() if len(groups) == 1 and not self.born else None
        if columns is None or not (self.answers or self.identities):
            return columns
        answers = [numbers_of(self.answers, target) for target in self._order] if self.answers else []
        doubts = [self.identities.get(target, {}) for target in self._order]
        return {**columns, **per_node("queries", answers), **identity_column(doubts)}

    def without_hypotheses(self) -> Sequence[FrameMetrics]:
        """The lines, maybe without their hypotheses, which may take most of the time."""
        groups = self._groups
        return self._make(groups, hypotheses=False) if self._made is None else self._made

    def settled(self) -> Lines:
        """The same, without the frame and its planes: lines that need them are made."""
        if any(group.holds_frame for group in self._groups):
            self._lines()
        return self

    def _lines(self) -> tuple[FrameMetrics, ...]:
        groups = self._groups
        if self._made is None:
            self._made = self._make(groups, hypotheses=True)
            self._groups = ()  # what they were made of is not needed any more
        return self._made

    def _make(self, groups: Sequence[LineGroup], hypotheses: bool) -> tuple[FrameMetrics, ...]:
        lines = [line for group in groups for line in group.lines(hypotheses)]
        if [line.target for line in lines] != [*self._order]:
            by_target = {line.target: line for line in lines}
            lines = [by_target[target] for target in self._order]
        return (*_identified(_answered(lines, self.answers), self.identities), *self.born)

    @overload
    def __getitem__(self, index: int) -> FrameMetrics: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[FrameMetrics, ...]: ...

    def __getitem__(self, index: int | slice) -> FrameMetrics | tuple[FrameMetrics, ...]:
        return self._lines()[index]

    def __iter__(self) -> Iterator[FrameMetrics]:
        return iter(self._lines())

    def __len__(self) -> int:
        return len(self._order) + len(self.born)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and self._lines() == tuple(other)

    def __hash__(self) -> int:
        return hash(self._lines())

    def __reduce__(self) -> tuple[type[tuple[FrameMetrics, ...]], tuple[tuple[FrameMetrics, ...]]]:
        return tuple, (self._lines(),)


def _identified(lines: Sequence[FrameMetrics], identities: Identities) -> Sequence[FrameMetrics]:
    if not identities:
        return lines
    return [
        evolve(line, identities=identities[line.target]) if line.target in identities else line
        for line in lines
    ]


def _answered(lines: Sequence[FrameMetrics], answers: Sequence[Answers]) -> Sequence[FrameMetrics]:
    if not answers:
        return lines
    return [evolve(line, queries=numbers_of(answers, line.target)) for line in lines]
