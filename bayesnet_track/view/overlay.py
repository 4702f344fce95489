"""Drawings on a frame: estimates of targets, detections, and trajectories."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.numerics.arrays import Floats, Image
from bayesnet_track.numerics.boxes import corner_from_centre
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
    drawn = np.array(image, order="C")
    _draw(drawn, metrics, truth)
    return drawn


def _draw(drawn: Image, metrics: FrameMetrics, truth: ArrayLike | None = None) -> None:
    """Draw a target into an image of its own."""
    import cv2

    scale = min(max(min(drawn.shape[:2]) / 480.0, 0.5), 2.5)
    line = max(2, round(2 * scale))
    colour = STATUS_COLOUR.get(metrics.status, STATUS_COLOUR["tracking"])
    if metrics.cloud:
        _draw_cloud(drawn, [_corners(box[:4]) for box in metrics.cloud])
    if truth is not None and np.isfinite(np.asarray(truth, dtype=np.float64)).all():
        x, y, w, h = np.asarray(truth, dtype=np.float64)
        _dash(drawn, *_span((x, y), (x + w - 1, y + h - 1)), max(1, line - 1))
    for part in metrics.parts.values():
        if part.status == "seen":
            cv2.rectangle(drawn, *_corners(part.centre_box), PART_COLOUR, max(1, line - 1))
        else:
            _dash(drawn, *_corners(part.centre_box), max(1, line - 1), PART_COLOUR)
    low, high = _corners(metrics.centre_box)
    for step in range(-1, line):  # a dark rim outside, the colour on the box's own pixels
        if 2 * step <= min(high[0] - low[0], high[1] - low[1]):
            inner, outer = (low[0] + step, low[1] + step), (high[0] - step, high[1] - step)
            cv2.rectangle(drawn, inner, outer, DARK if step < 0 else colour, 1)
    if metrics.angle != 0.0:
        x, y, w, h = (float(np.clip(value, -REACH, 2 * REACH)) for value in metrics.centre_box)
        turned = np.rint(cv2.boxPoints(((x, y), (w, h), metrics.angle))).astype(np.int32)
        cv2.polylines(drawn, [turned], True, colour, 1)
    _label(drawn, metrics, low, high, colour, scale)


def _draw_cloud(drawn: Image, boxes: Sequence[tuple[Point, Point]]) -> None:
    """Draw rectangles that are half transparent, once for all that lie on each other."""
    import cv2

    corners = np.array(boxes)
    (x0, y0), (x1, y1) = np.maximum(corners.min((0, 1)), 0), np.maximum(corners.max((0, 1)) + 1, 0)
    part = drawn[y0:y1, x0:x1]
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
    drawn = np.array(image, order="C")
    for metrics in targets:
        _draw(drawn, metrics)
    return drawn


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

    head = f"{metrics.target} {metrics.status}  UD {_short(metrics.ud_px2)} px2"
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
        at = (x + pad, y + step * (number + 1) - step // 5)
        cv2.putText(image, text, at, font, size, ink, weight, cv2.LINE_AA)


def _fit(words: list[str], room: int, extent: Callable[[str], int]) -> str:
    """Words that fit, then how many are left out; a single word is cut."""
    for kept in range(len(words), 0, -1):
        rest = len(words) - kept
        text = ", ".join(words[:kept]) + (f" +{rest}" if rest else "")
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

    drawn = np.ascontiguousarray(image).copy()
    centres = np.rint(np.clip(boxes[:, :MOST_PATHS, :2], -REACH, REACH)).astype(np.int32)
    veil = drawn.copy()
    paths = [np.ascontiguousarray(path) for path in centres.swapaxes(0, 1)]
    cv2.polylines(veil, paths, False, PATH, 1, cv2.LINE_AA)
    drawn = cv2.addWeighted(veil, 0.55, drawn, 0.45, 0.0)
    for box in boxes[-1, :MOST_BOXES]:
        _rectangle(drawn, box, LAST, 1)
    _rectangle(drawn, boxes[0, 0], FIRST, 2)
    return np.asarray(drawn, dtype=np.uint8)


def _rectangle(image: Image, box: Floats, colour: tuple[int, int, int], width: int) -> None:
    import cv2

    x, y, w, h = (round(float(np.clip(value, -REACH, REACH))) for value in corner_from_centre(box))
    cv2.rectangle(image, (x, y), (x + w - 1, y + h - 1), colour, width)
