"""What pictures over frames share: round numbers on their scales, and stretches of frames."""

from __future__ import annotations

import math
from collections.abc import Sequence, Set

from bayesnet_track.journal.metrics import FrameMetrics


def ticks(first: int, last: int, most: int = 10) -> list[int]:
    """Round frame numbers, at most one more than `most`.

    >>> ticks(0, 199)
    [0, 20, 40, 60, 80, 100, 120, 140, 160, 180]
    """
    step = next(
        size * 10**power
        for power in range(19)
        for size in (1, 2, 5)
        if (last - first) / (size * 10**power) <= most
    )
    return list(range(-(-first // step) * step, last + 1, step))


def decades(low: float, high: float, most: int = 8) -> list[float]:
    """1, 2, 5 times powers of ten inside a scale; powers of ten alone when there would be too many.

    >>> decades(30.0, 1200.0)
    [50.0, 100.0, 200.0, 500.0, 1000.0]
    """
    exponents = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for steps in ((1, 2, 5), (1,)):
        found = [step * 10.0**e for e in exponents for step in steps if low <= step * 10.0**e <= high]
        if len(found) <= most:
            return found
    return found[:: math.ceil(len(found) / most)]


def stretches(lines: Sequence[FrameMetrics], wanted: Set[int]) -> list[tuple[int, int]]:
    """Stretches of consecutive lines whose frames are wanted, as first and last frame."""
    found: list[tuple[int, int]] = []
    previous = False
    for line in lines:
        if line.frame in wanted:
            first = found.pop()[0] if previous else line.frame
            found.append((first, line.frame))
        previous = line.frame in wanted
    return found
