"""Compiled kernels for the motion of every pixel: dense optical flow, dynamic programming, patch matching.

Orthogonal dynamic programming (Quénot): two images are cut into overlapping strips. A strip and its like in
the other image are aligned as one-dimensional signals, whose samples are the columns of the strip, by dynamic
programming. Horizontal strips give the flow along x, vertical ones along y; each pass starts from the flow of
those before, and passes go from coarse pictures and wide strips to fine ones.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Bytes, Floats, Ints, Singles
from bayesnet_track.numerics.compiled import compiled
from bayesnet_track.numerics.resampling import copy_row
from bayesnet_track.vision.kernels.flow_kernels import FLOW_UNITS


@compiled
def there_and_back(
    forward: Singles,
    back: Singles,
    left: int,
    top: int,
    scores: Floats,
    reach: float,
    agree: float,
    target: Singles,
) -> None:
    """Fill `target` (h, w, 3) with dx, dy, valid: how each pixel moved to where it is; 0, 0, 0 if not valid.

    Valid where `scores` (h, w) is above 0, the pixel moved by no more than `reach` px in x and in y and did
    not come from outside `back`, and going there and back ends within `agree` px of where it began.

    Args:
        forward: (H, W, 2) flow from the current frame to the previous one; back: that of the other direction.
        left, top: column and row of these at which `target` begins.
    """
    height, width = back.shape[:2]
    for j in range(target.shape[0]):
        for i in range(target.shape[1]):
            dx, dy = float(forward[top + j, left + i, 0]), float(forward[top + j, left + i, 1])
            x, y = left + i + dx, top + j + dy
            target[j, i, :] = np.float32(0.0)
            if scores[j, i] <= 0.0 or not (abs(dx) <= reach and abs(dy) <= reach):
                continue
            if not (0.0 <= x <= width - 1 and 0.0 <= y <= height - 1):
                continue
            x0, y0 = min(int(x), width - 2), min(int(y), height - 2)
            fx, fy = x - x0, y - y0
            off_x = dx + _between(
                back[y0, x0, 0], back[y0, x0 + 1, 0], back[y0 + 1, x0, 0], back[y0 + 1, x0 + 1, 0], fx, fy
            )
            off_y = dy + _between(
                back[y0, x0, 1], back[y0, x0 + 1, 1], back[y0 + 1, x0, 1], back[y0 + 1, x0 + 1, 1], fx, fy
            )
            if off_x * off_x + off_y * off_y <= agree * agree:
                target[j, i, 0], target[j, i, 1] = np.float32(-dx), np.float32(-dy)
                target[j, i, 2] = np.float32(1.0)


@compiled
def _between(a: float, b: float, c: float, d: float, fx: float, fy: float) -> float:
    """Bilinear, `a` and `b` above `c` and `d`."""
    upper, lower = a + fx * (b - a), c + fx * (d - c)
    return upper + fy * (lower - upper)


@compiled
def valid_vectors(field: Singles, left: int, top: int, vectors: Floats) -> int:
    """Fill `vectors` (h w, 4) with x, y, dx, dy of the valid vectors of `field` (h, w, 3); their number."""
    count = 0
    for j in range(field.shape[0]):
        for i in range(field.shape[1]):
            if field[j, i, 2] > 0:
                vectors[count, 0], vectors[count, 1] = left + i, top + j
                vectors[count, 2], vectors[count, 3] = field[j, i, 0], field[j, i, 1]
                count += 1
    return count


@compiled
def dense_in_boxes(
    points: Floats, left: int, top: int, width: int, height: int, boxes: Floats, counts: Floats, means: Floats
) -> None:
    """Mean flow of points (P, 4) at whole pixels of a region: by integral images, P may be large.

    Flow is rounded to 1 / FLOW_UNITS pixel, so that sums are exact whatever the region.
    """
    sums = np.zeros((height + 1, width + 1, 3))
    for k in range(points.shape[0]):
        x, y = int(points[k, 0]) - left + 1, int(points[k, 1]) - top + 1
        sums[y, x, 0] += 1.0
        sums[y, x, 1] += np.rint(points[k, 2] * FLOW_UNITS) / FLOW_UNITS
        sums[y, x, 2] += np.rint(points[k, 3] * FLOW_UNITS) / FLOW_UNITS
    for j in range(1, height + 1):
        for i in range(1, width + 1):
            for c in range(3):
                sums[j, i, c] += sums[j - 1, i, c] + sums[j, i - 1, c] - sums[j - 1, i - 1, c]
    for n in range(boxes.shape[0]):
        half_w, half_h = 0.5 * boxes[n, 2], 0.5 * boxes[n, 3]
        x0 = min(max(np.ceil(boxes[n, 0] - half_w) - left, 0.0), float(width))
        x1 = min(max(np.floor(boxes[n, 0] + half_w) + 1.0 - left, x0), float(width))
        y0 = min(max(np.ceil(boxes[n, 1] - half_h) - top, 0.0), float(height))
        y1 = min(max(np.floor(boxes[n, 1] + half_h) + 1.0 - top, y0), float(height))
        a, b, c, d = (
            sums[int(y0), int(x0)],
            sums[int(y0), int(x1)],
            sums[int(y1), int(x0)],
            sums[int(y1), int(x1)],
        )
        count = d[0] - b[0] - c[0] + a[0]
        counts[n] = count
        means[n, 0] = (d[1] - b[1] - c[1] + a[1]) / count if count > 0.0 else 0.0
        means[n, 1] = (d[2] - b[2] - c[2] + a[2]) / count if count > 0.0 else 0.0


Steps = NDArray[np.int8]

MOST_GRAY = 40.0
"""A pixel's mismatch counts up to this, gray levels, so that a few that are covered do not decide."""
PULL_GRAY = 0.05
"""Cost of a shift of one pixel, gray levels: where shifts fit equally well the flow stays as it was."""


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
        lower, same, upper, updated = total, total[1:], total[2:], following[1:]
        for d in range(count):
            lowest, way = same[d], 0
            if lower[d] + weight < lowest:
                lowest, way = lower[d] + weight, -1
            if upper[d] + weight < lowest:
                lowest, way = upper[d] + weight, 1
            updated[d] = lowest + row[d]
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
    source: Singles,
    target: Singles,
    flow_x: Singles,
    flow_y: Singles,
    steps: int,
    step: float,
    costs: Singles,
) -> None:
    """Fill `costs` (h, w, D): how unlike each pixel is the target's, for each shift of it along its row.

    Candidate d is a shift of `flow_x` + (d - steps) * step, and `flow_y` to another row; edge pixels repeat.
    """
    height, width = source.shape
    last_x, last_y = np.float32(width - 1), np.float32(height - 1)
    stride = np.float32(step)
    for j in range(height):
        for i in range(width):
            y = min(max(np.float32(j) + flow_y[j, i], np.float32(0.0)), last_y)
            top = min(int(y), height - 2)
            fy = y - np.float32(top)
            top_row, next_row, pixel, row = target[top], target[top + 1], source[j, i], costs[j, i]
            start = np.float32(i) + flow_x[j, i] - np.float32(steps) * stride
            for d in range(2 * steps + 1):
                x = min(max(start + np.float32(d) * stride, np.float32(0.0)), last_x)
                left = min(int(x), width - 2)
                fx = x - np.float32(left)
                upper = top_row[left] + fx * (top_row[left + 1] - top_row[left])
                lower = next_row[left] + fx * (next_row[left + 1] - next_row[left])
                row[d] = min(abs(pixel - upper - fy * (lower - upper)), np.float32(MOST_GRAY))


@compiled
def odp_pass(
    source: Singles,
    target: Singles,
    flow_x: Singles,
    flow_y: Singles,
    width: int,
    steps: int,
    step: float,
    penalty: float,
) -> None:
    """Align horizontal strips and add what they moved to `flow_x` (h, w), px; `flow_y` is the flow in y.

    Strips are `width` rows wide (odd) and half as far apart; the flow between their middle rows is
    interpolated. A shift changes by at most `step` from one column to the next, so that the order of
    pixels is kept (step <= 1).

    Args:
        source, target: (h, w) brightness, at least 2 x 2; the target looks at (x + flow_x, y + flow_y)
            like the source at (x, y).
        steps, step: shifts of up to `steps` times `step` px, either way, are looked for.
        penalty: cost of a change of the shift by one pixel, gray levels.
    """
    height, length = source.shape
    count, half, spacing = 2 * steps + 1, width // 2, max(width // 2, 1)
    costs = np.empty((height, length, count), np.float32)
    _mismatches(source, target, flow_x, flow_y, steps, step, costs)
    strips = (height - 1) // spacing + 1
    shifts = np.empty((strips, length), np.float32)
    joined = np.empty((length, count), np.float32)
    back, path = np.empty((length, count), np.int8), np.empty(length, np.int64)
    for k in range(strips):
        first, past = max(k * spacing - half, 0), min(k * spacing + half + 1, height)
        for d in range(count):
            joined[:, d] = np.float32(PULL_GRAY * step * abs(d - steps) * (past - first))
        for j in range(first, past):
            joined += costs[j]
        joined *= np.float32(1.0 / (past - first))
        best_path(joined, penalty * step, back, path)
        for i in range(length):
            shifts[k, i] = np.float32((path[i] - steps) * step)
    for j in range(height):
        upper = min(j // spacing, strips - 1)
        lower = min(upper + 1, strips - 1)
        weight = np.float32((j - upper * spacing) / spacing)
        for i in range(length):
            flow_x[j, i] += shifts[upper, i] + weight * (shifts[lower, i] - shifts[upper, i])


@compiled
def match_patches(
    image: Bytes, origin: Ints, points: Ints, patches: Floats, shifts_x: Ints, shifts_y: Ints, squares: Floats
) -> None:
    """Fill `squares` (N, K, K) with mean squared differences of `patches` (N, P, P) to the image.

    Entry [n, j, i] is at the point (x, y) displaced by (across[i], down[j]); infinity where the patch leaves
    the image, whose first pixel is at `origin` (x, y).
    """
    side = patches.shape[1]
    half = side // 2
    rows, columns = image.shape
    for n in range(points.shape[0]):
        for j in range(shifts_y.shape[0]):
            top = points[n, 1] + shifts_y[j] - origin[1] - half
            for i in range(shifts_x.shape[0]):
                left = points[n, 0] + shifts_x[i] - origin[0] - half
                if top < 0 or left < 0 or top + side > rows or left + side > columns:
                    squares[n, j, i] = np.inf
                    continue
                total = 0.0
                for y in range(side):
                    for x in range(side):
                        difference = patches[n, y, x] - np.float64(image[top + y, left + x])
                        total += difference * difference
                squares[n, j, i] = total / (side * side)
