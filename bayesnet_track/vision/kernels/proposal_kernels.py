"""Compiled kernels of boxes that a network proposes: how well they explain others, and which is chosen."""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Floats, Singles
from bayesnet_track.numerics.compiled import compiled


@compiled
def read_boxes(
    sides: Singles, corner: tuple[float, float], whole: int, shown: int, stride: int, boxes: Floats
) -> None:
    """Fill `boxes` (S * S, 4), row by row, with the centre boxes that a map says in pixels of the frame.

    Args:
        sides: (4, S, S) how far left, top, right and bottom are from the middle of each cell, px of the crop.
        corner: x and y where the crop begins.
        whole: side of the crop in the frame; it is `shown` in so many px.
        stride: from cell to cell, px of the crop.
        boxes: filled; sides of no extent are left tiny.
    """
    cells, scale, middle = sides.shape[1], whole / shown, 0.5 * shown
    for row in range(cells):
        for column in range(cells):
            own = boxes[row * cells + column]
            for axis in range(2):
                place = float(((row if axis else column) - cells // 2) * stride)
                before = np.float64(sides[axis, row, column])
                after = np.float64(sides[2 + axis, row, column])
                own[axis] = corner[axis] + scale * (middle + place + 0.5 * (after - before))
                own[2 + axis] = scale * max(before + after, 1e-3)


@compiled
def explained(boxes: Floats, proposals: Floats, logs: Floats, sd_place: float, sd_size: float) -> Floats:
    """(N,) largest logs[m] - d^2 / 2 over the proposals (M, 4) for each centre box (N, 4).

    d^2 adds the differences of the centres, in `sd_place` sides of the proposal, and of the logs of the
    sides, in `sd_size`; -inf without proposals.
    """
    own = np.log(proposals[:, 2:])
    found = np.full(len(boxes), -np.inf)
    for n in range(len(boxes)):
        x, y = boxes[n, 0], boxes[n, 1]
        w, h = np.log(boxes[n, 2]), np.log(boxes[n, 3])
        for m in range(len(proposals)):
            if logs[m] <= found[n]:
                continue
            across = (x - proposals[m, 0]) / (sd_place * proposals[m, 2])
            down = (y - proposals[m, 1]) / (sd_place * proposals[m, 3])
            wider, higher = (w - own[m, 0]) / sd_size, (h - own[m, 1]) / sd_size
            value = logs[m] - 0.5 * (across * across + down * down + wider * wider + higher * higher)
            if value > found[n]:
                found[n] = value
    return found


@compiled
def choose(
    proposals: Floats, logs: Floats, expected: Floats, window: float, reach: float, penalty: float
) -> tuple[int, float]:
    """The proposal with the largest (1 - window) worth + window h, and its worth, p exp(-penalty (r s - 1)).

    r is the change of shape and s that of size against the box expected, as factors of at least 1. h is a
    raised cosine of the distance in x times one of that in y, 0 from `reach` px on.

    Args:
        proposals: (M, 4) centre boxes, px, M at least 1.
        logs: (M,) their log-probabilities log p, the largest first.
        expected: (4,) centre box.
        window: 0..1.
        reach: px.
        penalty: at least 0.
    """
    usual, shape = _context(expected[2], expected[3]), expected[2] / expected[3]
    chosen, most, worth = 0, -np.inf, 0.0
    for m in range(len(logs)):
        probability = np.exp(logs[m])
        if (1.0 - window) * probability + window <= most:  # nor can any of those that follow
            break
        x = min(abs(proposals[m, 0] - expected[0]) / reach, 1.0)
        y = min(abs(proposals[m, 1] - expected[1]) / reach, 1.0)
        near = (0.5 + 0.5 * np.cos(np.pi * x)) * (0.5 + 0.5 * np.cos(np.pi * y))
        larger = _context(proposals[m, 2], proposals[m, 3]) / usual
        wider = proposals[m, 2] / proposals[m, 3] / shape
        change = max(larger, 1.0 / larger) * max(wider, 1.0 / wider)
        own = probability * np.exp(-penalty * (change - 1.0))
        value = (1.0 - window) * own + window * near
        if value > most:
            chosen, most, worth = m, value, own
    return chosen, worth


@compiled
def _context(w: float, h: float) -> float:
    """Side of the square that a template shows: half the sum of the sides around the box."""
    half = 0.5 * (w + h)
    return float(np.sqrt((w + half) * (h + half)))
