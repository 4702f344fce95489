"""Compiled kernels for dense optical flow: which vectors are valid, and the mean flow inside boxes."""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Floats, Singles
from bayesnet_track.numerics.compiled import compiled
from bayesnet_track.vision.kernels.flow_kernels import FLOW_UNITS


@compiled
def there_and_back(
    there: Singles,
    back: Singles,
    left: int,
    top: int,
    scores: Floats,
    reach: float,
    agree: float,
    out: Singles,
) -> None:
    """Fill `out` (h, w, 3) with dx, dy, valid: how each pixel moved to where it is; 0, 0, 0 if not valid.

    Valid where `scores` (h, w) is above 0, the pixel moved by no more than `reach` px in x and in y and did
    not come from outside `back`, and going there and back ends within `agree` px of where it began.

    Args:
        there: (H, W, 2) flow from the current frame to the previous one; back: that of the other direction.
        left, top: where in these `out` begins.
    """
    height, width = back.shape[:2]
    for j in range(out.shape[0]):
        for i in range(out.shape[1]):
            dx, dy = float(there[top + j, left + i, 0]), float(there[top + j, left + i, 1])
            x, y = left + i + dx, top + j + dy
            out[j, i, :] = np.float32(0.0)
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
                out[j, i, 0], out[j, i, 1], out[j, i, 2] = np.float32(-dx), np.float32(-dy), np.float32(1.0)


@compiled
def _between(a: float, b: float, c: float, d: float, fx: float, fy: float) -> float:
    """Bilinear, `a` and `b` above `c` and `d`."""
    upper, lower = a + fx * (b - a), c + fx * (d - c)
    return upper + fy * (lower - upper)


@compiled
def valid_vectors(field: Singles, left: int, top: int, found: Floats) -> int:
    """Fill `found` (h w, 4) with x, y, dx, dy of a field's (h, w, 3) valid vectors; returns their number."""
    count = 0
    for j in range(field.shape[0]):
        for i in range(field.shape[1]):
            if field[j, i, 2] > 0:
                found[count, 0], found[count, 1] = left + i, top + j
                found[count, 2], found[count, 3] = field[j, i, 0], field[j, i, 1]
                count += 1
    return count


@compiled
def dense_in_boxes(
    points: Floats, left: int, top: int, width: int, height: int, boxes: Floats, counts: Floats, means: Floats
) -> None:
    """As `flow_in_boxes`, for points (P, 4) at whole pixels of a region: by integral images, P may be large.

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
