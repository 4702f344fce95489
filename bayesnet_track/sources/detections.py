"""Detections of a frame as text: MOT (10 columns) and JSON Lines."""

from __future__ import annotations

import json

from bayesnet_track.numerics.boxes import corner_from_centre
from bayesnet_track.observation.detector import Detections
from bayesnet_track.observation.planes import Frame

DIGITS, SCORE_DIGITS = 3, 6


def format_frame(frame: Frame, detections: Detections, as_json: bool) -> list[str]:
    """The lines of one frame.

    MOT: ``frame, -1, left, top, width, height, score, -1, -1, -1``, frames from 1, pixels from 0. JSON: one
    object with frame (from 0), time_s, and detections, each with box (the same four numbers), score, label.
    """
    if not as_json:
        return format_mot(frame.index, detections)
    corners = corner_from_centre(detections.boxes)
    found = [
        {
            "box": [round(float(value), DIGITS) for value in box],
            "score": round(float(score), SCORE_DIGITS),
            "label": label,
        }
        for box, score, label in zip(corners, detections.scores, detections.labels, strict=True)
    ]
    return [json.dumps({"frame": frame.index, "time_s": round(frame.time_s, 6), "detections": found})]


def format_mot(index: int, detections: Detections) -> list[str]:
    """The MOT lines of the frame with this index, from 0; see `format_frame`."""
    return [
        f"{index + 1},-1,{','.join(f'{value + 0.0:.{DIGITS}f}' for value in box)},"
        f"{score:.{SCORE_DIGITS}f},-1,-1,-1"
        for box, score in zip(corner_from_centre(detections.boxes), detections.scores, strict=True)
    ]
