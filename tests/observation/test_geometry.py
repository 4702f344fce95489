"""Centre boxes on planes of a part of the frame, against what a definition pixel by pixel says."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track import box_means
from bayesnet_track.observation.geometry import (
    box_integral,
    box_pixels,
    crop_of,
    distinct_pixels,
    share_inside,
)
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Region, region_of_boxes

WIDTH, HEIGHT = 23, 17
NOISE = np.random.default_rng(3).integers(0, 255, (HEIGHT, WIDTH, 3), dtype=np.uint8)


@dataclass(frozen=True)
class Channel:
    """One channel of the frame, as bytes or as numbers that no sum of is exact."""

    is_exact: bool = True
    margin = 0
    inputs = ()
    is_points = False

    def compute(self, frames, inputs, region):
        values = region.of(frames.current.image)[..., 0]
        return values if self.is_exact else np.sqrt(values + 0.1)


BYTES, ROOTS = Channel(), Channel(False)
WHOLE = Channel().compute(FramePair(Frame(0, 0.0, NOISE), None), (), Region(0, 0, WIDTH, HEIGHT))

sides = st.floats(0.2, 30.0)
boxes = st.lists(
    st.tuples(st.floats(-20, WIDTH + 20), st.floats(-20, HEIGHT + 20), sides, sides), min_size=1, max_size=4
).map(np.array)
margins = st.integers(0, 9)


def planes_around(boxes, margin):
    """The planes on the smallest region with the boxes, and some more."""
    cache = PlaneCache(FramePair(Frame(0, 0.0, NOISE), None))
    return cache.planes((BYTES, ROOTS), region_of_boxes(boxes).grown(margin))


def span(centre, size, extent):
    """The whole numbers in [centre - size / 2, centre + size / 2), or the nearest one; which are < extent."""
    low, high = np.ceil(centre - size / 2), np.ceil(centre + size / 2)
    if not high > low:
        low = np.floor(centre + 0.5)
        high = low + 1
    every = np.arange(low, high).astype(int)
    return [n for n in every if 0 <= n < extent], len(every)


def pixels_by_hand(box):
    """Rows and columns of the frame inside the box, and how many pixels the whole box has."""
    columns, across = span(box[0], box[2], WIDTH)
    rows, down = span(box[1], box[3], HEIGHT)
    return rows, columns, across * down


@given(boxes, margins)
def test_the_pixels_of_a_box_are_those_whose_centres_are_in_it(boxes, margin):
    planes = planes_around(boxes, margin)
    found = box_pixels(planes, boxes)
    for n, box in enumerate(boxes):
        rows, columns, nominal = pixels_by_hand(box)
        left, top, right, bottom = found.corners[n]
        assert found.nominal[n] == nominal and found.visible[n] == len(rows) * len(columns)
        assert np.array_equal(planes[BYTES][top:bottom, left:right], WHOLE[np.ix_(rows, columns)])


cells = st.integers(1, 3)


@given(boxes, margins, cells, cells, st.sampled_from([BYTES, ROOTS]), st.sampled_from([0.0, -255.0]))
def test_means_are_of_whole_cells_and_no_bit_depends_on_the_crop(boxes, margin, across, down, plane, outside):
    found = box_means(planes_around(boxes, margin), plane, boxes, across, down, outside)
    whole = box_means(planes_around(boxes, 99), plane, boxes, across, down, outside)
    assert found.shape == (len(boxes), across * down) and np.array_equal(found, whole)
    values = WHOLE if plane.is_exact else np.sqrt(WHOLE + 0.1)
    for n, (x, y, w, h) in enumerate(boxes):
        for k in range(across * down):
            i, j = divmod(k, across)
            cell = x + ((j + 0.5) / across - 0.5) * w, y + ((i + 0.5) / down - 0.5) * h, w / across, h / down
            rows, columns, nominal = pixels_by_hand(cell)
            seen = values[np.ix_(rows, columns)]
            mean = (seen.sum() + outside * (nominal - seen.size)) / nominal
            assert found[n, k] == pytest.approx(mean, abs=1e-9)


@given(boxes, boxes, margins)
def test_a_crop_holds_what_the_frame_holds_there(boxes, others, margin):
    planes, wanted = planes_around(boxes, margin), region_of_boxes(others)
    values, (x, y) = crop_of(planes, BYTES, wanted)
    assert np.array_equal(values, WHOLE[y : y + values.shape[0], x : x + values.shape[1]])
    has = planes.region
    across = max(min(wanted.x1, has.x1) - max(wanted.x0, has.x0), 0)
    down = max(min(wanted.y1, has.y1) - max(wanted.y0, has.y0), 0)
    assert values.size == across * down


@given(boxes)
def test_the_share_inside_is_that_of_the_area(boxes):
    found = share_inside(boxes, Frame(0, 0.0, NOISE))
    for share, (x, y, w, h) in zip(found, boxes, strict=True):
        across = max(0.0, min(x + w / 2, WIDTH - 0.5) - max(x - w / 2, -0.5))
        down = max(0.0, min(y + h / 2, HEIGHT - 0.5) - max(y - h / 2, -0.5))
        assert 0.0 <= share <= 1.0 and share == pytest.approx(across * down / (w * h), abs=1e-9)


def test_an_integral_begins_at_the_first_pixel_of_the_region():
    boxes = np.array([[9.0, 8.0, 4.0, 4.0]])
    planes = planes_around(boxes, 1)
    integral, same, origin, frame = box_integral(planes, BYTES, boxes)
    part = planes.region.of(WHOLE)
    assert integral[-1, -1] == part.sum() and np.array_equal(same, boxes)
    assert origin.tolist() == [planes.region.x0, planes.region.y0] and frame.tolist() == [WIDTH, HEIGHT]


@given(st.integers(0, 2**32), st.floats(0.1, 40.0), st.integers(1, 60))
def test_boxes_with_the_same_pixels_are_found_once(seed, spread, count):
    """Also beyond the frame, where boxes with the same pixels inside differ in those outside."""
    rng = np.random.default_rng(seed)
    boxes = np.column_stack([rng.normal(8, spread, (count, 2)), rng.uniform(1, 9, (count, 2))])
    planes = PlaneCache(FramePair(Frame(0, 0.0, NOISE), None)).planes([BYTES], Region(0, 0, WIDTH, HEIGHT))
    pixels = box_pixels(planes, boxes)
    known = np.column_stack([pixels.corners, pixels.visible, pixels.nominal])
    distinct, place = distinct_pixels(pixels)
    rows = np.column_stack([distinct.corners, distinct.visible, distinct.nominal])
    if place is None:
        assert distinct is pixels and len(np.unique(known, axis=0)) > 0.8 * count
    else:
        np.testing.assert_array_equal(rows[place], known)
        assert len(np.unique(rows, axis=0)) == len(rows)
