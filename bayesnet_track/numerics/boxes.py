"""Boxes: the one conversion between corner boxes and centre boxes, and overlap.

Inside the engine a box is ``(x, y, w, h)`` with ``(x, y)`` its **centre**, in float pixels, the centres
of pixels at integers: the pixel in column 0 spans [-0.5, 0.5]. OpenCV, ground-truth files and the outputs
use the **top-left corner**: ``(x, y, w, h)`` covers the columns x .. x + w - 1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from bayesnet_track.numerics.arrays import Floats

CornerBox = tuple[float, float, float, float]
"""Left, top, width, height in px, as numbers."""


def centre_from_corner(corner: ArrayLike) -> Floats:
    """Centre boxes (..., 4) from top-left corner boxes (..., 4).

    The corner box (0, 0, 1, 1) is the pixel in row 0, column 0, whose centre is (0, 0):

    >>> centre_from_corner([10, 20, 41, 31]).tolist()
    [30.0, 35.0, 41.0, 31.0]
    """
    box = np.asarray(corner, dtype=np.float64)
    return np.concatenate([box[..., :2] + (box[..., 2:] - 1.0) / 2.0, box[..., 2:]], axis=-1)


def corner_from_centre(centre: ArrayLike) -> Floats:
    """Top-left corner boxes (..., 4) from centre boxes (..., 4): the inverse of `centre_from_corner`."""
    box = np.asarray(centre, dtype=np.float64)
    return np.concatenate([box[..., :2] - (box[..., 2:] - 1.0) / 2.0, box[..., 2:]], axis=-1)


def xyxy_from_centre(centre: ArrayLike) -> Floats:
    """Left, top, left + width, top + height (..., 4) of centre boxes (..., 4)."""
    corner = corner_from_centre(centre)
    return np.concatenate([corner[..., :2], corner[..., :2] + corner[..., 2:]], axis=-1)


def centre_from_xyxy(corners: ArrayLike) -> Floats:
    """Centre boxes (..., 4): the inverse of `xyxy_from_centre`."""
    box = np.asarray(corners, dtype=np.float64)
    return centre_from_corner(np.concatenate([box[..., :2], box[..., 2:] - box[..., :2]], axis=-1))


def overlap(a: ArrayLike, b: ArrayLike) -> Floats:
    """Intersection over union of centre boxes (..., 4), broadcast; 0 where the union is empty."""
    first, second = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    width, height = (
        np.minimum(first[..., i] + first[..., i + 2] / 2, second[..., i] + second[..., i + 2] / 2)
        - np.maximum(first[..., i] - first[..., i + 2] / 2, second[..., i] - second[..., i + 2] / 2)
        for i in (0, 1)
    )
    intersection = np.maximum(width, 0.0) * np.maximum(height, 0.0)
    union = first[..., 2] * first[..., 3] + second[..., 2] * second[..., 3] - intersection
    empty = np.zeros(np.shape(intersection))
    return np.asarray(np.divide(intersection, union, out=empty, where=union > 0), dtype=np.float64)


LEAST_VISIBLE = 0.5
"""A camera sees a target if so much of its box is in the image."""


def shares_inside(boxes: Floats, width: int, height: int) -> Floats:
    """(N,) shares of the area of centre boxes (N, 4) that are inside an image.

    >>> shares_inside(np.array([[0.0, 10.0, 11.0, 4.0], [-50.0, 10.0, 4.0, 4.0]]), 100, 50).round(3).tolist()
    [0.545, 0.0]
    """
    low, high = boxes[:, :2] - boxes[:, 2:] / 2.0, boxes[:, :2] + boxes[:, 2:] / 2.0
    extent = np.minimum(high, np.array([width, height]) - 0.5) - np.maximum(low, -0.5)
    return np.asarray((np.maximum(extent, 0.0) / boxes[:, 2:]).prod(axis=1), dtype=np.float64)
