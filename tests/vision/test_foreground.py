"""Pixels of boxes by their colours: counted once for each frame and box, and forgotten with the frame."""

import gc
import weakref

import numpy as np

from bayesnet_track.observation.planes import Frame
from bayesnet_track.vision.kernels import mean_shift_kernels
from bayesnet_track.vision.kernels.mean_shift_kernels import KEPT, CellLayout, count_pixels

CELLS = CellLayout(4, False)


def frame():
    return Frame(0, 0.0, np.random.default_rng(1).integers(0, 256, (30, 40, 3), np.uint8))


def boxes(x):
    return np.array([[x, 12.0, 16, 14], [x, 12.0, 9, 8]])


def test_the_same_boxes_of_a_frame_are_counted_once():
    now, other = frame(), frame()
    first = count_pixels(now, CELLS, boxes(20.0))
    assert count_pixels(now, CELLS, boxes(20.0)) is first
    assert not first.flags.writeable
    for again in (
        count_pixels(other, CELLS, boxes(20.0)),
        count_pixels(now, CellLayout(8, False), boxes(20.0)),
    ):
        assert again is not first
    assert (count_pixels(now, CELLS, boxes(12.0)) != first).any()


def test_no_more_than_some_are_kept_and_none_without_the_frame():
    now = frame()
    places = np.linspace(5, 35, 3 * KEPT)
    for x in places:
        found = count_pixels(now, CELLS, boxes(x))
        np.testing.assert_array_equal(found, count_pixels(frame(), CELLS, boxes(x)))
        assert len(mean_shift_kernels._OF_FRAME[now]) <= KEPT
    left = weakref.ref(now)
    del now
    gc.collect()
    assert left() is None
