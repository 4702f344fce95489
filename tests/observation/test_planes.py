"""The plane cache: what is computed where, and that it makes no difference to the values."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from bayesnet_track.observation.planes import MANY, Frame, FramePair, PlaneCache, Region, region_of_boxes


@dataclass(frozen=True)
class Places:
    """A plane whose value at a pixel is the pixel's own place; it notes where it was computed."""

    is_points: bool = False
    computed: list[Region] = field(default_factory=list, compare=False, hash=False)

    margin, inputs = 0, ()

    def compute(self, frames, inputs, region):
        self.computed.append(region)
        rows, columns = np.mgrid[region.y0 : region.y1, region.x0 : region.x1]
        return rows * 1000 + columns


def cache():
    return PlaneCache(FramePair(Frame(0, 0.0, np.zeros((60, 80, 3), np.uint8)), None))


WHOLE = Region(0, 0, 80, 60)


def squares(count, side=5):
    """Regions that do not touch."""
    return [Region(x, y, x + side, y + side) for y in range(0, 60, 10) for x in range(0, 80, 10)][:count]


def test_few_small_regions_are_computed_one_by_one():
    plane, held = Places(), cache()
    regions = squares(MANY)
    for region in regions:
        held.planes((plane,), region)
    assert plane.computed == regions


def test_one_more_than_many_is_computed_on_the_whole_frame_once():
    plane, held = Places(), cache()
    for region in squares(MANY + 20):
        held.planes((plane,), region)
    assert plane.computed == [*squares(MANY), WHOLE]


def test_regions_that_add_up_to_the_frame_are_too_much():
    plane, held = Places(), cache()
    left, right, middle = Region(0, 0, 60, 60), Region(40, 0, 80, 60), Region(30, 0, 70, 60)
    for region in (left, right, middle):
        held.planes((plane,), region)
    assert plane.computed == [left, WHOLE]


def test_values_do_not_depend_on_where_a_plane_was_computed():
    plane, held = Places(), cache()
    alone = Places()
    for region in squares(MANY + 20):
        seen = held.planes((plane,), region)[plane]
        assert np.array_equal(seen, alone.compute(None, (), region))


def test_points_are_never_computed_on_more_than_was_asked_for():
    """A cue goes through all points that it is given."""
    plane, held = Places(is_points=True), cache()
    for region in squares(MANY + 20):
        held.planes((plane,), region)
    assert plane.computed == squares(MANY + 20)


def test_the_region_of_many_boxes_is_the_union_of_the_regions_of_each():
    rng = np.random.default_rng(3)
    boxes = np.column_stack([rng.normal(0, 300, (40, 2)), rng.uniform(1, 90, (40, 2))])
    for grow in (0.0, 0.5):
        one_by_one = Region(0, 0, 0, 0)
        for box in boxes:
            one_by_one = one_by_one.union(region_of_boxes(box[None], grow))
        assert region_of_boxes(boxes, grow) == one_by_one


@pytest.mark.parametrize("count", [1, 3])
def test_a_box_that_is_nowhere_has_no_region(count):
    boxes = np.tile([10.0, 10.0, 4.0, 4.0], (count, 1))
    boxes[-1, 1] = np.nan
    with pytest.raises(ValueError, match="NaN"):
        region_of_boxes(boxes)
