"""Numbers of a comparison, block by block: pairs of targets, distances of estimates, figures, evidence."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.journal.blocks import Block, Blocks, spans
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.lives import CandidateConfirmed, Returned, TargetStarted
from bayesnet_track.journal.frame_columns import is_absent
from bayesnet_track.journal.metrics import NOT_SHOWN
from bayesnet_track.journal.net import Switch
from bayesnet_track.journal.text.wording import plural
from bayesnet_track.numerics.arrays import Floats

Pair = tuple[str, str]
Rows = NDArray[np.int64]

COLUMNS = ("box", "ud_px2", "status", "active", "particles", "log_evidence", "kl/", "log_predictive/")
"""What a comparison reads of a frame."""

MOST = 0.9
"""Share of the frames that must have evidence of the same agents for one run to explain the video better."""

NEAR = 0.5
"""Two boxes hold the same target when their centres are nearer than this share of their mean size."""


@dataclass(frozen=True)
class Total:
    """One figure of both runs; None where it was not measured.

    Attributes:
        name: what it is, with its unit.
        first: the first run's.
        second: the second run's.
        less_is_better: True or False; None where neither is better in itself.
    """

    name: str
    first: float | None
    second: float | None
    less_is_better: bool | None = None


@dataclass(frozen=True, eq=False)
class Distances:
    """Distances of the two estimates of a target, in each frame in which both runs have it.

    Attributes:
        frame: (N,) the frames, rising.
        px: (N,) distance of the centres.
        iou: (N,) overlap of the boxes.
    """

    frame: NDArray[np.int32]
    px: Floats
    iou: Floats

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def farthest(self) -> int:
        """Index of the frame in which they are farthest apart."""
        return int(np.argmax(self.px))


def target_ids(events: Iterable[Event]) -> list[str]:
    """Ids of the targets that start, in order."""
    return list(
        dict.fromkeys(event.target for event in events if isinstance(event, TargetStarted | Returned))
    )


def pair_targets(runs: Sequence[Sequence[Event]], sides: Sequence[Blocks], end: int) -> tuple[Pair, ...]:
    """Ids of the same target in both runs: equal where given, else those that are together the longest.

    Args:
        runs: the events of each.
        sides: the measurements of each, with boxes.
        end: end of the frames that count.
    """
    ids = [target_ids(events) for events in runs]
    born = {event.target for events in runs for event in events if isinstance(event, CandidateConfirmed)}
    pairs = {target: target for target in ids[0] if target in {*ids[1]} - born}
    together: Counter[Pair] = Counter()
    if len(pairs) < min(map(len, ids)):
        for span in spans(sides, end):
            together.update(_together([side.read(*span) for side in sides], sides, {*pairs}))
    paired = {*pairs.values()}
    for (mine, theirs), _ in sorted(together.items(), key=lambda item: (-item[1], item[0])):
        if mine not in pairs and theirs not in paired:
            pairs[mine] = theirs
            paired.add(theirs)
    return tuple((target, pairs[target]) for target in ids[0] if target in pairs)


def _together(blocks: Sequence[Block], sides: Sequence[Blocks], without: set[str]) -> Counter[Pair]:
    """Frames in which the boxes of two targets, one of each run, are near each other."""
    frames, boxes, targets = [], [], []
    for block, side in zip(blocks, sides, strict=True):
        target_names = side.texts["target"].texts
        is_wanted = np.array([name not in without for name in target_names], dtype=bool)[
            block.codes("target")
        ]
        frames.append(block.frame[is_wanted])
        boxes.append(block.numbers("box")[:, is_wanted] if len(block) else np.zeros((4, 0)))
        targets.append(block.codes("target")[is_wanted])
    sides_px = [np.sqrt(np.maximum(box[2] * box[3], 0.0)) for box in boxes]
    met: list[NDArray[np.int64]] = []
    common = np.intersect1d(*frames)
    bounds = [np.searchsorted(of_run, [common, common + 1]).T.tolist() for of_run in frames]
    for mine, theirs in zip(*bounds, strict=True):
        a, b = slice(*mine), slice(*theirs)
        dx, dy = (boxes[0][axis, a, None] - boxes[1][axis, b] for axis in (0, 1))
        size = NEAR**2 * sides_px[0][a, None] * sides_px[1][b]
        i, j = np.nonzero(dx * dx + dy * dy < size)
        met.append(targets[0][a][i].astype(np.int64) << 32 | targets[1][b][j])
    if not met:
        return Counter()
    keys, counts = np.unique(np.concatenate(met), return_counts=True)
    names = [side.texts["target"].texts for side in sides]
    return Counter(
        {
            (names[0][key >> 32], names[1][key & 0xFFFF_FFFF]): count
            for key, count in zip(keys.tolist(), counts.tolist(), strict=True)
        }
    )


class Apart:
    """Distances between the estimates of each pair of targets."""

    def __init__(self, pairs: Sequence[Pair], sides: Sequence[Blocks]) -> None:
        self._pairs, self._sides = pairs, sides
        self._numbers = [{pair[side]: number for number, pair in enumerate(pairs)} for side in (0, 1)]
        self._parts: list[list[tuple[NDArray[np.int32], Floats, Floats]]] = [[] for _ in pairs]
        self.first_apart: int | None = None

    def add(self, first: Block, second: Block) -> tuple[Rows, Rows]:
        """Measure the frames of a block; gives the rows of the same pair and frame in both."""
        keys = [self._keys(block, side) for side, block in enumerate((first, second))]
        order = np.argsort(keys[1], kind="stable")
        position = np.searchsorted(keys[1], keys[0], sorter=order)
        theirs = order[np.minimum(position, len(order) - 1)] if len(order) else np.zeros(0, np.int64)
        is_shared = (
            (keys[1][theirs] == keys[0]) & (keys[0] >= 0) if len(order) else np.zeros(len(first), bool)
        )
        rows = np.flatnonzero(is_shared)
        theirs = theirs[rows] if len(order) else rows
        if not len(rows):
            return rows, rows
        px, iou = _distances(first.numbers("box")[:, rows], second.numbers("box")[:, theirs])
        frames = first.frame[rows]
        is_apart = (px > 0) | (iou < 1)
        if self.first_apart is None and is_apart.any():
            self.first_apart = int(frames[is_apart].min())
        numbers = keys[0][rows] % len(self._pairs)
        by_pair = np.argsort(numbers, kind="stable")
        ends = np.cumsum(np.bincount(numbers, minlength=len(self._pairs)))
        for parts, start, end in zip(self._parts, [0, *ends[:-1].tolist()], ends.tolist(), strict=True):
            if end > start:
                some = by_pair[start:end]
                parts.append((frames[some].astype(np.int32), px[some], iou[some]))
        return rows, theirs

    def distances(self) -> dict[Pair, Distances]:
        """Of each pair, in all frames so far; to be called once, since it empties what was gathered."""
        gathered: dict[Pair, Distances] = {}
        for pair, parts in zip(self._pairs, self._parts, strict=True):
            columns = [np.concatenate(column) for column in zip(*parts, strict=True)] or [np.zeros(0)] * 3
            gathered[pair] = Distances(columns[0].astype(np.int32), columns[1], columns[2])
            parts.clear()
        return gathered

    def _keys(self, block: Block, side: int) -> NDArray[np.int64]:
        """(N,) a number for each frame and pair; below 0 for a target without a partner."""
        names = self._sides[side].texts["target"].texts
        numbers = np.array([self._numbers[side].get(name, -1) for name in names], dtype=np.int64)
        of_rows = numbers[block.codes("target")]
        return np.where(of_rows < 0, -1, block.frame * len(self._pairs) + of_rows)


def _distances(a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """(N,) distances of the centres, px, and overlaps of (4, N) centre boxes."""
    low = np.maximum(a[:2] - a[2:] / 2, b[:2] - b[2:] / 2)
    high = np.minimum(a[:2] + a[2:] / 2, b[:2] + b[2:] / 2)
    shared = np.prod(np.maximum(high - low, 0.0), axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        iou = shared / (a[2] * a[3] + b[2] * b[3] - shared)
    return np.hypot(a[0] - b[0], a[1] - b[1]), np.where((a == b).all(axis=0), 1.0, iou)


class RunEvidence:
    """Log-evidence of both runs, over the frames of their pairs in which the same agents gave evidence.

    It compares models of one and the same evidence: the graphs must have the same agents. The name of the
    total says how many frames count. Where less than `MOST` of them do, neither is called better: a run that
    lost its target has no evidence in the frames that would have told against it.
    """

    def __init__(self) -> None:
        self._sums, self._frames, self._common = [0.0, 0.0], 0, 0

    def add(self, first: Block, second: Block, mine: Rows, theirs: Rows) -> None:
        """Add rows of the same pair and frame."""
        names = [name for name in {**first.columns, **second.columns} if name.startswith("kl/")]
        if not names or not len(mine):
            return
        reported = [
            np.stack([~is_absent(block.numbers(name)[rows]) for name in names])
            for block, rows in ((first, mine), (second, theirs))
        ]
        values = [first.numbers("log_evidence")[mine], second.numbers("log_evidence")[theirs]]
        is_heard = reported[0].any(axis=0) | reported[1].any(axis=0)
        counts = (
            is_heard
            & (reported[0] == reported[1]).all(axis=0)
            & np.isfinite(values[0])
            & np.isfinite(values[1])
        )
        self._common += int(is_heard.sum())
        self._frames += int(counts.sum())
        self._sums = [
            total + float(of_run[counts].sum()) for total, of_run in zip(self._sums, values, strict=True)
        ]

    def total(self) -> Total:
        """The sums of both."""
        if not self._frames:
            return Total("log-evidence, nats", None, None)
        name = f"log-evidence, nats ({self._frames} of {plural(self._common, 'frame')})"
        return Total(
            name, self._sums[0], self._sums[1], False if self._frames >= MOST * self._common else None
        )


class Predictive:
    """Log densities of what each sensor that both runs have measured, under their predictions.

    Of the frames of their pairs in which both have one. It compares models with other agents beside the
    sensor, which then has to be the same: its quantities, their units and its readings.
    """

    def __init__(self) -> None:
        self._sums: dict[str, list[float]] = {}
        self._frames: Counter[str] = Counter()

    def add(self, first: Block, second: Block, mine: Rows, theirs: Rows) -> None:
        """Add rows of the same pair and frame."""
        names = [
            column
            for column in first.columns
            if column.startswith("log_predictive/") and column in second.columns
        ]
        for name in names if len(mine) else ():
            values = [first.numbers(name)[mine], second.numbers(name)[theirs]]
            counts = ~is_absent(values[0]) & ~is_absent(values[1])
            if counts.any():
                sums = self._sums.setdefault(name.partition("/")[2], [0.0, 0.0])
                sums[:] = [
                    total + float(run_values[counts].sum())
                    for total, run_values in zip(sums, values, strict=True)
                ]
                self._frames[name.partition("/")[2]] += int(counts.sum())

    def totals(self) -> tuple[Total, ...]:
        """The sums of both, a sensor each."""
        return tuple(
            Total(
                f"predictive log density of {agent}, nats ({plural(self._frames[agent], 'frame')})",
                sums[0],
                sums[1],
                False,
            )
            for agent, sums in self._sums.items()
        )


class Figures:
    """Means and counts of one run."""

    def __init__(self, side: Blocks) -> None:
        self._side = side
        self._used: Counter[tuple[int, int]] = Counter()
        self._particles, self._lost, self._frames = 0, 0, 0
        self._seen: list[NDArray[np.int64]] = []
        self._uds: list[NDArray[np.float32 | np.float64]] = []

    def add(self, block: Block) -> None:
        """Count the rows of a block."""
        if not len(block):
            return
        keys = block.codes("target").astype(np.int64) << 32 | block.codes("active")
        for key, count in zip(
            *(array.tolist() for array in np.unique(keys, return_counts=True)), strict=True
        ):
            self._used[key >> 32, key & 0xFFFF_FFFF] += count
        self._particles += int(block.columns["particles"].sum())
        statuses = self._side.texts["status"].texts
        is_lost = np.array([status in NOT_SHOWN for status in statuses], dtype=bool)
        self._lost += int(is_lost[block.codes("status")].sum())
        self._seen.append(np.unique(block.frame))
        uds = block.columns["ud_px2"]
        self._uds.append(uds[np.isfinite(uds)])

    def table(
        self,
        events: Sequence[Event],
        seconds: Mapping[int, float],
        costs_ms: Mapping[tuple[str, str], float],
    ) -> dict[str, float | None]:
        """Name -> figure; `events`, `seconds` and `costs_ms` are the run's, as far as it is compared."""
        count = len({*np.concatenate([np.zeros(0, np.int64), *self._seen]).tolist()} | seconds.keys())
        kinds = {e.target: e.template for e in events if isinstance(e, TargetStarted | Returned)}
        agents: defaultdict[tuple[str, str], int] = defaultdict(int)
        for (target, active), frames in self._used.items():
            plate = kinds.get(self._side.texts["target"].texts[target], "")
            for agent in self._side.texts["active"].texts[active].split():
                agents[plate, agent] += frames
        declared = [(costs_ms.get(agent), frames) for agent, frames in agents.items()]
        costs = [cost * frames for cost, frames in declared if cost is not None]
        # The first frame of a process pays for compiling and loading.
        measured = sorted(value for frame, value in seconds.items() if frame != min(seconds))
        uds = np.concatenate([np.zeros(0, np.float32), *self._uds])
        middle = len(uds) // 2

        def per_frame(total: float) -> float | None:
            return total / count if count else None

        return {
            "frames": float(count),
            "targets": float(len(target_ids(events))),
            "agents per frame": per_frame(sum(agents.values())),
            "declared ms per frame": per_frame(math.fsum(costs)) if len(costs) == len(declared) else None,
            "measured ms per frame": 1000 * sum(measured) / len(measured) if measured else None,
            "measured ms, median frame": 1000 * measured[len(measured) // 2] if measured else None,
            "hypotheses per frame": per_frame(self._particles),
            "reconfigurations": float(sum(isinstance(event, Switch) for event in events)),
            "frames lost": float(self._lost),
            "median UD, px²": float(np.partition(uds, middle)[middle]) if len(uds) else None,
        }
