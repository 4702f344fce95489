"""Several runs that differ only in their seed, as one summary: means with intervals."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

Cell = str | int | float | None


@dataclass(frozen=True)
class Spread:
    """A measure over seeds.

    Attributes:
        seeds: how many seeds have it.
        mean: over them.
        low: lower end of the 95 % interval of the mean (Student's t), None of a single seed.
        high: its upper end.
        least: the smallest.
        most: the largest.
    """

    seeds: int
    mean: float
    low: float | None
    high: float | None
    least: float
    most: float


def spread_of(values: Sequence[float], confidence: float = 0.95) -> Spread:
    """How values, one per seed, are spread; at least one.

    The interval is that of the mean over seeds, as if the values were normal, and for these videos only.

    >>> one = spread_of([1.0, 2.0, 3.0])
    >>> one.mean, round(one.low, 3), round(one.high, 3)
    (2.0, -0.484, 4.484)
    """
    count, mean = len(values), math.fsum(values) / len(values)
    low = high = None
    if count > 1:
        from scipy.special import stdtrit

        variance = math.fsum((value - mean) ** 2 for value in values) / (count - 1)
        reach = float(stdtrit(count - 1, 0.5 + confidence / 2)) * math.sqrt(variance / count)
        low, high = mean - reach, mean + reach
    return Spread(count, mean, low, high, min(values), max(values))


def spread_over_seeds(rows: Iterable[Mapping[str, Cell]], names: Sequence[str]) -> dict[str, Spread]:
    """The measures `names` of rows with a `seed`; rows of one seed, such as its videos, count by their mean.

    Only videos that every seed has count, so that seeds are compared over the same ones.
    """
    told = list(rows)
    seeds = {row["seed"] for row in told}
    found = {}
    for name in names:
        by_video: dict[Cell, dict[Cell, float]] = defaultdict(dict)
        for row in told:
            value = row.get(name)
            if isinstance(value, int | float):
                by_video[row.get("video")][row["seed"]] = float(value)
        whole = [one for one in by_video.values() if one.keys() == seeds]
        if whole:
            means = [math.fsum(one[seed] for one in whole) / len(whole) for seed in sorted(seeds, key=str)]
            found[name] = spread_of(means)
    return found


def spread_text(spreads: Mapping[str, Spread]) -> str:
    """A table of them, one line each."""
    lines = [f"{'':18}{'mean':>10}  {'95 % interval':22}{'smallest':>10}{'largest':>10}"]
    for name, one in spreads.items():
        interval = "" if one.low is None else f"{one.low:.4g} to {one.high:.4g}"
        lines.append(f"{name:18}{one.mean:>10.4g}  {interval:22}{one.least:>10.4g}{one.most:>10.4g}")
    return "\n".join(lines)
