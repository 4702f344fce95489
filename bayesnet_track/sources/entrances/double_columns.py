"""Columns of a header line that say the same thing twice, or seem to: they agree, or the file is refused."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.sources.entrances.boxes import usable
from bayesnet_track.sources.entrances.column_names import Layout
from bayesnet_track.sources.entrances.notices import notice

ROUNDED_PX = 1.5
"""Corners that are rounded, or that count the last pixel, differ by less from left + width."""
REACH = 1.1
"""Boxes reach so far, in parts of the image, where a column is the image's size."""

NumberedRow = tuple[int, Sequence[str]]
"""The number of a line, and its words."""


def corner_boxes(box: Floats, sizes: Floats, numbers: Sequence[int], name: str) -> Floats:
    """Boxes left, top, width, height (N, 4) of corners (N, 4), where width and height (N, 2) stand beside.

    Width and height are those of the boxes, or of the image, as in CSV files of TensorFlow's object
    detection. Corners that are parts of the image are then multiplied by its size.

    Raises:
        ValueError: they can be neither; says both readings.

    >>> corner_boxes(np.array([[30.0, 40, 60, 80]]), np.array([[30.0, 40]]), [2], "a.csv").tolist()
    [[30.0, 40.0, 30.0, 40.0]]
    """
    spans = box[:, 2:] - box[:, :2]
    found = np.column_stack([box[:, :2], spans])
    with np.errstate(invalid="ignore", over="ignore"):
        held = usable(found) & np.all(sizes > 0, axis=1)
        is_box = np.all(np.abs(spans - sizes) <= ROUNDED_PX, axis=1)
        fits = np.all((box[:, 2:] <= REACH * sizes) & (box[:, :2] < sizes), axis=1)
    if not held.any() or is_box[held].all():
        return found
    wrong = np.flatnonzero(held & ~is_box)
    if fits[held].mean() < 0.9:
        row = int(next((one for one in wrong if not fits[one]), wrong[0]))
        left, top, right, bottom = box[row]
        raise ValueError(
            f"{name}:{numbers[row]}: the columns fit two readings: corners ({left:g},{top:g} to "
            f"{right:g},{bottom:g}: {spans[row, 0]:g}x{spans[row, 1]:g} px), and left, top, width, height "
            f"({sizes[row, 0]:g}x{sizes[row, 1]:g} px); remove the columns of one of them"
        )
    known = sorted({(w, h) for w, h in sizes[held].tolist()})
    shown = f"{known[0][0]:g}x{known[0][1]:g} px" + (f" and {len(known) - 1} more" if known[1:] else "")
    said = f"{name}: boxes are read by their corners; width and height are the size of the image ({shown})"
    shares = bool((box[held] <= 1).all() and (box[held] >= 0).all() and (box[held] % 1 != 0).any())
    notice(f"{said}, and corners, which are from 0 to 1, are multiplied by it" if shares else said)
    return found * np.tile(sizes, 2) if shares else found


def check_rivals(layout: Layout, rows: Sequence[NumberedRow], name: str) -> None:
    """Raise ValueError where two columns say differently which frame or which target a row is of."""
    for (read, at), (other, beside) in layout.rivals:
        pairs = [(words[at].strip(), words[beside].strip()) for _, words in rows]
        known = dict(pairs)
        back = {second: first for first, second in pairs}
        if len(known) != len(set(pairs)) or len(back) != len(set(pairs)):
            line = next(
                number
                for (number, _), (first, second) in zip(rows, pairs, strict=True)
                if known[first] != second or back[second] != first
            )
            raise ValueError(
                f"{name}:{line}: the header fits two readings: the columns {read!r} and {other!r} part the "
                "rows in different ways; remove the one that is not meant, or rename it"
            )
