"""The simulated annotator, the oracle of linear interpolation, and the curves of `annotate.py`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from real_video_coin import HALVES
from sequences import Sequence

from bayesnet_track.runtime.annotation.answers import Answer, Box
from bayesnet_track.runtime.annotation.fusing import iou

Floats = NDArray[np.float64]
CONFIRMED_IOU = 0.7
"""A box that overlaps the true one by as much is answered with "correct"."""

LEVELS = (0.95, 0.99)
COSTS = (0.3, 0.5, 0.7, 0.9, 1.2, 1.5, 2, 2.5, 3, 4, 5, 7, 10, 15, 25, 50)
"""Frames that one more box of the oracle must win: each gives a point of its curve."""


@dataclass(frozen=True)
class Done:
    """A finished annotation of a sequence: counts of answers, and of frames.

    Attributes:
        unasked: frames that nobody was asked about.
        wrong: of these, those with IoU below .5.
    """

    sequence: str
    frames: int
    boxes: int
    gone: int
    correct: int
    good50: int
    good70: int
    unasked: int
    wrong: int

    @classmethod
    def of(cls, sequence: Sequence, answers: list[Answer], boxes: list[Box | None]) -> Done:
        """Count."""
        pairs = list(zip(boxes, map(true_box, sequence.truth), strict=True))
        overlaps = [1.0 if a is None and b is None else overlap(a, b) for a, b in pairs]
        asked = {one.frame for one in answers}
        unasked = [value for frame, value in enumerate(overlaps) if frame not in asked]
        kinds = [one.kind for one in answers]
        return cls(
            sequence.name,
            len(boxes),
            kinds.count("box"),
            kinds.count("gone"),
            kinds.count("correct"),
            sum(value >= 0.5 for value in overlaps),
            sum(value >= 0.7 for value in overlaps),
            len(unasked),
            sum(value < 0.5 for value in unasked),
        )


def true_box(row: Floats) -> Box | None:
    """The true box of a frame; None where there is none."""
    x, y, w, h = (float(value) for value in row)
    return (x, y, w, h) if np.isfinite(row).all() and w > 0 and h > 0 else None


def overlap(one: Box | None, other: Box | None) -> float:
    """IoU; 0 where one of them is none."""
    return 0.0 if one is None or other is None else iou(one, other)


class Annotator(Protocol):
    """Answers a question about a frame, where a box is shown; without `may_confirm` with a box always."""

    def __call__(self, frame: int, shown: Box | None, may_confirm: bool = True) -> Answer:
        """The answer."""
        ...


def annotator(truth: Floats) -> Annotator:
    """The simulated annotator, who knows the truth."""

    def answer(frame: int, shown: Box | None, may_confirm: bool = True) -> Answer:
        true = true_box(truth[frame])
        if true is None:
            return Answer("gone", frame, "1")
        if may_confirm and shown is not None and overlap(shown, true) >= CONFIRMED_IOU:
            return Answer("correct", frame, "1", shown)
        return Answer("box", frame, "1", true)

    return answer


def best_lines(sequence: Sequence) -> Iterator[tuple[str, Done]]:
    """The oracle: boxes where they win most; for each cost of a box in frames."""
    truth = sequence.truth
    seen = np.array([true_box(row) is not None for row in truth])
    good = _good_between(truth, seen)
    for cost in COSTS:
        frames = _best_frames(good, cost)
        boxes = [*_lines(truth, frames)]
        answers = [
            Answer("box", one, "1", true_box(truth[one])) if seen[one] else Answer("gone", one, "1")
            for one in frames
        ]
        yield f"a box wins {cost:g} frames", Done.of(sequence, answers, boxes)


def _good_between(truth: Floats, seen: NDArray[np.bool_]) -> Floats:
    """(n, n + 1): good frames from i + 1 to j with boxes in i and j; the last column: i holds to the end."""
    count = len(truth)
    good = np.full((count, count + 1), -np.inf)
    for one in range(count):
        for then in range(one + 1, count + 1):
            last = min(then, count - 1)
            weight = (np.arange(one + 1, last + 1) - one) / (then - one) if then < count else 0.0
            end = truth[then] if then < count else truth[one]
            lines = truth[one] + np.reshape(weight, (-1, 1)) * (end - truth[one])
            lines = np.broadcast_to(lines, (last - one, 4))
            good[one, then] = np.sum(_overlaps(lines, truth[one + 1 : last + 1]) >= 0.5)
    return good


def _best_frames(good: Floats, cost: float) -> list[int]:
    """The frames of the boxes with the most good frames, less the cost of each."""
    count = len(good)
    best, back = np.full(count + 1, -np.inf), np.zeros(count + 1, dtype=int)
    best[0] = 1.0 - cost
    for then in range(1, count + 1):
        values = best[:then] + good[:then, then] - (cost if then < count else 0.0)
        back[then] = int(np.argmax(values))
        best[then] = values[back[then]]
    frames, at = [], int(back[count])
    while at > 0:
        frames.append(at)
        at = int(back[at])
    return [0, *reversed(frames)]


def _lines(truth: Floats, frames: list[int]) -> Iterator[Box | None]:
    for frame in range(len(truth)):
        row = np.array([np.interp(frame, frames, truth[frames, column]) for column in range(4)])
        yield true_box(row)


def _overlaps(boxes: Floats, others: Floats) -> Floats:
    low = np.maximum(boxes[:, :2], others[:, :2])
    high = np.minimum(boxes[:, :2] + boxes[:, 2:], others[:, :2] + others[:, 2:])
    both = np.prod(np.clip(high - low, 0, None), axis=1)
    whole = np.prod(boxes[:, 2:], axis=1) + np.prod(others[:, 2:], axis=1) - both
    return np.asarray(both / np.maximum(whole, 1e-9), dtype=np.float64)


Rows = list[tuple[str, str, Done]]
COUNTS = ["boxes", "gone", "correct", "questions / 100", "IoU >= .5", ">= .7", "wrong unasked"]
HEAD = ["method", "setting", *COUNTS]
CHOSEN_HEAD = ["method", "share asked for", "reported on", "setting", *COUNTS]


def curve_rows(found: Rows) -> list[list[str]]:
    """A row for each setting, over all frames."""
    return [[family, label, *_cells(own)] for (family, label), own in _groups(found).items()]


def chosen_rows(found: Rows) -> list[list[str]]:
    """For each method and level: the setting with the fewest questions on one half, on the other half."""
    rows = []
    for level in LEVELS:
        for family in dict.fromkeys(one[0] for one in found):
            for half, other in (("A", "B"), ("B", "A")):
                label = _fewest(found, family, HALVES[half], level)
                if label is None:
                    rows.append([family, f"{level:.0%}", other, "none reaches it", *[""] * 7])
                    continue
                own = [d for f, s, d in found if (f, s) == (family, label) and d.sequence in HALVES[other]]
                rows.append([family, f"{level:.0%}", other, label, *_cells(own)])
    return rows


def _fewest(found: Rows, family: str, names: tuple[str, ...], level: float) -> str | None:
    kept = [one for one in found if one[0] == family and one[2].sequence in names]
    reached = {
        label: _rate(own, lambda d: d.boxes + d.gone + d.correct)
        for (_, label), own in _groups(kept).items()
        if _rate(own, lambda d: d.good50) >= level
    }
    return min(reached, key=lambda label: reached[label]) if reached else None


def _groups(found: Rows) -> dict[tuple[str, str], list[Done]]:
    groups: dict[tuple[str, str], list[Done]] = {}
    for family, label, done in found:
        groups.setdefault((family, label), []).append(done)
    return groups


def _rate(own: list[Done], of: Callable[[Done], int]) -> float:
    return sum(map(of, own)) / max(1, sum(one.frames for one in own))


def _cells(own: list[Done]) -> list[str]:
    if not own:
        return [""] * 7
    counts = [100 * _rate(own, of) for of in (lambda d: d.boxes, lambda d: d.gone, lambda d: d.correct)]
    wrong = sum(one.wrong for one in own) / max(1, sum(one.unasked for one in own))
    return [
        *(f"{value:.1f}" for value in counts),
        f"{sum(counts):.1f}",
        f"{_rate(own, lambda d: d.good50):.3f}",
        f"{_rate(own, lambda d: d.good70):.3f}",
        f"{wrong:.3f}",
    ]
