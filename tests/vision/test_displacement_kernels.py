"""Patches are compared at every displacement; where they leave the image, nothing fits."""

import numpy as np

from bayesnet_track.vision.kernels.dense_flow_kernels import match_patches


def test_squares_are_means_of_squared_differences_inside_the_image():
    rng = np.random.default_rng(2)
    image = rng.integers(0, 256, (7, 9), dtype=np.uint8)
    origin = np.array([10, 20])  # column and row in the frame of the image's first pixel
    points = np.array([[14, 23], [11, 25]])
    patches = rng.uniform(0, 255, (2, 3, 3))
    across, down = np.arange(-3, 5), np.arange(-2, 3)
    squares = np.full((2, 5, 8), np.nan)
    match_patches(image, origin, points, patches, across, down, squares)
    for n, (x, y) in enumerate(points):
        for j, dy in enumerate(down):
            for i, dx in enumerate(across):
                row, column = y + dy - 20, x + dx - 10  # of the patch's middle in the image
                if 1 <= row <= 5 and 1 <= column <= 7:
                    seen = image[row - 1 : row + 2, column - 1 : column + 2].astype(float)
                    np.testing.assert_allclose(squares[n, j, i], np.mean((patches[n] - seen) ** 2))
                else:
                    assert squares[n, j, i] == np.inf
    assert np.isinf(squares).any(axis=(1, 2)).all() and np.isfinite(squares).any(axis=(1, 2)).all()
