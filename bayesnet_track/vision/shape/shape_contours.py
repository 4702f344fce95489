"""The chain from edges to shape vectors: snake, closed spline, signed distance, grid (thesis Figure 3.8)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesnet_track.numerics.arrays import Array, Floats, Ints

REACH = 0.25
"""How far a snake's point sees an edge, in mean sides of the box."""

TOLERANCE = 0.05
"""How far from an edge a snake's point still counts as on it, in mean sides of the box (1.5 px at least)."""

CURVE_POINTS = 80
"""Corners of the polygon that stands for the spline: two for each control point."""

FIELD_POINTS = 24
"""Points per side of a signed-distance field."""

COVER = 1.5
"""A field covers its box grown by this factor."""


@dataclass(frozen=True, eq=False)
class Contours:
    """Closed contours, one for each box.

    Attributes:
        boxes: (C, 4) the centre boxes that the snakes started from.
        snakes: (C, M, 2) points of the snakes, frame px.
        controls: (C, 40, 2) control points of the closed uniform cubic B-splines.
        curves: (C, P, 2) points on the splines.
        support: (C,) share of each snake on edges inside the frame, 0..1.
    """

    boxes: Floats
    snakes: Floats
    controls: Floats
    curves: Floats
    support: Floats


def contours(points: Ints, boxes: Floats, frame: Ints) -> Contours:
    """A contour for each centre box (C, 4) from the edge pixels (E, 2) of a frame of (width, height) px.

    Each depends on its own box and the edges only, not on the other boxes.
    """
    from bayesnet_track.vision.kernels.shape_kernels import map_points
    from bayesnet_track.vision.shape import shape_snake
    from bayesnet_track.vision.shape.shape_spline import CONTROL_POINTS, curve_matrix, fit_matrix

    boxes = np.ascontiguousarray(boxes, dtype=np.float64)
    count = len(boxes)
    snakes, support = np.empty((count, shape_snake.POINTS, 2)), np.zeros(count)
    distance, origin = _distances(points, boxes, frame)
    steps = np.array([stage[2] for stage in shape_snake.STAGES], dtype=np.int64)
    shape_snake.run_snakes(
        distance,
        origin,
        np.asarray(frame, dtype=np.int64),
        boxes,
        shape_snake.smoothing_filters(),
        steps,
        REACH,
        TOLERANCE,
        snakes,
        support,
    )
    controls, curves = np.empty((count, CONTROL_POINTS, 2)), np.empty((count, CURVE_POINTS, 2))
    # a kernel: the sums of a BLAS for one contour may depend on how many there are
    map_points(fit_matrix(shape_snake.POINTS), snakes, controls)
    map_points(curve_matrix(CURVE_POINTS), controls, curves)
    return Contours(boxes, snakes, controls, curves, support)


def fields(found: Contours) -> Floats:
    """(C, S, S) signed distance in px to each contour around its box grown by `COVER`; negative inside."""
    from bayesnet_track.vision.kernels.shape_kernels import cell_fields

    values = np.empty((len(found.boxes), FIELD_POINTS, FIELD_POINTS))
    cell_fields(found.curves, found.boxes, COVER, values)
    return values


def _distances(points: Ints, boxes: Floats, frame: Ints) -> tuple[Array, Ints]:
    """(rows, columns) float64 px to the nearest edge pixel where the snakes may look, and its origin.

    Exact up to the largest reach: edges beyond the window are further away than any snake looks.
    """
    import cv2

    from bayesnet_track.vision.shape.shape_snake import BOUND

    side = np.sqrt(boxes[:, 2] * boxes[:, 3])
    # a snake's bound, what it sees from there, and twice the tolerance, with room for the gradient
    room = (
        0.5 * BOUND * boxes[:, 2:] + np.maximum(REACH * side, np.maximum(2 * TOLERANCE * side, 3.0))[:, None]
    )
    low = np.floor((boxes[:, :2] - room).min(axis=0)).astype(np.int64) - 3
    high = np.ceil((boxes[:, :2] + room).max(axis=0)).astype(np.int64) + 4
    low, high = np.clip(low, 0, frame - 1), np.clip(high, 1, frame)
    high = np.maximum(high, low + 1)
    inside = ((points >= low) & (points < high)).all(axis=1)
    x, y = (points[inside] - low).T
    free = np.full((high[1] - low[1], high[0] - low[0]), 255, dtype=np.uint8)
    free[y, x] = 0
    if len(x) == 0:
        return np.full(free.shape, 1e6), low
    distance = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    # OpenCV's last bits depend on its threads; the squares are whole numbers
    return np.sqrt(np.rint(np.square(distance, dtype=np.float64))), low


def mask_edges(mask: Array) -> Ints:
    """(E, 2) x, y of the pixels of a mask (H, W) next to its outside; the picture's rim is outside."""
    import cv2

    inside = (np.asarray(mask) > 0).astype(np.uint8)
    core = cv2.erode(inside, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0)
    y, x = np.nonzero(inside & ~core & 1)
    return np.column_stack([x, y]).astype(np.int64)


def mask_box(mask: Array) -> Floats:
    """(4,) the centre box around all pixels of a mask (H, W) above 0.

    Raises:
        ValueError: there is none.
    """
    y, x = np.nonzero(np.asarray(mask))
    if len(x) == 0:
        raise ValueError("the mask is empty")
    left, top, right, bottom = x.min(), y.min(), x.max(), y.max()
    return np.array([(left + right) / 2, (top + bottom) / 2, right - left + 1, bottom - top + 1], np.float64)


def vectors(found: Contours, boxes: Floats, grid: int) -> Floats:
    """(C, grid * grid) shape vector of each contour in a box (C, 4) near its own; rows top to bottom."""
    from bayesnet_track.vision.kernels.shape_kernels import shape_vector

    values = np.empty((len(boxes), grid * grid))
    for field, cell, box, vector in zip(fields(found), found.boxes, boxes, values, strict=True):
        shape_vector(field, cell, COVER, np.asarray(box, dtype=np.float64), vector)
    return values
