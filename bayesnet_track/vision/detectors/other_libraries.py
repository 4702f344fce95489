"""Detections of other libraries as this project has them: of supervision, ultralytics, or any alike."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.detector import Detections, check_detections


def detections_of(found: Any) -> Detections:
    """The detections of one frame that another library's detector gave, the best first.

    Args:
        found: `supervision.Detections` (xyxy, confidence, class_id, data["class_name"]), a `Results` of
            ultralytics (its boxes with xyxy, conf, cls; names), or any object with `xyxy`: (N, 4) left, top,
            right, bottom, px, where 0 is the edge of the first pixel. Arrays, or tensors on any device.

    Labels are class names; numbers as text where there are no names; empty where there are no classes. A
    detection without confidence has score 1, as a file's has.

    Raises:
        ValueError: no `xyxy`, or boxes, confidences or classes that do not fit; says which.
    """
    boxes = getattr(found, "boxes", None)
    boxes = found if boxes is None else boxes
    corners = getattr(boxes, "xyxy", None)
    if corners is None:
        raise ValueError(f"{type(found).__name__} without xyxy; allowed: (N, 4) left, top, right, bottom, px")
    corners = _array(corners).reshape(-1, 4) if np.size(corners) == 0 else _array(corners)
    if corners.ndim != 2 or corners.shape[1] != 4:
        raise ValueError(f"xyxy of shape {corners.shape}; allowed: (N, 4)")
    scores = _of_each(boxes, ("confidence", "conf"), len(corners))
    scores = np.ones(len(corners)) if scores is None else scores
    if not ((scores >= 0) & (scores <= 1)).all():
        raise ValueError(f"confidence {scores.min():g} .. {scores.max():g}; allowed: 0 .. 1")
    sides = corners[:, 2:] - corners[:, :2]
    centres = np.concatenate([corners[:, :2] + sides / 2 - 0.5, sides], axis=1)
    order = np.argsort(-scores, kind="stable")
    labels = _labels(found, boxes, len(corners))
    return check_detections(Detections(centres[order], scores[order], tuple(labels[k] for k in order)))


def _array(given: Any) -> Floats:
    """Of an array, a list or a tensor on any device."""
    here = given.cpu() if hasattr(given, "cpu") else given
    return np.asarray(here, dtype=np.float64)


def _of_each(boxes: Any, names: tuple[str, ...], count: int) -> Floats | None:
    """(count,) the first of these fields that is there."""
    for name in names:
        value = getattr(boxes, name, None)
        if value is not None:
            values = _array(value).reshape(-1)
            if len(values) != count:
                raise ValueError(f"{name} of {len(values)} values for {count} boxes; allowed: one for each")
            return values
    return None


def _labels(found: Any, boxes: Any, count: int) -> list[str]:
    named = (getattr(found, "data", None) or {}) if isinstance(getattr(found, "data", None), dict) else {}
    if "class_name" in named:
        labels = [str(name) for name in named["class_name"]]
        if len(labels) != count:
            raise ValueError(f"class_name of {len(labels)} values for {count} boxes; allowed: one for each")
        return labels
    numbers = _of_each(boxes, ("class_id", "cls"), count)
    if numbers is None:
        return [""] * count
    names = getattr(found, "names", None)
    known = names if isinstance(names, dict) else dict(enumerate(names or ()))
    return [str(known.get(int(number), int(number))) for number in numbers]
