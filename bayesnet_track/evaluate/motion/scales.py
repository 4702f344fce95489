"""Where each kind of parameter is searched for: on which scale, between which bounds, from which starts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from math import prod

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.evaluate.motion.parameters import Path
from bayesnet_track.numerics.arrays import Floats

REACH = 1000.0
"""Estimates are sought within this factor of where the search begins."""
LEAST_WEIGHT, MOST_WEIGHT = 0.001, 0.95
LEAST_FACTOR = 1.05
MOST_TRIED, MOST_STARTS = 5000, 300
FACTORS = {"sd": (1.0, 0.3, 3.0, 0.1, 10.0), "error": (1.0, 0.3, 3.0), "mean_frames": (1.0, 0.3, 3.0)}
"""Factors on the graph's own values at the starts. Every sd of a mode has the same one."""
VALUES = {"weight": (0.05, 0.3), "factor": (3.0, 10.0)}
"""Values at the starts, beside the graph's own."""


def places_of(paths: Sequence[Path], values: Floats) -> Floats:
    """Values (..., P) on the scales of the search: log odds of a share, logarithms of the rest."""
    with np.errstate(invalid="ignore", divide="ignore"):  # others than shares may be 1 or more
        return np.asarray(np.log(values) - np.where(_are_shares(paths), np.log1p(-values), 0.0))


def values_at(paths: Sequence[Path], places: Floats) -> Floats:
    """The values (..., P) at places."""
    with np.errstate(over="ignore"):
        return np.asarray(np.where(_are_shares(paths), 1.0 / (1.0 + np.exp(-places)), np.exp(places)))


def bounds_of(paths: Sequence[Path], first: Floats) -> tuple[Floats, Floats]:
    """Least and largest places: durations of at least a frame, tails that are wider and not all there is."""
    low, high = first - np.log(REACH), first + np.log(REACH)
    for k, path in enumerate(paths):
        if path[-1] == "mean_frames":
            low[k] = 0.0
        elif path[-1] == "factor":
            low[k] = np.log(LEAST_FACTOR)
        elif path[-1] == "weight":
            low[k], high[k] = places_of([path] * 2, np.array([LEAST_WEIGHT, MOST_WEIGHT]))
    return low, high


def starts_of(begin: Mapping[Path, float]) -> Floats:
    """(S, P) values from which the search may begin, the given ones first; at most `MOST_STARTS`.

    At each of them the sds of modes are in the order of the given ones: the graph alone says which mode is
    the calm one.
    """
    tried = [_tried(group, begin) for group in sorted({_group(path) for path in begin})]
    counts = [len(each) for each in tried]
    rng = np.random.default_rng(0)
    if prod(counts) <= MOST_TRIED:
        chosen = list(product(*map(range, counts)))
    else:
        chosen = [(0,) * len(counts), *rng.integers(0, counts, (MOST_TRIED, len(counts))).tolist()]
    rows = []
    for numbers in chosen:
        row = dict(begin)
        for each, number in zip(tried, numbers, strict=True):
            row |= each[number]
        if _order(row) == _order(begin):
            rows.append(list(row.values()))
    further = np.sort(1 + rng.permutation(len(rows) - 1)[: MOST_STARTS - 1])
    return np.array(rows)[[0, *further]]


def _group(path: Path) -> tuple[str, str]:
    """Kind of a parameter and, of an sd, its mode: what is in a group changes together at the starts."""
    if path[-1] in VALUES or path[-1] == "mean_frames":
        return path[-1], ""
    if path[0] == "error":
        return "error", ""
    return "sd", path[1] if path[0] == "modes" else ""


def _tried(group: tuple[str, str], begin: Mapping[Path, float]) -> list[dict[Path, float]]:
    """What a group's parameters are at the starts, as they are given first."""
    kind = group[0]
    own = {path: value for path, value in begin.items() if _group(path) == group}
    if kind in VALUES:
        return [own, *(dict.fromkeys(own, value) for value in VALUES[kind])]
    least = 1.0 if kind == "mean_frames" else 0.0
    return [{path: max(factor * value, least) for path, value in own.items()} for factor in FACTORS[kind]]


def _order(values: Mapping[Path, float]) -> dict[Path, list[str]]:
    """Key of an sd -> the modes that have it, from the smallest value on."""
    found: dict[Path, list[tuple[float, str]]] = {}
    for path, value in values.items():
        kind, mode = _group(path)
        if kind == "sd":
            key = path[4:] if path[0] == "modes" else path[2:]  # without the names of mode and motion
            found.setdefault(key, []).append((value, mode))
    return {key: [mode for _, mode in sorted(each)] for key, each in found.items()}


def _are_shares(paths: Sequence[Path]) -> NDArray[np.bool_]:
    return np.array([path[-1] == "weight" for path in paths])
