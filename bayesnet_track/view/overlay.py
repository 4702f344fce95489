"""Drawings on a frame: estimates, detections, trajectories, and the ground of a camera in metres."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.numerics.arrays import Floats, Image
from bayesnet_track.numerics.boxes import corner_from_centre
from bayesnet_track.numerics.cameras import CameraError
from bayesnet_track.numerics.outlines import GroundView
from bayesnet_track.observation.detector import Detections

Colour = tuple[int, int, int]
Point = tuple[int, int]

STATUS_COLOUR: dict[str, Colour] = {
    "tracking": (110, 230, 90),
    "uncertain": (60, 200, 250),
    "lost": (70, 70, 245),
    "hidden": (200, 130, 150),
}
CLOUD_COLOUR: Colour = (255, 215, 120)
TRUTH_COLOUR: Colour = (255, 255, 255)
PART_COLOUR: Colour = (250, 170, 240)
DARK: Colour = (24, 20, 18)
REACH = 8192


def draw_overlay(image: Image, metrics: FrameMetrics, truth: ArrayLike | None = None) -> Image:
    """A copy of the frame with the estimate, the cloud of hypotheses and a label.

    The estimate's colour says the status; the label says target, status, UD and active agents, and stays
    inside the picture. Line widths and letters grow with the picture. Parts have thin boxes of their own,
    dashed where they are not seen, which the label says, too.

    Args:
        image: (H, W, 3) uint8 BGR.
        metrics: one target's measurements in this frame.
        truth: corner box (4,) in px to draw dashed beside it; NaN or None draws none.
    """
    canvas = np.array(image, order="C")
    _draw(canvas, metrics, truth)
    return canvas


def _draw(canvas: Image, metrics: FrameMetrics, truth: ArrayLike | None = None) -> None:
    """Draw a target into an image of its own."""
    import cv2

    scale = min(max(min(canvas.shape[:2]) / 480.0, 0.5), 2.5)
    line = max(2, round(2 * scale))
    colour = STATUS_COLOUR.get(metrics.status, STATUS_COLOUR["tracking"])
    if metrics.cloud:
        _draw_cloud(canvas, [_corners(box[:4]) for box in metrics.cloud])
    if truth is not None and np.isfinite(np.asarray(truth, dtype=np.float64)).all():
        x, y, w, h = np.asarray(truth, dtype=np.float64)
        _dash(canvas, *_span((x, y), (x + w - 1, y + h - 1)), max(1, line - 1))
    for part in metrics.parts.values():
        if part.status == "seen":
            cv2.rectangle(canvas, *_corners(part.centre_box), PART_COLOUR, max(1, line - 1))
        else:
            _dash(canvas, *_corners(part.centre_box), max(1, line - 1), PART_COLOUR)
    low, high = _corners(metrics.centre_box)
    for step in range(-1, line):  # a dark rim outside, the colour on the box's own pixels
        if 2 * step <= min(high[0] - low[0], high[1] - low[1]):
            inner, outer = (low[0] + step, low[1] + step), (high[0] - step, high[1] - step)
            cv2.rectangle(canvas, inner, outer, DARK if step < 0 else colour, 1)
    if metrics.angle != 0.0:
        x, y, w, h = (float(np.clip(value, -REACH, 2 * REACH)) for value in metrics.centre_box)
        turned = np.rint(cv2.boxPoints(((x, y), (w, h), metrics.angle))).astype(np.int32)
        cv2.polylines(canvas, [turned], True, colour, 1)
    _label(canvas, metrics, low, high, colour, scale)


def _draw_cloud(canvas: Image, boxes: Sequence[tuple[Point, Point]]) -> None:
    """Draw rectangles that are half transparent, once for all that lie on each other."""
    import cv2

    corners = np.array(boxes)
    (x0, y0), (x1, y1) = np.maximum(corners.min((0, 1)), 0), np.maximum(corners.max((0, 1)) + 1, 0)
    part = canvas[y0:y1, x0:x1]
    if part.size == 0:
        return
    veil = part.copy()
    for (left, top), (right, bottom) in boxes:
        cv2.rectangle(
            veil, (left - int(x0), top - int(y0)), (right - int(x0), bottom - int(y0)), CLOUD_COLOUR, 1
        )
    part[:] = cv2.addWeighted(veil, 0.45, part, 0.55, 0.0)


def draw_targets(image: Image, targets: Iterable[FrameMetrics]) -> Image:
    """A copy of the BGR frame with every target as in `draw_overlay`."""
    canvas = np.array(image, order="C")
    for metrics in targets:
        _draw(canvas, metrics)
    return canvas


def _corners(centre_box: Sequence[float]) -> tuple[Point, Point]:
    """First and last pixel of a centre box."""
    x, y, w, h = corner_from_centre(centre_box)
    return _span((x, y), (x + w - 1, y + h - 1))


def _span(low: tuple[float, float], high: tuple[float, float]) -> tuple[Point, Point]:
    """Rounded to pixels, kept where OpenCV's fixed-point drawing cannot overflow."""
    a, b, c, d = (int(np.clip(np.rint(value), -REACH, 2 * REACH)) for value in (*low, *high))
    return (a, b), (c, d)


def _dash(image: Image, low: Point, high: Point, thickness: int, colour: Colour = TRUTH_COLOUR) -> None:
    import cv2

    dash = 4 * thickness
    (x0, y0), (x1, y1) = low, high
    height, width = image.shape[:2]
    for x in range(max(x0, -dash), min(x1, width), 2 * dash):
        for y in (y0, y1):
            cv2.line(image, (x, y), (min(x + dash, x1), y), colour, thickness)
    for y in range(max(y0, -dash), min(y1, height), 2 * dash):
        for x in (x0, x1):
            cv2.line(image, (x, y), (x, min(y + dash, y1)), colour, thickness)


def _label(
    image: Image, metrics: FrameMetrics, low: Point, high: Point, colour: Colour, scale: float
) -> None:
    """Two or three lines on a dark plate: above the box where there is room, else below it, else over it."""
    import cv2

    height, width = image.shape[:2]
    font, size, weight = cv2.FONT_HERSHEY_SIMPLEX, max(0.4, 0.5 * scale), max(1, round(scale))
    pad = max(2, round(4 * scale))
    room = width - 2 * pad

    def extent(text: str) -> int:
        return int(cv2.getTextSize(text, font, size, weight)[0][0])

    head = f"{metrics.target} {metrics.status}  UD {_short(metrics.ud_px2)} {metrics.ud_unit[:-1]}2"
    lines = [_fit([head], room, extent), _fit(list(metrics.active) or ["no agent"], room, extent)]
    unseen = [f"{name} {part.status}" for name, part in metrics.parts.items() if part.status != "seen"]
    lines += [_fit(unseen, room, extent)] if unseen else []
    likeliest = [f"{metrics.mode} {metrics.modes[metrics.mode]:.2f}"] if metrics.modes else []
    lines += [_fit(likeliest, room, extent)] if likeliest else []
    step = round(cv2.getTextSize("Ag", font, size, weight)[0][1] * 1.6)
    plate_w, plate_h = max(map(extent, lines)) + 2 * pad, step * len(lines) + pad
    x = min(max(low[0], 0), max(width - plate_w, 0))
    y = low[1] - plate_h - pad
    if y < 0:
        y = high[1] + pad
    y = min(max(y, 0), max(height - plate_h, 0))
    plate = image[y : y + plate_h, x : x + plate_w]
    plate[:] = (plate * 0.3 + np.array(DARK) * 0.7).astype(np.uint8)
    for number, text in enumerate(lines):
        ink = colour if number == 0 else (235, 235, 235)
        position = (x + pad, y + step * (number + 1) - step // 5)
        cv2.putText(image, text, position, font, size, ink, weight, cv2.LINE_AA)


def _fit(words: list[str], room: int, extent: Callable[[str], int]) -> str:
    """Words that fit, then how many are left out; a single word is cut."""
    for count in range(len(words), 0, -1):
        omitted = len(words) - count
        text = ", ".join(words[:count]) + (f" +{omitted}" if omitted else "")
        if extent(text) <= room:
            return text
    text = words[0]
    while len(text) > 1 and extent(text + "..") > room:
        text = text[:-1]
    return text + ".."


def _short(value: float) -> str:
    if not np.isfinite(value):
        return "?"
    return f"{value:.3g}" if value < 1000 else f"{value:.0f}" if value < 1e6 else f"{value:.0e}"


def draw_detections(image: Image, detections: Detections) -> Image:
    """A copy of the picture with the boxes, their scores and labels."""
    import cv2

    picture = np.ascontiguousarray(image).copy()
    for box, score, label in zip(
        corner_from_centre(detections.boxes), detections.scores, detections.labels, strict=True
    ):
        x, y, w, h = (round(float(value)) for value in np.clip(box, -8192, 8192))
        shade = round(90 + 165 * float(score))
        cv2.rectangle(picture, (x, y), (x + w - 1, y + h - 1), (0, shade, shade), 2)
        text = f"{score:.2f} {label}".strip()
        cv2.putText(picture, text, (x, max(y - 4, 10)), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (0, shade, shade), 1)
    return np.asarray(picture, dtype=np.uint8)


PATH, LAST, FIRST = (255, 215, 120), (60, 200, 250), (110, 230, 90)
MOST_PATHS, MOST_BOXES = 200, 12


def draw_trajectories(image: Image, boxes: Floats) -> Image:
    """A copy of the BGR frame with the centres' paths, some last boxes, and the first box on top.

    Args:
        image: (H, W, 3) uint8 BGR.
        boxes: (T, N, 4) centre boxes of N trajectories.
    """
    import cv2

    canvas = np.ascontiguousarray(image).copy()
    centres = np.rint(np.clip(boxes[:, :MOST_PATHS, :2], -REACH, REACH)).astype(np.int32)
    veil = canvas.copy()
    paths = [np.ascontiguousarray(path) for path in centres.swapaxes(0, 1)]
    cv2.polylines(veil, paths, False, PATH, 1, cv2.LINE_AA)
    canvas = cv2.addWeighted(veil, 0.55, canvas, 0.45, 0.0)
    for box in boxes[-1, :MOST_BOXES]:
        _rectangle(canvas, box, LAST, 1)
    _rectangle(canvas, boxes[0, 0], FIRST, 2)
    return np.asarray(canvas, dtype=np.uint8)


def _rectangle(image: Image, box: Floats, colour: tuple[int, int, int], width: int) -> None:
    import cv2

    x, y, w, h = (round(float(np.clip(value, -REACH, REACH))) for value in corner_from_centre(box))
    cv2.rectangle(image, (x, y), (x + w - 1, y + h - 1), colour, width)


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
    is_ground = np.isfinite(ground).all(axis=1)
    if not is_ground.any():
        raise CameraError("the image shows no ground: all of it is above the horizon")
    nearest = view.ground_points(np.array([[(width - 1) / 2, height - 1.0]]))[0]
    if not np.isfinite(nearest).all():
        nearest = np.median(ground[is_ground], axis=0)
    near_points = ground[is_ground & (np.hypot(*(ground - nearest).T) < FARTHEST_M)]
    near_points = near_points if len(near_points) else ground[is_ground][:1]
    return np.percentile(near_points, 3, axis=0), np.percentile(near_points, 97, axis=0)


def spacing_of(low: Floats, high: Floats) -> float:
    """Distance of the grid's lines, m: 1, 2 or 5 times a power of ten.

    >>> spacing_of(np.array([0.0, 0.0]), np.array([30.0, 12.0]))
    2.0
    """
    ideal = max(float((high - low).max()) / LINES, 1e-6)
    power = 10.0 ** math.floor(math.log10(ideal))
    return next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= ideal * 0.999)


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
    is_inside = _is_visible(pixels, width, height)
    for (x, y), pixel in zip(spots[is_inside], pixels[is_inside], strict=True):
        position = (int(pixel[0]) + 3, int(pixel[1]) - 3)
        for colour, thick in (((0, 0, 0), 3), ((255, 255, 255), 1)):
            cv2.putText(
                canvas, f"{x:g},{y:g}", position, cv2.FONT_HERSHEY_SIMPLEX, 0.4, colour, thick, cv2.LINE_AA
            )
    _draw_people(canvas, view, spots[is_inside])
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
        position = (round(measured[0]), round(measured[1]))
        cv2.drawMarker(canvas, position, POINT, cv2.MARKER_TILTED_CROSS, 11, 2)
        if np.isfinite(expected).all():
            cv2.line(canvas, position, (round(expected[0]), round(expected[1])), AXIS, 1, cv2.LINE_AA)
            cv2.circle(canvas, (round(expected[0]), round(expected[1])), 5, AXIS, 1, cv2.LINE_AA)
    return np.asarray(np.hypot(*(pixels - numbers[:, :2]).T))


def _is_visible(pixels: Floats, width: int, height: int) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    with np.errstate(invalid="ignore"):
        return np.asarray((pixels >= 0).all(axis=1) & (pixels[:, 0] < width) & (pixels[:, 1] < height))


def _draw_path(canvas: Image, pixels: Floats, colour: tuple[int, int, int]) -> None:
    """Lines between neighbours that are both near the image."""
    import cv2

    height, width = canvas.shape[:2]
    with np.errstate(invalid="ignore"):
        is_near = (np.abs(pixels - [width / 2, height / 2]) < 2 * max(width, height)).all(axis=1)
    for start, end, is_drawn in zip(pixels[:-1], pixels[1:], is_near[:-1] & is_near[1:], strict=True):
        if is_drawn:
            a, b = ((round(p[0]), round(p[1])) for p in (start, end))
            cv2.line(canvas, a, b, colour, 1, cv2.LINE_AA)
