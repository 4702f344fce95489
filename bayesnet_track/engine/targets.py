"""Live targets: rows of tables, those held by particles here, and others, an object each."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from bayesnet_track.adapt.lifecycle import TrackRecord
from bayesnet_track.adapt.memory import RuleMemory
from bayesnet_track.belief.particles.particle_set import Clouds, ParticleSet
from bayesnet_track.engine.attachment import particles
from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.rows.columns import Rows
from bayesnet_track.engine.state import TargetState
from bayesnet_track.inference.compile import Plan
from bayesnet_track.journal.target_net import TargetNet
from bayesnet_track.numerics.arrays import Ints
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import Reference
from bayesnet_track.observation.likelihoods import ReferenceRows

_NOBODY = ParticleSet(np.zeros((1, 0)), (), LogWeights.uniform(1))
"""In the place of the belief of a target whose particles are a row."""


@dataclass(frozen=True, eq=False)
class ParticleTable:
    """States of targets with the same plan and as many particles each.

    The first rows are columns of all that changes; of the others `base` has the rules' memory.

    Attributes:
        compiled: their plate.
        plan: the compiled net that all have.
        ids: target ids.
        base: their states when they were last objects; of each, what no column holds is still so.
        time: time of the last frame, frame intervals.
        clouds: their beliefs.
        references: agent -> what it remembers of each.
        memories: what the rules remember of the first rows; None where there are none.
        nets: the live nets of these rows, as they were when they were found to fit.
    """

    compiled: CompiledPlate
    plan: Plan
    ids: tuple[str, ...]
    base: tuple[TargetState, ...]
    time: float
    clouds: Clouds
    references: Mapping[str, Sequence[Reference]]
    memories: RuleMemory | None = None
    nets: tuple[TargetNet, ...] = ()
    _made: dict[int, TargetState] = field(default_factory=dict)

    @classmethod
    def of(cls, compiled: CompiledPlate, states: Mapping[str, TargetState]) -> ParticleTable:
        """The table of states with the same agents, time and number of particles."""
        base = tuple(states.values())
        shared = [agent for agent in compiled.cues if all(agent in state.references for state in base)]
        references = {
            agent: ReferenceRows.of([state.references[agent] for state in base]) for agent in shared
        }
        clouds = Clouds.of([particles(state.belief) for state in base])
        return cls(compiled, base[0].plan, tuple(states), base, base[0].time, clouds, references)

    @cached_property
    def index(self) -> Mapping[str, int]:
        """Target -> its row."""
        return {target: row for row, target in enumerate(self.ids)}

    def state(self, row: int) -> TargetState:
        """The state of one target."""
        if self.memories is None or row >= len(self.nets):
            return self.base[row]
        if row not in self._made:
            self._made[row] = evolve(
                self.base[row],
                belief=self.clouds.belief(row),
                references={agent: rows[row] for agent, rows in self.references.items()},
                memory=self.memories.take([row]),
                time=self.time,
            )
        return self._made[row]

    def remembered(self, agent: str, rows: Ints | None = None) -> Sequence[Reference]:
        """References of an agent to each, or to some."""
        references = self.references[agent]
        return references if rows is None else ReferenceRows.some(references, rows)

    def columns(self) -> RuleMemory:
        """The rules' memory of all."""
        if self.memories is not None and len(self.nets) == len(self.base):
            return self.memories
        memories = [state.memory for state in self.base[len(self.nets) :]]
        return RuleMemory.join(memories if self.memories is None else [self.memories, *memories])

    def then(
        self,
        time: float,
        clouds: Clouds,
        references: Mapping[str, Sequence[Reference]],
        memories: RuleMemory,
        nets: Mapping[str, TargetNet],
    ) -> ParticleTable:
        """The same targets after a frame, all as columns."""
        live = tuple(nets[target] for target in self.ids)
        base = tuple(
            state if state.belief is _NOBODY else evolve(state, belief=_NOBODY, references={})
            for state in self.base
        )  # else a row of an old frame keeps the arrays of all
        table = ParticleTable(
            self.compiled, self.plan, self.ids, base, time, clouds, references, memories, live
        )
        table.__dict__["index"] = self.index
        return table

    def take(self, rows: Sequence[int]) -> ParticleTable:
        """Some of the targets, in their order."""
        picks, live_rows = np.array(rows, dtype=np.intp), [row for row in rows if row < len(self.nets)]
        return ParticleTable(
            self.compiled,
            self.plan,
            tuple(self.ids[row] for row in rows),
            tuple(self.base[row] for row in rows),
            self.time,
            self.clouds.take(rows),
            {agent: self.remembered(agent, picks) for agent in self.references},
            self.memories.take(live_rows) if self.memories is not None and live_rows else None,
            tuple(self.nets[row] for row in live_rows),
        )

    def extended(self, added: ParticleTable) -> ParticleTable:
        """These targets, then others that are no columns."""
        return replace(
            self,
            ids=self.ids + added.ids,
            base=self.base + added.base,
            clouds=self.clouds.extended(added.clouds),
            references={
                agent: ReferenceRows.joined(references, added.references[agent])
                for agent, references in self.references.items()
                if agent in added.references
            },
            _made={},
        )


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
            table = next((rows for rows in tables if target in rows.index), None)
            if table is None:
                raise KeyError(target)
            self._made[target] = table.state(table.index[target])
        return self._made[target]

    def __contains__(self, target: object) -> bool:
        tables: tuple[Rows | ParticleTable, ...] = (*self.gaussians, *self.particles)
        return target in self.others or any(target in table.index for table in tables)

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
        singles = dict(self.others)
        for table in self.particles:
            is_same = [nets[target] is net for target, net in zip(table.ids, table.nets, strict=True)]
            if not all(is_same):
                changed_rows = [row for row, is_so in enumerate(is_same) if not is_so]
                singles.update((table.ids[row], table.state(row)) for row in changed_rows)
                table = table.take([row for row, is_so in enumerate(is_same) if is_so])
            if table.ids:
                tables.append(table)
        return Targets(self.gaussians, tables, singles, self.order)


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
            rows = next((table for table in self.gaussians if target in table.index), None)
            if rows is None or rows.columns.since[rows.index[target]] < 0:
                raise KeyError(target)
            self._made[target] = rows.record(rows.index[target])
        return self._made[target]

    def __iter__(self) -> Iterator[str]:
        for rows in self.gaussians:
            is_counted = (rows.columns.since >= 0).tolist()
            yield from (target for target, is_known in zip(rows.ids, is_counted, strict=True) if is_known)
        yield from self.others

    def __len__(self) -> int:
        return len(self.others) + sum(
            int(np.count_nonzero(table.columns.since >= 0)) for table in self.gaussians
        )

    def __reduce__(self) -> tuple[Any, ...]:
        return dict, (dict(self),)
