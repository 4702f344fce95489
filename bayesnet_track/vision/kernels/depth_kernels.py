"""Compiled kernel that describes the depth blob inside each box."""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Floats, Ints, Singles
from bayesnet_track.numerics.compiled import compiled

FEATURES = 5
"""Columns of the table that `blob_features` fills: share, depth, spread, width, height."""
SHARE, DEPTH, SPREAD, WIDTH, HEIGHT = range(FEATURES)

NEAREST_M, FURTHEST_M = 0.01, 10000.0


@compiled
def blob_features(
    points: Singles, boxes: Floats, origin: Ints, cells: int, layer: float, features: Floats
) -> None:
    """Fill `features` (N, 5) with what a grid of samples on each box says of its depth blob.

    The blob of a box is its fullest layer of depth, in which depths differ by a factor of at most
    exp(3 layer). Columns: the samples in the blob as a share of all samples; the blob's mean depth, m; the
    standard deviation of depth over all valid samples of the box, m; and the blob's width and height, m, as
    those of a filled rectangle of the same standard deviation in X and in Y. All 0 without a blob.

    Args:
        points: (rows, columns, 3) X, Y, Z in m of a crop; NaN where there is none.
        boxes: (N, 4) centre boxes, frame coordinates.
        origin: column and row, in the frame, of the crop's first pixel.
        cells: samples along each side of a box, each the pixel nearest to the middle of its cell.
        layer: a third of a layer's depth, as a logarithm.
    """
    rows, columns = points.shape[0], points.shape[1]
    most = int(np.ceil(np.log(FURTHEST_M / NEAREST_M) / layer)) + 3
    counts = np.zeros(most, np.int64)
    places = np.empty(cells * cells, np.int64)
    found = np.empty((cells * cells, 3))
    side = 12.0 / (1.0 - 1.0 / cells**2)  # of evenly spaced samples: width^2 / variance
    for n in range(boxes.shape[0]):
        features[n] = 0.0
        x0 = boxes[n, 0] - boxes[n, 2] / 2 - origin[0] + 0.5
        y0 = boxes[n, 1] - boxes[n, 3] / 2 - origin[1] + 0.5
        valid = 0
        for j in range(cells):
            y = y0 + (j + 0.5) * boxes[n, 3] / cells
            if not (y >= 0.0 and y < rows):
                continue
            v = int(y)
            for i in range(cells):
                x = x0 + (i + 0.5) * boxes[n, 2] / cells
                if not (x >= 0.0 and x < columns):
                    continue
                point = points[v, int(x)]
                depth = float(point[2])
                if not (depth > NEAREST_M and depth < FURTHEST_M):
                    continue
                place = int(np.log(depth / NEAREST_M) / layer) + 1
                counts[place] += 1
                places[valid] = place
                found[valid, 0], found[valid, 1], found[valid, 2] = point[0], point[1], depth
                valid += 1
        if valid == 0:
            continue
        best, size = 0, 0
        for k in range(valid):
            place = places[k]
            here = counts[place - 1] + counts[place] + counts[place + 1]
            if here > size or (here == size and place < best):
                best, size = place, here
        for k in range(valid):
            counts[places[k]] = 0
        x, y, z, all_z = 0.0, 0.0, 0.0, 0.0
        for k in range(valid):
            all_z += found[k, 2]
            if abs(places[k] - best) <= 1:
                x += found[k, 0]
                y += found[k, 1]
                z += found[k, 2]
        x, y, z, all_z = x / size, y / size, z / size, all_z / valid
        xx, yy, zz = 0.0, 0.0, 0.0
        for k in range(valid):
            zz += (found[k, 2] - all_z) ** 2
            if abs(places[k] - best) <= 1:
                xx += (found[k, 0] - x) ** 2
                yy += (found[k, 1] - y) ** 2
        features[n, SHARE] = size / cells**2
        features[n, DEPTH] = z
        features[n, SPREAD] = np.sqrt(zz / valid)
        features[n, WIDTH] = np.sqrt(side * xx / size)
        features[n, HEIGHT] = np.sqrt(side * yy / size)
