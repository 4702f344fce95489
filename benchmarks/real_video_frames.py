"""Tables of `real_video_halves`: accuracy, doubt and switches of passes that are known frame by frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from measuring import table
from numpy.typing import NDArray
from real_video_coin import NEW

Floats = NDArray[np.float64]
DRAWS = 5000
GOOD, POOR = 0.5, 0.1
"""IoU above which a frame is on target, and below which it is off."""


@dataclass(frozen=True)
class Frames:
    """What was found in each frame but the first: overlap, score, status and CPU seconds."""

    iou: list[float]
    score: list[float]
    status: list[str]
    cpu_s: list[float]


@dataclass(frozen=True)
class Pass:
    """One pass of one tracker over one sequence.

    Attributes:
        auc: OTB success; the last box held counts while it is lost.
        auc_every: the same where every frame's own box counts.
        switches: agents switched on or off per 100 frames.
        agents: agents evaluated per frame, active or sampled.
        in50: share of frames whose true centre lies in the 50 % region; likewise `in90`.
    """

    tracker: str
    graph: str
    sequence: str
    seed: int
    auc: float
    auc_every: float
    switches: float
    agents: float
    in50: float
    in90: float
    frames: Frames


def share(passes: Sequence[Pass], of: Callable[[float, str], bool], among: Callable[[float], bool]) -> float:
    """Share of the frames `among` (by IoU) of which `of` (by IoU and status) holds, sequences alike."""
    shares = []
    for sequence in sorted({one.sequence for one in passes}):
        frames = [one.frames for one in passes if one.sequence == sequence]
        own = [pair for one in frames for pair in zip(one.iou, one.status, strict=True)]
        chosen = [of(iou, status) for iou, status in own if among(iou)]
        if chosen:
            shares.append(float(np.mean(chosen)))
    return float(np.mean(shares)) if shares else float("nan")


def auroc(passes: Sequence[Pass]) -> float:
    """Probability that a good frame has a larger score than a poor one; each sequence has the same weight.

    Frames of all sequences are compared with each other.
    """
    scores: dict[bool, list[Floats]] = {True: [], False: []}
    weights: dict[bool, list[Floats]] = {True: [], False: []}
    for sequence in {one.sequence for one in passes}:
        frames = [one.frames for one in passes if one.sequence == sequence]
        iou = np.concatenate([np.array(one.iou) for one in frames])
        score = np.concatenate([np.array(one.score) for one in frames])
        for good, chosen in ((True, score[iou > GOOD]), (False, score[iou < POOR])):
            if len(chosen):
                scores[good].append(chosen)
                weights[good].append(np.full(len(chosen), 1.0 / len(iou)))
    if not scores[True] or not scores[False]:
        return float("nan")
    high, low = np.concatenate(scores[True]), np.concatenate(scores[False])
    of_high, of_low = np.concatenate(weights[True]), np.concatenate(weights[False])
    order = np.argsort(low)
    below = np.concatenate([[0.0], np.cumsum(of_low[order])])
    less = below[np.searchsorted(low[order], high, side="left")]
    same = below[np.searchsorted(low[order], high, side="right")] - less
    return float(np.sum(of_high * (less + 0.5 * same)) / of_high.sum() / of_low.sum())


def mean_of(passes: Sequence[Pass], value: Callable[[Pass], float]) -> float:
    """Mean over sequences of the mean over seeds."""
    names = sorted({one.sequence for one in passes})
    return float(
        np.mean([np.mean([value(one) for one in passes if one.sequence == name]) for name in names])
        if names
        else np.nan
    )


def rows_of(passes: Sequence[Pass], trackers: Sequence[str]) -> list[list[str]]:
    """A row of means for each tracker."""
    rows = []
    for name in trackers:
        own = [one for one in passes if one.tracker == name]
        new = [one for one in own if one.sequence in NEW]
        cpu = np.concatenate([np.array(one.frames.cpu_s) for one in own])
        peer = not own[0].graph
        rows.append(
            [
                name,
                f"{mean_of(own, lambda one: one.auc):.3f}",
                f"{mean_of(own, lambda one: one.auc_every):.3f}",
                f"{mean_of(new, lambda one: one.auc):.3f}" if new else "-",
                "-" if peer else f"{auroc(own):.3f}",
                f"{share(own, lambda _, s: s != 'tracking', lambda iou: iou > GOOD):.3f}",
                f"{share(own, lambda iou, s: s == 'tracking' and iou == 0, lambda _: True):.4f}",
                f"{share(own, lambda _, s: s == 'tracking', lambda iou: iou == 0):.3f}",
                "-"
                if peer
                else f"{mean_of(own, lambda one: one.in50):.2f} / {mean_of(own, lambda one: one.in90):.2f}",
                "-"
                if peer
                else f"{mean_of(own, lambda one: one.switches):.1f} / {max(one.switches for one in own):.1f}",
                "-" if peer else f"{mean_of(own, lambda one: one.agents):.2f}",
                f"{len(cpu) / cpu.sum():.0f}",
                "-" if peer else f"{1000 * np.median(cpu):.1f} / {1000 * cpu.max():.0f}",
            ]
        )
    return rows


HEAD = [
    "",
    "AUC",
    "every box",
    "new ones",
    "AUROC",
    "doubt while good",
    "tracking at IoU 0, of all",
    "of these",
    "in 50 / 90 %",
    "switches / 100, mean / most",
    "agents evaluated",
    "frames / CPU s",
    "ms, median / worst",
]


COMPARED = ["", "AUC", "95 %, sequences like these", "without the one that moves it"]


def difference(passes: Sequence[Pass], one: str, other: str, only: Sequence[str] | None = None) -> list[str]:
    """A row: difference of the AUCs, interval over sequences like these, without the most influential one."""
    means = {
        name: {
            sequence: float(np.mean([p.auc for p in passes if (p.tracker, p.sequence) == (name, sequence)]))
            for sequence in {p.sequence for p in passes if p.tracker == name}
        }
        for name in (one, other)
    }
    names = [name for name in sorted(means[one]) if only is None or name in only]
    if not names:
        return []
    found = np.array([means[one][name] - means[other][name] for name in names])
    drawn = np.random.default_rng(0).choice(found, (DRAWS, len(found))).mean(axis=1)
    low, high = np.percentile(drawn, [2.5, 97.5])
    top = int(np.argmax(np.abs(found - found.mean())))
    rest = np.delete(found, top).mean() if len(found) > 1 else np.nan
    label = f"{one} − {other}{'' if only is None else ', new ones'}"
    return [label, f"{found.mean():+.3f}", f"{low:+.3f} .. {high:+.3f}", f"{rest:+.3f} ({names[top]})"]


def report(passes: Sequence[Pass]) -> str:
    """Means, differences from the first tracker, and every sequence."""
    trackers = list(dict.fromkeys(one.tracker for one in passes))
    text = table(HEAD, rows_of(passes, trackers))
    first, *others = trackers
    rows = [difference(passes, first, other, only) for other in others for only in (None, NEW)]
    if found := [row for row in rows if row]:
        text += "\n\n" + table(COMPARED, found)
    lines = []
    for sequence in sorted({one.sequence for one in passes}):
        own = {
            name: np.mean([p.auc for p in passes if (p.tracker, p.sequence) == (name, sequence)])
            for name in trackers
        }
        lines.append([sequence, *(f"{value:.3f}" for value in own.values())])
    return text + "\n\n" + table(["AUC", *trackers], lines)
