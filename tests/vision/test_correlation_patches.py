"""Squares cut out of a frame and shrunk by whole pixels, also beyond its border."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from bayesnet_track.vision.correlation import _cut_shrunk


@given(
    size=st.tuples(st.integers(1, 40), st.integers(1, 40)),
    corner=st.tuples(st.integers(-120, 120), st.integers(-120, 120)),
    side=st.integers(1, 20),
    times=st.integers(1, 9),
    seed=st.integers(0, 100),
)
@settings(max_examples=300, deadline=None)
def test_squares_of_a_crop_are_means_of_four_pixels_with_the_border_repeated(size, corner, side, times, seed):
    image = np.random.default_rng(seed).integers(0, 256, (*size, 3), dtype=np.uint8)
    columns, rows = (
        np.clip(np.arange(first, first + side * times), 0, most - 1)
        for first, most in zip(corner, reversed(size), strict=True)
    )
    squares = image[rows][:, columns].reshape(side, times, side, times, 3).astype(int)
    near, far = times // 4, times - 1 - times // 4  # in the middle of each half of a square's side
    four = sum(squares[:, j, :, i] for j in (near, far) for i in (near, far))
    np.testing.assert_array_equal(_cut_shrunk(image, *corner, side, times), (four + 2) // 4)
