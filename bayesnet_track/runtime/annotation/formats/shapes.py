"""Upright boxes of what other tools draw: rotated boxes, polygons, ellipses, masks."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from bayesnet_track.runtime.annotation.answers import Box

LONGEST_RLE = 1 << 27
"""Characters or counts of a mask, far beyond any frame."""


def box_around(points: Sequence[tuple[float, float]]) -> Box:
    """The smallest upright box with all points in it; NaN where a coordinate is not finite.

    >>> box_around([(3.0, 1.0), (1.0, 2.0), (2.0, 7.0)])
    (1.0, 1.0, 2.0, 6.0)
    """
    if not points or not all(math.isfinite(value) for point in points for value in point):
        return (math.nan,) * 4
    xs, ys = [x for x, _ in points], [y for _, y in points]
    return min(xs), min(ys), max(xs) - min(xs), max(ys) - min(ys)


def pairs(values: Iterable[float]) -> list[tuple[float, float]]:
    """Points of x, y, x, y, ...; raises ValueError where one has no y."""
    found = list(values)
    return list(zip(found[::2], found[1::2], strict=True))


def turned_box(box: Box, degrees: float, corner: bool = False) -> Box:
    """The upright box around `box` turned clockwise about its centre, or about its top-left corner.

    >>> [round(value, 3) for value in turned_box((10.0, 10.0, 20.0, 10.0), 90.0)]
    [15.0, 5.0, 10.0, 20.0]
    >>> [round(value, 3) for value in turned_box((10.0, 10.0, 20.0, 10.0), 90.0, corner=True)]
    [0.0, 10.0, 10.0, 20.0]
    """
    x, y, w, h = box
    if not all(map(math.isfinite, (*box, degrees))):
        return (math.nan,) * 4
    if w <= 0 or h <= 0:
        return box
    cx, cy = (x, y) if corner else (x + w / 2, y + h / 2)
    sine, cosine = math.sin(math.radians(degrees)), math.cos(math.radians(degrees))
    corners = [(x, y), (x + w, y), (x + w, y + h), (x, y + h)]
    return box_around(
        [
            (cx + cosine * (px - cx) - sine * (py - cy), cy + sine * (px - cx) + cosine * (py - cy))
            for px, py in corners
        ]
    )


def ellipse_box(centre: tuple[float, float], radii: tuple[float, float], degrees: float) -> Box:
    """The upright box around an ellipse turned clockwise about its centre.

    >>> [round(value, 3) for value in ellipse_box((10.0, 10.0), (4.0, 2.0), 90.0)]
    [8.0, 6.0, 4.0, 8.0]
    """
    (cx, cy), (rx, ry) = centre, radii
    if not all(map(math.isfinite, (cx, cy, rx, ry, degrees))):
        return (math.nan,) * 4
    sine, cosine = math.sin(math.radians(degrees)), math.cos(math.radians(degrees))
    w, h = math.hypot(rx * cosine, ry * sine), math.hypot(rx * sine, ry * cosine)
    return cx - w, cy - h, 2 * w, 2 * h


def mask_box(counts: str | Sequence[int], height: int) -> Box:
    """The box around a mask in COCO's run-length code: columns from the left, runs of 0 and 1 in turn.

    `counts` are the runs, or COCO's compressed text of them. Raises ValueError where they are neither.

    >>> mask_box([1, 2, 2, 2, 13], height=5)
    (0.0, 0.0, 2.0, 3.0)
    >>> mask_box("1220;", height=5)
    (0.0, 0.0, 2.0, 3.0)
    """
    runs = _runs(counts) if isinstance(counts, str) else counts
    if height < 1 or any(type(run) is not int or run < 0 for run in runs):
        raise ValueError("the runs of a mask are whole numbers from 0, its height is above 0")
    at, left, right, top, bottom = 0, math.inf, -math.inf, math.inf, -math.inf
    for number, run in enumerate(runs):
        if number % 2 and run:
            first, last = divmod(at, height), divmod(at + run - 1, height)
            left, right = min(left, first[0]), max(right, last[0])
            whole = first[0] != last[0]  # it goes on in the next column, and so touches both ends
            top = min(top, 0 if whole else first[1])
            bottom = max(bottom, height - 1 if whole else last[1])
        at += run
    if left > right:
        return (math.nan,) * 4
    return float(left), float(top), float(right - left + 1), float(bottom - top + 1)


def _runs(text: str) -> list[int]:
    """COCO's text: 5 bits a character, lowest first; from the fourth on, differences to the last but one."""
    runs: list[int] = []
    at = 0
    while at < min(len(text), LONGEST_RLE):
        value, shift, more = 0, 0, True
        while more:
            if at >= len(text) or not 48 <= ord(text[at]) < 112:
                raise ValueError("the text of a mask is damaged")
            bits = ord(text[at]) - 48
            value |= (bits & 31) << shift
            more, shift, at = bool(bits & 32), shift + 5, at + 1
            if not more and bits & 16:
                value |= -1 << shift
        runs.append(value + runs[-2] if len(runs) > 2 else value)
    return runs
