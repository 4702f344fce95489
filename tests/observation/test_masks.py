"""Masks: bilinear between pixel centres, the border's value beyond, and files that are none refused."""

from __future__ import annotations

from hashlib import sha256

import cv2
import numpy as np
import pytest

from bayesnet_track.observation.image_files import AnyMask, Mask, PictureError, read_mask

GREY = np.array([[0, 51, 255], [102, 204, 0]], dtype=np.uint8)


def test_a_pixels_centre_has_its_grey_value(tmp_path):
    mask = Mask(tmp_path, "", GREY)
    x, y = np.meshgrid(np.arange(3.0), np.arange(2.0))
    np.testing.assert_allclose(mask(x, y), GREY / 255, rtol=1e-15)


def test_between_four_pixels_it_is_bilinear(tmp_path):
    mask = Mask(tmp_path, "", GREY)
    expected = (0.75 * (0.6 * 51 + 0.4 * 255) + 0.25 * (0.6 * 204 + 0.4 * 0)) / 255
    np.testing.assert_allclose(mask(np.array([1.4]), np.array([0.25])), [expected], rtol=1e-14)


def test_beyond_the_border_counts_the_nearest_point_of_it(tmp_path):
    mask = Mask(tmp_path, "", GREY)
    inside = mask(np.array([0.5, 2.0, 1.0]), np.array([0.0, 1.0, 1.0]))
    far = mask(np.array([0.5, 1e300, 1.0]), np.array([-9.0, 7.0, np.inf]))
    np.testing.assert_array_equal(far, inside)


def test_a_place_that_is_none_has_no_value(tmp_path):
    np.testing.assert_array_equal(Mask(tmp_path, "", GREY)(np.array([np.nan, 0.0]), 0.0), [np.nan, 0.0])


def test_a_file_is_read_with_its_fingerprint_and_colour_as_grey(tmp_path):
    path = tmp_path / "m.png"
    cv2.imwrite(str(path), np.dstack([GREY, GREY, GREY]))
    mask = read_mask(path)
    np.testing.assert_array_equal(mask.gray, GREY)
    assert mask.sha256 == sha256(path.read_bytes()).hexdigest()
    assert str(mask) == "m.png, 3x2 px"


def test_bytes_that_are_no_image_are_refused(tmp_path):
    path = tmp_path / "m.png"
    cv2.imwrite(str(path), GREY)
    path.write_bytes(path.read_bytes()[:-12])
    with pytest.raises(PictureError, match="cut off"):
        read_mask(path)


def test_to_show_a_graph_there_is_a_mask_of_every_name():
    masks = AnyMask()
    assert "road.png" in masks
    assert masks["road.png"](np.zeros(2), np.zeros(2)).tolist() == [1.0, 1.0]
    assert (list(masks), len(masks)) == ([], 0)
