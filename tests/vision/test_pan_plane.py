"""The pan of a picture that is cut from a larger one at places known."""

from __future__ import annotations

import gc
import weakref

import numpy as np
import pytest

from bayesnet_track.observation.planes import Frame, FramePair, Region
from bayesnet_track.vision.motion_planes import PanPlane, smaller_gray

SIZE = (180, 320)
WHOLE = Region(0, 0, SIZE[1], SIZE[0])


def view(at, index, noise=0.0):
    """A frame of a blurred random picture, seen from x and y `at`."""
    import cv2

    scene = np.random.default_rng(3).integers(0, 256, (400, 600, 3), dtype=np.uint8)
    scene = cv2.normalize(cv2.GaussianBlur(scene, (0, 0), 6.0), None, 0, 255, cv2.NORM_MINMAX)
    part = scene[at[1] : at[1] + SIZE[0], at[0] : at[0] + SIZE[1]].astype(float)
    part = part + noise * np.random.default_rng(index).normal(size=part.shape)
    return Frame(index, float(index), np.clip(part, 0, 255).astype(np.uint8))


@pytest.mark.parametrize("way", [(0, 0), (3, 0), (-24, 10), (60, -40)])
def test_the_picture_moves_against_the_camera(way):
    then, now = view((120, 100), 1, 5.0), view((120 + way[0], 100 + way[1]), 2, 5.0)
    shift = PanPlane().compute(FramePair(now, then), (), WHOLE)
    assert shift == pytest.approx([-way[0], -way[1]], abs=2.0)


def test_it_is_the_whole_way_over_missing_frames():
    then, now = view((120, 100), 1), view((140, 100), 3)
    assert PanPlane().compute(FramePair(now, then), (), WHOLE) == pytest.approx([-20.0, 0.0], abs=1.0)


def test_something_large_that_moves_in_front_is_no_pan():
    frames = []
    for index, x in ((1, 60), (2, 110)):
        image = view((120, 100), index).image.copy()
        image[40:140, x : x + 100] = (20, 60, 200)
        frames.append(Frame(index, float(index), image))
    assert np.hypot(*PanPlane().compute(FramePair(frames[1], frames[0]), (), WHOLE)) < 2.0


def test_without_a_previous_frame_of_the_same_size_nothing_moved():
    now = view((120, 100), 2)
    other = Frame(1, 1.0, now.image[:-20])
    for then in (None, other, Frame(5, 5.0, now.image)):
        assert not PanPlane().compute(FramePair(now, then), (), WHOLE).any()


@pytest.mark.parametrize("size", [(1, 320), (3, 640), (12, 1920), (1000, 3)])
def test_a_picture_that_is_too_narrow_did_not_move(size):
    tiny = [Frame(index, float(index), np.zeros((*size, 3), np.uint8)) for index in (1, 2)]
    assert not PanPlane().compute(FramePair(tiny[1], tiny[0]), (), Region(0, 0, size[1], size[0])).any()


def test_a_picture_that_is_replaced_did_not_move():
    now = view((120, 100), 2)
    for gray_level in (0, 90):
        plain = Frame(1, 1.0, np.full_like(now.image, gray_level))
        assert not PanPlane().compute(FramePair(now, plain), (), WHOLE).any()
        again = Frame(2, 2.0, plain.image.copy())
        assert np.hypot(*PanPlane().compute(FramePair(again, plain), (), WHOLE)) < 0.01
    other = Frame(1, 1.0, np.ascontiguousarray(now.image[::-1, ::-1]))
    assert not PanPlane().compute(FramePair(now, other), (), WHOLE).any()


def test_a_frame_is_shrunk_once_and_forgotten():
    one = Frame(0, 0.0, np.zeros((200, 340, 3), np.uint8))
    small, scale = smaller_gray(one)
    assert (small.width, small.height, scale) == (85, 50, 4)
    assert smaller_gray(one)[0] is small
    kept = weakref.ref(small)
    del one, small
    gc.collect()
    assert kept() is None
