"""Nets in which only the target's status can change: what their rules remember, as columns.

It is what `rules.decide` remembers of each target while nothing is decided.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.adapt.memory import (
    NO_QUIET,
    NO_STREAK,
    QUIET_MINIMUM,
    QUIET_WINDOW,
    Memory,
    Quiet,
    Streak,
)
from bayesnet_track.adapt.status import USUAL
from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.numerics.arrays import Bools, Floats, Ints
from bayesnet_track.numerics.records import changed

COLUMNS = ("quiet", "quiet_count", "nats", "nat_frames", "found_count", "found_values", "medians")
"""The arrays of `PlainMemories`, a row for each target."""


@lru_cache(maxsize=64)
def has_plain_rules(plate: CheckedTarget) -> bool:
    """Whether all that a plate's rules decide, while its agents work, is its status by UD and fit."""
    root = plate.inference(plate.root)
    return (
        root.score is None
        and (root.lost or USUAL).existence_below is None
        and len(plate.children) == 1
        and root.adapt is None
        and all(plate.agent(agent).self_check is None for agent in plate.agents)
    )


@dataclass(frozen=True, eq=False)
class Seen:
    """What was measured of T targets.

    Attributes:
        uds: (T,) of the root's belief, px^2.
        areas: (T,) of the estimates, px^2.
        fits: (T,) as in `Measures`.
        hidden: (T,) shares that others hide.
        nats: (T, A) contributions of the active agents.
    """

    uds: Floats
    areas: Floats
    fits: Floats
    hidden: Floats
    nats: Floats


@dataclass(frozen=True, eq=False)
class PlainMemories:
    """What is remembered of T targets with the same active agents.

    Attributes:
        others: of each, what else its rules remember; it does not change.
        root: the node whose UD counts.
        agents: the A active agents.
        quiet: (T, W) last values of UD, filled from the right.
        quiet_count: (T,) how many there are.
        nats: (T, A) sums of contributions.
        nat_frames: (T, A) frames that count in them.
        found_count: (T,) frames in a row that look found.
        found_values: (T, F) values of the last of them, filled from the right.
        medians: (T,) baselines of UD, px^2; NaN while unknown.
    """

    others: tuple[Memory, ...]
    root: str
    agents: tuple[str, ...]
    quiet: Floats
    quiet_count: Ints
    nats: Floats
    nat_frames: Ints
    found_count: Ints
    found_values: Floats
    medians: Floats

    @staticmethod
    def fits(memory: Memory, root: str, active: frozenset[str]) -> bool:
        """Whether the columns have a place for all that a target's rules remember."""
        quiet = memory.quiet.get(root, NO_QUIET).values
        return (
            not (memory.missed or memory.self_check or memory.worth)
            and memory.quiet.keys() <= {root}
            and quiet.keys() <= {active}
        )

    @classmethod
    def of(cls, plate: CheckedTarget, agents: Sequence[str], memories: Sequence[Memory]) -> PlainMemories:
        """The columns of memories that fit, of a plate's targets with these active agents."""
        root, active = plate.root, frozenset(agents)
        frames = (plate.inference(root).lost or USUAL).frames
        quiet = [one.quiet.get(root, NO_QUIET).values.get(active, ()) for one in memories]
        helpful = [[one.helpful.get(agent, (0.0, 0)) for agent in agents] for one in memories]
        sums = np.array(helpful, dtype=np.float64).reshape(len(memories), len(agents), 2)
        return cls(
            tuple(memories),
            root,
            tuple(agents),
            _right_aligned(quiet, QUIET_WINDOW),
            np.array([len(one) for one in quiet], dtype=np.int64),
            sums[:, :, 0].copy(),
            sums[:, :, 1].astype(np.int64),
            np.array([one.found.count for one in memories], dtype=np.int64),
            _right_aligned([one.found.values for one in memories], frames),
            np.full(len(memories), np.nan),
        )

    def then(self, plate: CheckedTarget, seen: Seen) -> tuple[PlainMemories, Bools]:
        """After one more frame of targets that are tracked, and of which nothing is decided.

        Something may be decided of the others, whose rows mean nothing.
        """
        from bayesnet_track.numerics.kernels.row_kernels import append_medians

        rule, count = plate.inference(self.root).lost or USUAL, len(self.others)
        every = np.ones(count, dtype=np.bool_)
        quiet, held, medians = append_medians(self.quiet, self.quiet_count, seen.uds, every, QUIET_MINIMUM)
        scale = {"ud_px2": np.ones(count), "ud_box": seen.areas, "ud_baseline": medians}[rule.above.kind]
        is_known = scale > 0.0  # not where the baseline is unknown
        value = np.where(is_known, seen.uds / np.where(is_known, scale, 1.0), 0.0)
        stays = ~(value > rule.above.settings) & ((seen.fits >= rule.fit_below) | (seen.hidden >= 0.5))
        after = replace(
            self,
            quiet=quiet,
            quiet_count=held,
            nats=self.nats + seen.nats,
            nat_frames=self.nat_frames + 1,
            found_count=self.found_count + 1,
            found_values=np.concatenate([self.found_values[:, 1:], value[:, None]], axis=1),
            medians=medians,
        )
        return after, stays

    def take(self, rows: Sequence[int]) -> PlainMemories:
        """Those of some targets."""
        return self._with(tuple(self.others[row] for row in rows), lambda name: getattr(self, name)[[*rows]])

    def extended(self, others: PlainMemories) -> PlainMemories:
        """These, then others of the same agents."""

        def both(name: str) -> NDArray[Any]:
            return np.concatenate([getattr(self, name), getattr(others, name)])

        return self._with(self.others + others.others, both)

    def _with(self, others: tuple[Memory, ...], column: Callable[[str], NDArray[Any]]) -> PlainMemories:
        return changed(self, others=others, **{name: column(name) for name in COLUMNS})

    def median(self, row: int) -> float | None:
        """The baseline of one target's UD, px^2; None while unknown."""
        value = float(self.medians[row])
        return None if value != value else value

    def memory(self, row: int) -> Memory:
        """What is remembered of one target."""
        other, count = self.others[row], int(self.quiet_count[row])
        found = int(self.found_count[row])
        held = max(len(self.found_values[row]) - found, 0)
        own = zip(self.agents, self.nats[row].tolist(), self.nat_frames[row].tolist(), strict=True)
        values = tuple(self.quiet[row, QUIET_WINDOW - count :].tolist())
        return changed(
            other,
            quiet={self.root: Quiet({frozenset(self.agents): values})},
            helpful={**other.helpful, **{agent: (nats, frames) for agent, nats, frames in own}},
            lost=NO_STREAK,
            unfit=NO_STREAK,
            found=Streak(found, tuple(self.found_values[row, held:].tolist())),
        )


def _right_aligned(values: Sequence[tuple[float, ...]], size: int) -> Floats:
    table = np.zeros((len(values), size))
    for row, several in enumerate(values):
        if several:
            table[row, size - len(several) :] = several
    return table
