"""One box out of two runs: forward from the box before, backward from the box after."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from bayesnet_track.runtime.annotation.answers import Box
from bayesnet_track.runtime.annotation.tracked import Found

How = Literal["given", "tracked", "interpolated", "gone"]

AGREE_IOU = 0.5
"""Two boxes that overlap by more are the same finding."""

BY_CHANCE = 0.1
"""Probability that two runs that are both off target agree."""

LEAST_TRACKED = 0.5
"""Below this probability of the better run, the straight line between the given boxes is taken."""


@dataclass(frozen=True)
class Mark:
    """A target in a frame of the annotations.

    Attributes:
        box: None where it is gone.
        how: given by a person (drawn or confirmed), tracked, interpolated between two given boxes, or gone.
        probability: of being on target (IoU above 0.5): 1 where given.
    """

    frame: int
    box: Box | None
    how: How
    probability: float = 1.0


def iou(one: Box, other: Box) -> float:
    """Intersection over union of two corner boxes."""
    wide = min(one[0] + one[2], other[0] + other[2]) - max(one[0], other[0])
    tall = min(one[1] + one[3], other[1] + other[3]) - max(one[1], other[1])
    if wide <= 0 or tall <= 0:
        return 0.0
    both = wide * tall
    return both / (one[2] * one[3] + other[2] * other[3] - both)


def between(one: Box, other: Box, share: float) -> Box:
    """The box at `share` of the way from one to the other."""
    x, y, w, h = ((1.0 - share) * a + share * b for a, b in zip(one, other, strict=True))
    return x, y, w, h


def fuse(frame: int, forward: Found, backward: Found, line: Box) -> Mark:
    """The more probable box of the two runs, or their mean where they agree.

    Of two runs that disagree at most one is on target; where they agree, either both are, or both went
    wrong alike, by chance. `line` is the straight line between the two given boxes: it is taken if no run
    is probable.
    """
    p, q = forward.probability, backward.probability
    if iou(forward.box, backward.box) > AGREE_IOU:
        right, wrong = p * q, BY_CHANCE * (1.0 - p) * (1.0 - q)
        box = between(forward.box, backward.box, q / (p + q) if p + q > 0 else 0.5)
        return Mark(frame, box, "tracked", _share(right, wrong))
    of_forward, of_backward, of_none = p * (1.0 - q), q * (1.0 - p), (1.0 - p) * (1.0 - q)
    best = max(of_forward, of_backward)
    probability = _share(best, of_forward + of_backward + of_none - best)
    if probability < LEAST_TRACKED:
        return Mark(frame, line, "interpolated", probability)
    return Mark(frame, (forward if of_forward >= of_backward else backward).box, "tracked", probability)


def _share(part: float, rest: float) -> float:
    return part / (part + rest) if part + rest > 0 else 0.0
