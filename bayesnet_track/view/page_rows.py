"""The rows that the page of a long run shows: some of each target's frames, and counts over all."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.journal.blocks import Block, Blocks
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.net.net import Decision

MOST_ROWS = 200_000
"""Rows (a target in a frame) that a page shows, about; of a run with more it shows some."""


@dataclass(frozen=True, eq=False)
class Shown:
    """Rows of a page.

    Attributes:
        rows: those that are shown, in order.
        about: None where they are all. Else `step`, the frames for which a row stands; `rows`, how many they
            are, and `of` how many; `frames`, in which there is a row; one in `decisions` of the rows with a
            decision is shown.
        counts: target -> frames, lost ones, uncertain ones, and frames of each active agent, over all rows.
    """

    rows: Block
    about: Mapping[str, int] | None
    counts: Mapping[str, Mapping[str, Any]]

    def counted(self, target: str) -> dict[str, Any]:
        """The key `counted` of a target's header, where not all of its rows are shown."""
        return {} if self.about is None else {"counted": self.counts[target]}


def choose(blocks: Blocks, events: Sequence[Event]) -> Shown:
    """The rows to show: all, or at most about `MOST_ROWS`.

    Of a long run they are every n-th frame, the frame with the largest UD of each target between two of them,
    and those with a decision about the target: no peak and no switch is missing from a curve.
    """
    if blocks.rows <= MOST_ROWS:
        return Shown(blocks.joined([*blocks]), None, {})
    step = -(-2 * blocks.rows // MOST_ROWS)
    frames = blocks.frames()
    decided = dict.fromkeys((event.target, event.frame) for event in events if isinstance(event, Decision))
    nth = max(1, -(-4 * len(decided) // MOST_ROWS))
    kept: list[Block] = []
    counts: Counter[tuple[int, int, int]] = Counter()
    for block in blocks:
        keys = [block.codes(name).astype(np.int64) for name in ("target", "status", "active")]
        combined = keys[0] << 40 | keys[1] << 32 | keys[2]
        for key, count in zip(
            *(one.tolist() for one in np.unique(combined, return_counts=True)), strict=True
        ):
            counts[key >> 40, (key >> 32) & 0xFF, key & 0xFFFF_FFFF] += count
        index = np.searchsorted(frames, block.frame)
        is_kept = (index % step == 0) | (index == len(frames) - 1) | _peaks(block, index // step)
        is_kept |= np.isin(_place(keys[0], block.frame), _places([*decided][::nth], blocks))
        kept.append(block.of_rows(np.flatnonzero(is_kept)))
    rows = blocks.joined(kept)
    apart = int(np.median(np.diff(frames[::step]))) if len(frames) > step else step
    about = {"step": apart, "rows": len(rows), "of": blocks.rows, "frames": len(frames), "decisions": nth}
    return Shown(rows, about, _by_target(counts, blocks))


def _places(decided: Sequence[tuple[str, int]], blocks: Blocks) -> NDArray[np.int64]:
    numbers = {target: number for number, target in enumerate(blocks.texts["target"].texts)}
    known = [(numbers[target], frame) for target, frame in decided if target in numbers]
    targets, frames = np.array(known, dtype=np.int64).reshape(-1, 2).T
    return _place(targets, frames)


def _place(targets: NDArray[np.int64], frames: NDArray[np.int64]) -> NDArray[np.int64]:
    return targets << 32 | frames


def _peaks(block: Block, stretch: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(N,) whether a row has the largest UD of its target in its stretch of frames."""
    uds = np.nan_to_num(block.numbers("ud_px2"), nan=-np.inf, posinf=np.inf)
    order = np.lexsort((-uds, stretch, block.codes("target")))
    groups = np.stack([block.codes("target")[order], stretch[order]])
    is_first = np.ones(len(order), dtype=bool)
    is_first[1:] = (groups[:, 1:] != groups[:, :-1]).any(axis=0)
    is_peak = np.zeros(len(order), dtype=bool)
    is_peak[order[is_first]] = True
    return is_peak


def _by_target(counts: Mapping[tuple[int, int, int], int], blocks: Blocks) -> dict[str, dict[str, Any]]:
    names, statuses, groups = (blocks.texts[name].texts for name in ("target", "status", "active"))
    counted: dict[str, dict[str, Any]] = {
        name: {"frames": 0, "lost": 0, "uncertain": 0, "active": {}} for name in names
    }
    for (target, status, group), count in counts.items():
        of_target = counted[names[target]]
        of_target["frames"] += count
        if statuses[status] in ("lost", "uncertain"):
            of_target[statuses[status]] += count
        for agent in groups[group].split():
            of_target["active"][agent] = of_target["active"].get(agent, 0) + count
    return counted
