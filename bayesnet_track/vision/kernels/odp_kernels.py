"""Compiled kernels for optical flow by orthogonal dynamic programming (Quénot).

Two pictures are cut into overlapping strips. A strip and its like in the other picture are aligned as
one-dimensional signals, whose samples are the columns of the strip, by dynamic programming. Horizontal strips
give the flow along x, vertical ones along y; each pass starts from the flow of those before, and passes go
from coarse pictures and wide strips to fine ones.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Ints, Singles
from bayesnet_track.numerics.compiled import compiled
from bayesnet_track.numerics.resampling import copy_row

Steps = NDArray[np.int8]

MOST_GRAY = 40.0
"""A pixel's mismatch counts up to this, gray levels, so that a few that are covered do not decide."""
PULL_GRAY = 0.05
"""Cost of a shift of one pixel, gray levels: where nothing tells shifts apart the flow stays as it was."""


@compiled
def best_path(costs: Singles, penalty: float, back: Steps, path: Ints) -> float:
    """Fill `path` (L,) with the candidates of least total cost; returns that cost.

    The cost is the sum of costs[i, path[i]] (L, D) and of penalty * |path[i] - path[i - 1]|; neighbours
    differ by at most one candidate. `back` (L, D) is for use inside.
    """
    length, count = costs.shape
    total, following = np.full(count + 2, np.inf, np.float32), np.full(count + 2, np.inf, np.float32)
    copy_row(costs[0], total[1:-1])
    weight = np.float32(penalty)
    for i in range(1, length):
        row, step = costs[i], back[i]
        lower, same, upper, new = total, total[1:], total[2:], following[1:]
        for d in range(count):
            least, way = same[d], 0
            if lower[d] + weight < least:
                least, way = lower[d] + weight, -1
            if upper[d] + weight < least:
                least, way = upper[d] + weight, 1
            new[d] = least + row[d]
            step[d] = way
        total, following = following, total
    end = 0
    for d in range(1, count):
        if total[d + 1] < total[end + 1]:
            end = d
    path[length - 1] = end
    for i in range(length - 1, 0, -1):
        path[i - 1] = path[i] + back[i, path[i]]
    return float(total[end + 1])


@compiled
def _mismatches(
    source: Singles, target: Singles, along: Singles, across: Singles, steps: int, step: float, costs: Singles
) -> None:
    """Fill `costs` (h, w, D): how unlike each pixel is the target's, for each shift of it along its row.

    Candidate d is a shift of `along` + (d - steps) * step, and `across` to another row; edge pixels repeat.
    """
    height, width = source.shape
    last_x, last_y = np.float32(width - 1), np.float32(height - 1)
    stride = np.float32(step)
    for j in range(height):
        for i in range(width):
            y = min(max(np.float32(j) + across[j, i], np.float32(0.0)), last_y)
            top = min(int(y), height - 2)
            fy = y - np.float32(top)
            above, below, here, row = target[top], target[top + 1], source[j, i], costs[j, i]
            start = np.float32(i) + along[j, i] - np.float32(steps) * stride
            for d in range(2 * steps + 1):
                x = min(max(start + np.float32(d) * stride, np.float32(0.0)), last_x)
                left = min(int(x), width - 2)
                fx = x - np.float32(left)
                upper = above[left] + fx * (above[left + 1] - above[left])
                lower = below[left] + fx * (below[left + 1] - below[left])
                row[d] = min(abs(here - upper - fy * (lower - upper)), np.float32(MOST_GRAY))


@compiled
def odp_pass(
    source: Singles,
    target: Singles,
    along: Singles,
    across: Singles,
    width: int,
    steps: int,
    step: float,
    penalty: float,
) -> None:
    """Align horizontal strips and add what they moved to `along` (h, w), px; `across` is the flow in y.

    Strips are `width` rows wide (odd) and half as far apart; the flow between their middle rows is
    interpolated. A shift changes by at most `step` from one column to the next, so that the order of
    pixels is kept (step <= 1).

    Args:
        source, target: (h, w) brightness, at least 2 x 2; the target looks at (x + along, y + across)
            like the source at (x, y).
        steps, step: shifts of up to `steps` times `step` px, either way, are looked for.
        penalty: cost of a change of the shift by one pixel, gray levels.
    """
    height, length = source.shape
    count, half, apart = 2 * steps + 1, width // 2, max(width // 2, 1)
    costs = np.empty((height, length, count), np.float32)
    _mismatches(source, target, along, across, steps, step, costs)
    strips = (height - 1) // apart + 1
    found = np.empty((strips, length), np.float32)
    joined = np.empty((length, count), np.float32)
    back, path = np.empty((length, count), np.int8), np.empty(length, np.int64)
    for k in range(strips):
        first, past = max(k * apart - half, 0), min(k * apart + half + 1, height)
        for d in range(count):
            joined[:, d] = np.float32(PULL_GRAY * step * abs(d - steps) * (past - first))
        for j in range(first, past):
            joined += costs[j]
        joined *= np.float32(1.0 / (past - first))
        best_path(joined, penalty * step, back, path)
        for i in range(length):
            found[k, i] = np.float32((path[i] - steps) * step)
    for j in range(height):
        upper = min(j // apart, strips - 1)
        lower = min(upper + 1, strips - 1)
        weight = np.float32((j - upper * apart) / apart)
        for i in range(length):
            along[j, i] += found[upper, i] + weight * (found[lower, i] - found[upper, i])
