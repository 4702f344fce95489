"""Draw what a detector found onto a frame."""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Image
from bayesnet_track.numerics.boxes import corner_from_centre
from bayesnet_track.observation.detector import Detections


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
