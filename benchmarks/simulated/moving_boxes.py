"""Boxes that move by a multiple of their own size a frame, with known identities: drawn detections."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from bayesnet_track.numerics.arrays import Floats, Ints

Kind = Literal["straight", "random walk", "u-turn"]

WIDTH_TO_HEIGHT = 2 / 3
START_SIDES_PX = {-1: 98.0, 0: 49.0, 1: 14.7}
"""Geometric mean of the sides in the first frame, of boxes that shrink, stay, grow."""


@dataclass(frozen=True)
class MotionCell:
    """One cell of the grid.

    Attributes:
        kind: how the boxes move.
        shift: root mean square of the shift in a frame, over the geometric mean of the sides.
        growth: change of the sides in a frame, as a share of them.
    """

    kind: Kind
    shift: float
    growth: float = 0.0


def move_boxes(
    cell: MotionCell, count: int, frames: int, size: tuple[int, int], rng: np.random.Generator
) -> Floats:
    """(frames, count, 4) centre boxes in an image (width, height), at whose borders centres turn back.

    A box alone starts so that a straight way leads through the middle of the image.
    """
    extent = np.array(size, float)
    angle = rng.uniform(0.0, 2.0 * np.pi, count) if count > 1 else np.zeros(1)
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    side = START_SIDES_PX[int(np.sign(cell.growth))] * (1.0 + cell.growth) ** np.arange(frames)
    at = rng.uniform(0.1, 0.9, (count, 2)) * extent
    if count == 1:
        at[0] = [0.1 * extent[0] if cell.kind == "straight" else 0.5 * extent[0], extent[1] / 2]
    boxes = np.empty((frames, count, 4))
    for frame in range(frames):
        w = side[frame] * WIDTH_TO_HEIGHT**0.5
        boxes[frame] = np.concatenate([at, np.tile([w, w / WIDTH_TO_HEIGHT], (count, 1))], axis=1)
        step = cell.shift * side[frame]
        if cell.kind == "random walk":
            at = at + rng.normal(0.0, step / 2**0.5, (count, 2))
        else:
            if cell.kind == "u-turn" and frame == frames // 2:
                direction = -direction
            at = at + step * direction
        outside = (at < 0) | (at > extent - 1)
        direction = np.where(outside, -direction, direction)
        at = np.abs(at)
        at = np.where(at > extent - 1, 2 * (extent - 1) - at, at)
    return boxes


def detect_boxes(boxes: Floats, noise: float, rng: np.random.Generator) -> Floats:
    """(frames, count, 4) the boxes with errors of sd `noise` times their sides."""
    return np.asarray(boxes + rng.normal(0.0, 1.0, boxes.shape) * noise * boxes[..., [2, 3, 2, 3]])


def link_nearest(boxes: Floats, reach: float) -> Ints:
    """(frames, count) identities of nearest-centre linking: the nearest pairs first, within `reach` sides."""
    frames, count = boxes.shape[:2]
    ids = np.empty((frames, count), np.int64)
    ids[0], last = np.arange(count), count
    for frame in range(1, frames):
        before, now = boxes[frame - 1], boxes[frame]
        apart = np.linalg.norm(now[:, None, :2] - before[None, :, :2], axis=2)
        apart /= np.sqrt(now[:, 2] * now[:, 3])[:, None]
        ids[frame] = -1
        for row, column in zip(*np.unravel_index(np.argsort(apart, axis=None), apart.shape), strict=True):
            if apart[row, column] > reach:
                break
            if ids[frame, row] < 0 and ids[frame - 1, column] not in ids[frame]:
                ids[frame, row] = ids[frame - 1, column]
        new = ids[frame] < 0
        ids[frame, new] = last + np.arange(int(new.sum()))
        last += int(new.sum())
    return ids


def count_switches(ids: Ints) -> int:
    """How often the identity of a column changes in (frames, count); below 0 there is none."""
    switches = 0
    for column in ids.T:
        known = column[column > -1]
        switches += int(np.count_nonzero(known[1:] != known[:-1]))
    return switches
