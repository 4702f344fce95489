"""Ground-truth files: one box a line, as the tracking benchmarks publish them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.sources.mot_lines import read_text


def read_truth(path: str | Path) -> Floats:
    """(n, 4) corner boxes x, y, w, h in px, row i for frame i; values are taken as they stand in the file.

    Numbers are separated by commas, tabs or spaces. Lines of 8 numbers are polygons (x1, y1, .. x4, y4),
    reduced to their axis-aligned bounding box. A row is all NaN where the target is absent: a value that is
    not finite, or a width or height of 0 or less.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is not text, a line is not 4 or 8 numbers, or the file holds no line; says file and
            line.
    """
    return parse_truth(read_text(path), str(path))


def parse_truth(text: str, name: str = "<truth>") -> Floats:
    """`read_truth` of a text; `name` stands in error messages.

    >>> parse_truth("1,2,3,4\\nNaN,NaN,NaN,NaN").tolist()
    [[1.0, 2.0, 3.0, 4.0], [nan, nan, nan, nan]]
    """
    lines = text.rstrip().splitlines()
    if not lines:
        raise ValueError(f"{name}: no boxes; expected one x,y,w,h per line")
    boxes = np.array([_box(line, f"{name}:{number}") for number, line in enumerate(lines, start=1)])
    absent = ~np.isfinite(boxes).all(axis=1) | (boxes[:, 2:] <= 0).any(axis=1)
    boxes[absent] = np.nan
    return boxes


def _box(line: str, place: str) -> list[float]:
    words = line.replace(",", " ").split()
    try:
        values = [float(word) for word in words]
    except ValueError:
        wrong = next(word for word in words if not _is_number(word))
        raise ValueError(f"{place}: {wrong[:40]!r} is not a number; expected x,y,w,h") from None
    if len(values) == 8:
        if not all(map(math.isfinite, values)):
            return [math.nan] * 4  # `min` and `max` would pass over a NaN that is not the first
        xs, ys = values[0::2], values[1::2]
        return [min(xs), min(ys), max(xs) - min(xs), max(ys) - min(ys)]
    if len(values) != 4:
        raise ValueError(f"{place}: {len(values)} numbers; expected 4 (x,y,w,h) or 8 (a polygon)")
    return values


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
