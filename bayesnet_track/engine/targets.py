"""Live targets: columns of tables for those that are alike, an object each for the others."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from bayesnet_track.adapt.lifecycle import TrackRecord
from bayesnet_track.engine.rows.columns import Rows
from bayesnet_track.engine.rows.particle_table import ParticleTable
from bayesnet_track.engine.state import TargetState
from bayesnet_track.journal.target_net import TargetNet


class Targets(Mapping[str, TargetState]):
    """Target -> its state, made when it is first asked for where it is a row of a table.

    Args:
        gaussians: tables of Gaussian beliefs, one a plate; their targets come first.
        particles: tables of particles.
        others: target -> its state.
        order: the targets that are no row of `gaussians`; by default the particles', then the others.
    """

    def __init__(
        self,
        gaussians: Sequence[Rows] = (),
        particles: Sequence[ParticleTable] = (),
        others: Mapping[str, TargetState] | None = None,
        order: Sequence[str] | None = None,
    ) -> None:
        self.gaussians, self.particles = tuple(gaussians), tuple(particles)
        self.others = {} if others is None else others
        if order is None:
            order = (*(target for table in self.particles for target in table.ids), *self.others)
        self.order = order
        self._made: dict[str, TargetState] = {}

    @classmethod
    def of(cls, targets: Mapping[str, TargetState]) -> Targets:
        """Any mapping as targets."""
        return targets if isinstance(targets, Targets) else cls(others=targets)

    def __getitem__(self, target: str) -> TargetState:
        if target in self.others:
            return self.others[target]
        if target not in self._made:
            tables: tuple[Rows | ParticleTable, ...] = (*self.gaussians, *self.particles)
            table = next((one for one in tables if target in one.index), None)
            if table is None:
                raise KeyError(target)
            self._made[target] = table.state(table.index[target])
        return self._made[target]

    def __contains__(self, target: object) -> bool:
        tables: tuple[Rows | ParticleTable, ...] = (*self.gaussians, *self.particles)
        return target in self.others or any(target in one.index for one in tables)

    def __iter__(self) -> Iterator[str]:
        for rows in self.gaussians:
            yield from rows.ids
        yield from self.order

    def __len__(self) -> int:
        return sum(len(rows.ids) for rows in self.gaussians) + len(self.order)

    def __reduce__(self) -> tuple[Any, ...]:
        return dict, (dict(self),)

    def apart(self) -> dict[str, TargetState]:
        """The targets that are no row of Gaussians, an object each."""
        return {target: self[target] for target in self.order} if self.order else {}

    def unchanged(self, nets: Mapping[str, TargetNet]) -> Targets:
        """The same, targets held by particles whose live nets have changed as objects."""
        tables: list[ParticleTable] = []
        others = dict(self.others)
        for table in self.particles:
            known = [nets[target] is one for target, one in zip(table.ids, table.nets, strict=True)]
            if not all(known):
                changed_rows = [row for row, is_so in enumerate(known) if not is_so]
                others.update((table.ids[row], table.state(row)) for row in changed_rows)
                table = table.take([row for row, is_so in enumerate(known) if is_so])
            if table.ids:
                tables.append(table)
        return Targets(self.gaussians, tables, others, self.order)


class Records(Mapping[str, TrackRecord]):
    """Target -> what is counted of it, of the rows of tables and of others.

    Args:
        gaussians: the tables.
        others: target -> its record.
    """

    def __init__(self, gaussians: Sequence[Rows], others: Mapping[str, TrackRecord]) -> None:
        self.gaussians, self.others = tuple(gaussians), others
        self._made: dict[str, TrackRecord] = {}

    def __getitem__(self, target: str) -> TrackRecord:
        if target in self.others:
            return self.others[target]
        if target not in self._made:
            rows = next((one for one in self.gaussians if target in one.index), None)
            if rows is None or rows.columns.since[rows.index[target]] < 0:
                raise KeyError(target)
            self._made[target] = rows.record(rows.index[target])
        return self._made[target]

    def __iter__(self) -> Iterator[str]:
        for rows in self.gaussians:
            known = (rows.columns.since >= 0).tolist()
            yield from (target for target, is_known in zip(rows.ids, known, strict=True) if is_known)
        yield from self.others

    def __len__(self) -> int:
        return len(self.others) + sum(int(np.count_nonzero(one.columns.since >= 0)) for one in self.gaussians)

    def __reduce__(self) -> tuple[Any, ...]:
        return dict, (dict(self),)
