"""Squares cut out of a frame and shrunk by whole pixels, also beyond its border."""

from __future__ import annotations

import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from bayesnet_track.vision.correlation import _cut_shrunk


@given(
    size=st.tuples(st.integers(1, 40), st.integers(1, 40)),
    corner=st.tuples(st.integers(-120, 120), st.integers(-120, 120)),
    side=st.integers(1, 25),
    times=st.integers(1, 5),
    seed=st.integers(0, 100),
)
@settings(max_examples=300, deadline=None)
def test_a_crop_is_that_of_the_frame_with_its_border_repeated(size, corner, side, times, seed):
    image = np.random.default_rng(seed).integers(0, 256, (*size, 3), dtype=np.uint8)
    columns, rows = (
        np.clip(np.arange(first, first + side * times), 0, most - 1)
        for first, most in zip(corner, reversed(size), strict=True)
    )
    whole = np.ascontiguousarray(image[rows][:, columns])
    expected = cv2.resize(whole, (side, side), interpolation=cv2.INTER_AREA) if times > 1 else whole
    np.testing.assert_array_equal(_cut_shrunk(image, *corner, side, times), expected)
