"""UD, status and active agents of targets over a run, as columns: what charts draw."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.journal.blocks import Block, Blocks
from bayesnet_track.journal.metrics import NOT_SHOWN, FrameMetrics
from bayesnet_track.numerics.arrays import Floats

COLUMNS = ("ud_px2", "quiet_px2", "status", "active")


@dataclass(frozen=True, eq=False)
class History:
    """One target's frames, in order.

    Attributes:
        frame: (N,) in which it lives.
        ud_px2: (N,) UD of its root.
        quiet_px2: (N,) the baseline of UD; NaN where there is none.
        is_lost: (N,) whether it counts as lost.
        actives: groups of agents that were active together.
        active: (N,) index of the frame's group.
    """

    frame: NDArray[np.int64]
    ud_px2: Floats
    quiet_px2: Floats
    is_lost: NDArray[np.bool_]
    actives: Sequence[tuple[str, ...]]
    active: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def agents(self) -> tuple[str, ...]:
        """The agents that are active in any frame, in the order of the first."""
        codes, first = np.unique(self.active, return_index=True)
        ordered = codes[np.argsort(first)].tolist()
        return tuple(dict.fromkeys(name for code in ordered for name in self.actives[code]))

    def is_active(self, agent: str) -> NDArray[np.bool_]:
        """(N,) whether an agent is active."""
        return np.array([agent in group for group in self.actives], dtype=bool)[self.active]

    def stretches(self, mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
        """Stretches of successive rows of a mask, as first and last frame."""
        edges = np.diff(mask.astype(np.int8), prepend=0, append=0)
        first, last = self.frame[edges[:-1] > 0], self.frame[edges[1:] < 0]
        return [*zip(first.tolist(), last.tolist(), strict=True)]


def histories(metrics: Sequence[FrameMetrics], targets: Iterable[str]) -> dict[str, History]:
    """The histories of some targets, read in one pass; empty ones of those without measurements."""
    blocks = Blocks(metrics, COLUMNS)
    parts: dict[str, list[Block]] = {target: [] for target in targets}
    for block in blocks:
        codes = block.codes("target")
        order = np.argsort(codes, kind="stable")
        present, starts = np.unique(codes[order], return_index=True)
        for code, rows in zip(present.tolist(), np.split(order, starts[1:]), strict=True):
            of_target = parts.get(blocks.texts["target"].texts[code])
            if of_target is not None:
                columns = {name: column[rows] for name, column in block.columns.items() if name in COLUMNS}
                of_target.append(Block(block.frame[rows].astype(np.int32), columns))
    actives = [tuple(text.split()) for text in blocks.texts["active"].texts]
    lost = np.array([status in NOT_SHOWN for status in blocks.texts["status"].texts], dtype=bool)
    return {target: _history(some, actives, lost) for target, some in parts.items()}


def _history(parts: Sequence[Block], actives: Sequence[tuple[str, ...]], lost: NDArray[np.bool_]) -> History:
    nothing = np.zeros(0, dtype=np.int32)

    def joined(name: str) -> Floats:
        return np.concatenate([nothing.astype(np.float64), *(part.numbers(name) for part in parts)])

    return History(
        frame=np.concatenate([nothing, *(part.frame for part in parts)]),
        ud_px2=joined("ud_px2"),
        quiet_px2=joined("quiet_px2"),
        is_lost=lost[np.concatenate([nothing, *(part.codes("status") for part in parts)])],
        actives=actives,
        active=np.concatenate([nothing, *(part.codes("active") for part in parts)]),
    )
