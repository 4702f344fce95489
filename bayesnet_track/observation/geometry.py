"""From centre boxes to rows and columns of a plane, which covers only a part of the frame.

A box is ``x, y, w, h`` with its centre at ``x, y``, in pixels of the frame; pixels have their centres at
whole numbers. Row 0, column 0 of an image-like plane is the pixel ``(region.x0, region.y0)`` of the frame. A
cue that mixes up the two, or truncates instead of rounding, is wrong by a pixel, or only near the border.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesnet_track.numerics.arrays import Array, Floats, Ints
from bayesnet_track.observation.planes import Frame, Plane, Planes, Region, for_reading

FEW_REPEATED = 0.8
"""Share of boxes that differ above which it costs more to pick them than to do all."""

HALF_OVERLAP = np.array([[-0.5, 0.0], [0.5, 0.0], [0.0, -0.5], [0.0, 0.5]])
"""Steps, in sizes of a box, to the four boxes beside it that share half of it."""


@dataclass(frozen=True, eq=False)
class BoxPixels:
    """Ranges of pixels of a plane in each of N boxes.

    A pixel is in a box when low edge <= its centre < high edge; every box has at least the nearest one.

    Attributes:
        corners: (N, 4) left, top, right, bottom: columns left .. right - 1 and rows top .. bottom - 1 of the
            plane. A box that lies beyond the plane has none.
        visible: (N,) pixels of the box that the plane covers.
        nominal: (N,) pixels of the whole box, those beyond the plane included.
    """

    corners: Ints
    visible: Floats
    nominal: Floats


def box_pixels(planes: Planes, boxes: Floats) -> BoxPixels:
    """The pixels of the planes' region that lie in the centre boxes (N, 4)."""
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.kernels.box_kernels import pixels_of_boxes

    r = planes.region
    boxes = np.ascontiguousarray(boxes)  # one compiled version only
    return BoxPixels(*pixels_of_boxes(boxes, r.x0, r.y0, r.x1 - r.x0, r.y1 - r.y0))


def distinct_pixels(pixels: BoxPixels) -> tuple[BoxPixels, Ints | None]:
    """The boxes of which no other has the same pixels, and (N,) where each box is among them.

    As they are, with None, where hardly any is repeated. Hypotheses of a target that is well known lie within
    a few pixels: what depends on their pixels alone need not be found more than once.
    """
    from bayesnet_track.numerics.kernels.box_kernels import find_distinct

    first, place = find_distinct(pixels.corners, pixels.nominal)
    if len(first) > FEW_REPEATED * len(place):
        return pixels, None
    return BoxPixels(pixels.corners.take(first, 0), pixels.visible[first], pixels.nominal[first]), place


def box_means(
    planes: Planes, plane: Plane, boxes: Floats, across: int = 1, down: int = 1, outside: float = 0.0
) -> Floats:
    """(N, down * across) means of an image-like plane (rows, columns) over the cells of centre boxes (N, 4).

    The cells divide a box into `down` rows and `across` columns, and come row by row. Pixels outside the
    frame count with the value `outside`: with one that matches nothing, the part of a box beyond the border
    counts as unmatched. No bit depends on which region the planes cover.
    """
    values = planes[plane]
    pixels = box_pixels(planes, _cells(boxes, across, down))
    left, top, right, bottom = pixels.corners.T
    if values.dtype.kind in "bui":  # exact, so that it does not matter where the crop starts
        total = np.zeros((values.shape[0] + 1, values.shape[1] + 1), np.int64)
        total[1:, 1:] = values.cumsum(axis=0, dtype=np.int64).cumsum(axis=1)
        sums = total[bottom, right] - total[top, right] - total[bottom, left] + total[top, left]
    else:
        corners = pixels.corners.tolist()
        sums = np.array([np.ascontiguousarray(values[t:b, l:r]).sum() for l, t, r, b in corners])  # noqa: E741
    means = (sums + outside * (pixels.nominal - pixels.visible)) / pixels.nominal
    return np.asarray(means.reshape(len(boxes), down * across))


def _cells(boxes: Floats, columns: int, rows: int) -> Floats:
    """(N * rows * columns, 4) centre boxes of the cells, row by row of each box."""
    x, y, w, h = (boxes[:, n, None, None] for n in range(4))
    cells = np.empty((len(boxes), rows, columns, 4))
    cells[..., 0] = x + ((np.arange(columns) + 0.5) / columns - 0.5) * w
    cells[..., 1] = y + ((np.arange(rows)[:, None] + 0.5) / rows - 0.5) * h
    cells[..., 2], cells[..., 3] = w / columns, h / rows
    return cells.reshape(-1, 4)


def crop_of(planes: Planes, plane: Plane, region: Region) -> tuple[Array, tuple[int, int]]:
    """The values of an image-like plane on `region`, as far as it is covered; column and row of the first.

    Column and row are the frame's. Values may be a read-only view; empty where nothing is covered.
    """
    has = planes.region
    inner = Region(
        max(region.x0, has.x0), max(region.y0, has.y0), min(region.x1, has.x1), min(region.y1, has.y1)
    )
    if inner.is_empty:
        return planes[plane][:0, :0], (region.x0, region.y0)
    local = Region(inner.x0 - has.x0, inner.y0 - has.y0, inner.x1 - has.x0, inner.y1 - has.y0)
    return local.of(planes[plane]), (inner.x0, inner.y0)


def crops_of(planes: Sequence[Planes], plane: Plane) -> tuple[Array, Ints, Ints]:
    """An image-like plane (rows, columns) of several targets, pixel after pixel in one array.

    With it (T, 2) where the pixels of each target's crop begin and its columns, and (T, 4) x0, y0, x1, y1 of
    the crop in the frame. Targets that have the same planes share a crop.
    """
    distinct = {id(target): target for target in planes}
    values = [for_reading(target[plane]).ravel() for target in distinct.values()]
    begins = dict(zip(distinct, np.cumsum([0, *(len(crop) for crop in values)]).tolist(), strict=False))
    regions = [target.region for target in planes]
    return (
        values[0] if len(values) == 1 else for_reading(np.concatenate(values)),
        np.array([(begins[id(target)], target.region.x1 - target.region.x0) for target in planes]),
        np.array([(region.x0, region.y0, region.x1, region.y1) for region in regions]),
    )


def share_inside(boxes: Floats, frame: Frame) -> Floats:
    """(N,) share of the area of each centre box (N, 4) that lies inside the frame, 0..1."""
    from bayesnet_track.numerics.compiled import plain
    from bayesnet_track.numerics.kernels.box_kernels import box_shares_inside

    return box_shares_inside(plain(boxes), float(frame.width), float(frame.height))


def box_integral(planes: Planes, plane: Plane, boxes: Floats) -> tuple[Floats, Floats, Ints, Ints]:
    """Arguments of kernels that resample a plane (rows, columns) of uint8 in centre boxes (N, 4).

    Its integral (rows + 1, columns + 1), the boxes as contiguous float64, column and row of the frame at the
    plane's first pixel, and the frame's width and height.
    """
    import cv2

    # sums of uint8 are exact in float64, so it does not matter where the crop starts
    integral: Floats = cv2.integral(np.ascontiguousarray(planes[plane]), sdepth=cv2.CV_64F)
    origin = np.array([planes.region.x0, planes.region.y0], dtype=np.int64)
    frame = np.array([planes.frame.width, planes.frame.height], dtype=np.int64)
    return integral, np.ascontiguousarray(boxes, dtype=np.float64), origin, frame
