"""Ground of a camera drawn over its image: a grid in metres, people for scale, and residuals of points."""

from __future__ import annotations

import math

import numpy as np

from bayesnet_track.numerics.arrays import Floats, Image
from bayesnet_track.numerics.cameras import CameraError, GroundView

FARTHEST_M = 80.0
LINES = 24
"""About so many lines of the grid each way."""
PERSON = (0.6, 1.7)
"""Width and height of the people drawn for scale, m."""
GRID, AXIS, BODY, POINT = (90, 220, 90), (60, 60, 255), (255, 200, 60), (0, 220, 255)


def visible_ground(view: GroundView, width: int, height: int) -> tuple[Floats, Floats]:
    """Least and greatest x, y, m, of the ground in the image, up to 80 m from its nearest point.

    Raises:
        CameraError: the image shows no ground.
    """
    columns, rows = np.meshgrid(np.linspace(0, width - 1, 80), np.linspace(0, height - 1, 80))
    ground = view.ground_points(np.column_stack([columns.ravel(), rows.ravel()]))
    seen = np.isfinite(ground).all(axis=1)
    if not seen.any():
        raise CameraError("the image shows no ground: all of it is above the horizon")
    nearest = view.ground_points(np.array([[(width - 1) / 2, height - 1.0]]))[0]
    if not np.isfinite(nearest).all():
        nearest = np.median(ground[seen], axis=0)
    close = ground[seen & (np.hypot(*(ground - nearest).T) < FARTHEST_M)]
    close = close if len(close) else ground[seen][:1]
    return np.percentile(close, 3, axis=0), np.percentile(close, 97, axis=0)


def spacing_of(low: Floats, high: Floats) -> float:
    """Distance of the grid's lines, m: 1, 2 or 5 times a power of ten.

    >>> spacing_of(np.array([0.0, 0.0]), np.array([30.0, 12.0]))
    2.0
    """
    wanted = max(float((high - low).max()) / LINES, 1e-6)
    power = 10.0 ** math.floor(math.log10(wanted))
    return next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= wanted * 0.999)


def draw_ground(image: Image, view: GroundView) -> tuple[Image, float]:
    """A copy of the image (H, W, 3) with the grid, its axes, numbers and people; and the grid's spacing, m.

    People are 0.6 m across and 1.7 m high; a camera of which no heights are known has none.

    Raises:
        CameraError: the image shows no ground.
    """
    import cv2

    height, width = image.shape[:2]
    low, high = visible_ground(view, width, height)
    step = spacing_of(low, high)
    canvas = image.copy()
    xs, ys = (
        np.arange(np.floor(a / step), np.ceil(b / step) + 1) * step for a, b in zip(low, high, strict=True)
    )
    for along, values, ends in ((1, xs, ys), (0, ys, xs)):
        for value in values:
            path = np.linspace(ends[0], ends[-1], 400)
            line = np.column_stack([np.full(400, value), path] if along else [path, np.full(400, value)])
            _draw_path(canvas, view.project(np.column_stack([line, np.zeros(400)])), GRID if value else AXIS)
    spots = np.array([[x, y] for x in xs[1::4] for y in ys[1::4]])
    pixels = view.project(np.column_stack([spots, np.zeros(len(spots))]))
    inside = _inside(pixels, width, height)
    for (x, y), pixel in zip(spots[inside], pixels[inside], strict=True):
        at = (int(pixel[0]) + 3, int(pixel[1]) - 3)
        for colour, thick in (((0, 0, 0), 3), ((255, 255, 255), 1)):
            cv2.putText(canvas, f"{x:g},{y:g}", at, cv2.FONT_HERSHEY_SIMPLEX, 0.4, colour, thick, cv2.LINE_AA)
    _draw_people(canvas, view, spots[inside])
    return canvas, step


def _draw_people(canvas: Image, view: GroundView, spots: Floats) -> None:
    import cv2

    try:
        boxes = view.boxes(np.column_stack([spots, np.broadcast_to(PERSON, (len(spots), 2))]))
    except CameraError:
        return
    for x, y, w, h in boxes[np.isfinite(boxes).all(axis=1)]:
        if 6 < h < canvas.shape[0] / 2:
            corner = (round(x - w / 2), round(y - h / 2)), (round(x + w / 2), round(y + h / 2))
            cv2.rectangle(canvas, *corner, BODY, 1)


def draw_points(canvas: Image, view: GroundView, numbers: Floats) -> Floats:
    """Draw points (N, 4) px, py, x, y: a cross where they were measured, a line to where the camera has them.

    Returns (N,) distances in px.
    """
    import cv2

    pixels = view.project(np.column_stack([numbers[:, 2:], np.zeros(len(numbers))]))
    for measured, expected in zip(numbers[:, :2], pixels, strict=True):
        at = (round(measured[0]), round(measured[1]))
        cv2.drawMarker(canvas, at, POINT, cv2.MARKER_TILTED_CROSS, 11, 2)
        if np.isfinite(expected).all():
            cv2.line(canvas, at, (round(expected[0]), round(expected[1])), AXIS, 1, cv2.LINE_AA)
            cv2.circle(canvas, (round(expected[0]), round(expected[1])), 5, AXIS, 1, cv2.LINE_AA)
    return np.asarray(np.hypot(*(pixels - numbers[:, :2]).T))


def _inside(pixels: Floats, width: int, height: int) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    with np.errstate(invalid="ignore"):
        return np.asarray((pixels >= 0).all(axis=1) & (pixels[:, 0] < width) & (pixels[:, 1] < height))


def _draw_path(canvas: Image, pixels: Floats, colour: tuple[int, int, int]) -> None:
    """Lines between neighbours that are both near the image."""
    import cv2

    height, width = canvas.shape[:2]
    with np.errstate(invalid="ignore"):
        near = (np.abs(pixels - [width / 2, height / 2]) < 2 * max(width, height)).all(axis=1)
    for one, other, is_drawn in zip(pixels[:-1], pixels[1:], near[:-1] & near[1:], strict=True):
        if is_drawn:
            a, b = ((round(p[0]), round(p[1])) for p in (one, other))
            cv2.line(canvas, a, b, colour, 1, cv2.LINE_AA)
