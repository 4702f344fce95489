"""What the numbers mean that a detection network gives: its layouts, each to boxes, scores and classes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats


class LayoutError(ValueError):
    """An output that is not of the layout."""


@dataclass(frozen=True, eq=False)
class Found:
    """A network's output.

    Attributes:
        boxes: (N, 4) x, y, w, h with the middle of the box, from the input's top-left edge.
        scores: (N,).
        classes: (N,) number of the class; -1 where there are none.
        distinguished: how many classes have a score of their own; None where the output does not tell.
    """

    boxes: Floats
    scores: Floats
    classes: NDArray[np.int64]
    distinguished: int | None = None


def rows(output: Floats) -> Found:
    """(N, 5) x, y, w, h, score."""
    table = _table(output, 5, 5, "rows of x, y, w, h, score")
    return Found(table[:, :4], table[:, 4], np.full(len(table), -1))


def yolo(output: Floats) -> Found:
    """(N, 4 + C) x, y, w, h and the score of each class, or its transpose."""
    return _best(_table(output, 5, None, "rows of x, y, w, h and a score for each class"))


def yolo_objectness(output: Floats) -> Found:
    """(N, 5 + C) x, y, w, h, score of any object, and that of each class given an object."""
    table = _table(output, 6, None, "rows of x, y, w, h, objectness and a score for each class")
    return _best(np.concatenate([table[:, :4], table[:, 5:] * table[:, 4:5]], axis=1))


STRIDES = (8, 16, 32)
"""Pixels of the input between the cells of each of YOLOX's grids, in the order of its rows."""


def from_grids(found: Found, width: int, height: int) -> Found:
    """Boxes of YOLOX in pixels of the input: given from their cell, in cells, the sides as logarithms.

    Raises:
        LayoutError: there are more or fewer rows than cells.
    """
    cells = []
    for stride in STRIDES:
        y, x = np.mgrid[: height // stride, : width // stride]
        cells.append(np.stack([x, y, np.full_like(x, stride)], axis=-1).reshape(-1, 3))
    grid = np.concatenate(cells).astype(np.float64)
    if len(grid) != len(found.boxes):
        raise LayoutError(
            f"gives {len(found.boxes)} rows; the layout wants {len(grid)}, one for each cell of an input of "
            f"{width}x{height} px with strides {', '.join(map(str, STRIDES))}"
        )
    side = grid[:, 2:]
    sides = np.exp(np.minimum(found.boxes[:, 2:], 20.0)) * side
    boxes = np.concatenate([(found.boxes[:, :2] + grid[:, :2]) * side, sides], axis=1)
    return replace(found, boxes=boxes)


def yolo_end_to_end(output: Floats) -> Found:
    """(N, 6) x0, y0, x1, y1, score, class: what is left after the network's own suppression."""
    table = _table(output, 6, 6, "rows of x0, y0, x1, y1, score, class")
    table = table[np.isfinite(table).all(axis=1)]
    return Found(_centred(table[:, :4]), table[:, 4], table[:, 5].astype(np.int64))


def ssd(output: Floats) -> Found:
    """(N, 7) image, class, score, x0, y0, x1, y1; rows of another image than 0 are left out."""
    table = _table(output, 7, 7, "rows of image, class, score, x0, y0, x1, y1")
    table = table[np.isfinite(table).all(axis=1) & (table[:, 0] == 0)]
    return Found(_centred(table[:, 3:]), table[:, 2], table[:, 1].astype(np.int64))


LAYOUTS: Mapping[str, Callable[[Floats], Found]] = MappingProxyType(
    {
        "rows": rows,
        "yolo": yolo,
        "yolo_objectness": yolo_objectness,
        "yolox": yolo_objectness,
        "yolo_end_to_end": yolo_end_to_end,
        "ssd": ssd,
    }
)


def fitting(outputs: Sequence[Floats], layout: str) -> Found:
    """What the one output says that is of the layout; raises LayoutError where none or several are."""
    found, refused = [], []
    for output in outputs:
        try:
            found.append(LAYOUTS[layout](output))
        except LayoutError as error:
            refused.append(error)
    if len(found) == 1:
        return found[0]
    if len(outputs) == 1:
        raise refused[0]
    shapes = ", ".join(_shape(output) for output in outputs)
    raise LayoutError(f"gives outputs of {shapes}; {len(found)} of them fit layout {layout}, one is needed")


def _best(table: Floats) -> Found:
    classes = table[:, 4:].argmax(axis=1)
    scores = table[np.arange(len(table)), 4 + classes]
    return Found(table[:, :4], scores, classes.astype(np.int64), table.shape[1] - 4)


def _centred(corners: Floats) -> Floats:
    """(N, 4) x0, y0, x1, y1 as x, y, w, h with the middle of the box."""
    low, high = corners[:, :2], corners[:, 2:]
    return np.concatenate([(low + high) / 2, high - low], axis=1)


def _shape(output: Floats) -> str:
    return " x ".join(str(side) for side in output.shape)


def _table(output: Floats, least: int, most: int | None, wanted: str) -> Floats:
    """The output as (N, columns), without sides of 1 in front, and turned where columns come first."""
    table = output
    while table.ndim > 2 and table.shape[0] == 1:
        table = table[0]
    if table.ndim == 2:
        fits = [least <= side and (most is None or side <= most) for side in table.shape]
        # With as many classes as may be, rows are the longer side: a network gives more boxes than classes.
        first = table.shape[0] < table.shape[1] if most is None else fits[0] and not fits[1]
        table = table.T if first and fits[0] else table
        if (fits[0] if first else fits[1]) or table.size == 0:
            return np.asarray(table)
    raise LayoutError(f"gives an output of {_shape(output)}; the layout wants {wanted}")
