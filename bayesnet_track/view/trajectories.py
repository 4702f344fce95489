"""Draw trajectories onto the frame in which they start."""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Floats, Image
from bayesnet_track.numerics.boxes import corner_from_centre

PATH, LAST, FIRST = (255, 215, 120), (60, 200, 250), (110, 230, 90)
MOST_PATHS, MOST_BOXES = 200, 12
REACH = 8192


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
