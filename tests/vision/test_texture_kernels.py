"""Shares of codes in the cells of boxes, counted pixel by pixel."""

import numpy as np

from bayesnet_track.vision.kernels.patch_kernels import (
    bhattacharyya,
    binary_patterns,
    cell_shares,
    counted_shares,
    gradient_directions,
    integral_histogram,
)

CODES = np.random.default_rng(0).integers(0, 3, (6, 8)).astype(np.uint8)
X0, Y0 = 10, 20
"""The frame's place of the codes' first pixel."""


def test_the_integral_counts_what_lies_above_and_left():
    integral = np.full((7, 9, 3), -1, np.int32)
    integral_histogram(CODES, integral)
    expected = np.zeros((7, 9, 3), int)
    expected[1:, 1:] = (CODES[..., None] == np.arange(3)).cumsum(0).cumsum(1)
    np.testing.assert_array_equal(integral, expected)


def test_shares_are_of_the_whole_cell_and_nothing_lies_outside():
    integral = np.empty((7, 9, 3), np.int32)
    integral_histogram(CODES, integral)
    boxes = np.array(
        [
            [12.5, 22.5, 4.0, 4.0],  # pixels 11 .. 14 and 21 .. 24: cells of 2 x 2
            [12.5, 22.0, 4.0, 6.0],  # 19 .. 24: cells of 2 x 3, the upper ones over the edge
            [9.5, 24.5, 8.0, 8.0],
            [17.5, 25.5, 6.0, 2.0],
            [13.0, 22.0, 0.25, 0.25],  # smaller than a pixel: cells of one pixel each
            [60.0, 22.0, 4.0, 4.0],
        ]
    )
    shares = np.full((len(boxes), 2, 2, 3), np.nan)
    cell_shares(integral, boxes, X0, Y0, 2, shares)
    for (x, y, w, h), found in zip(boxes, shares, strict=True):
        left, top = x - w / 2 + 0.5, y - h / 2 + 0.5
        for i in range(2):
            upper = int(np.floor(top + h * i / 2 + 0.5))
            lower = max(int(np.floor(top + h * (i + 1) / 2 + 0.5)), upper + 1)
            for j in range(2):
                near = int(np.floor(left + w * j / 2 + 0.5))
                far = max(int(np.floor(left + w * (j + 1) / 2 + 0.5)), near + 1)
                inside = [
                    CODES[row - Y0, column - X0]
                    for row in range(upper, lower)
                    for column in range(near, far)
                    if Y0 <= row < Y0 + 6 and X0 <= column < X0 + 8
                ]
                expected = np.bincount(np.array(inside, int), minlength=3) / ((far - near) * (lower - upper))
                np.testing.assert_allclose(found[i, j], expected)
    assert shares[0].sum() == 4.0 and shares[-1].sum() == 0.0
    counted = np.full_like(shares, np.nan)
    counted_shares(CODES, boxes, X0, Y0, 2, counted)
    np.testing.assert_array_equal(counted, shares)


def test_directions_are_those_of_the_angle_for_every_gradient():
    dx, dy = (one.ravel() for one in np.meshgrid(np.arange(-255, 256), np.arange(-255, 256)))
    gray = np.zeros((3, 3 * len(dx)), np.uint8)  # every third pixel has a gradient of its own
    gray[1, 0::3], gray[1, 2::3] = np.maximum(-dx, 0), np.maximum(dx, 0)
    gray[0, 1::3], gray[2, 1::3] = np.maximum(-dy, 0), np.maximum(dy, 0)
    codes = np.empty((1, gray.shape[1] - 2), np.uint8)
    gradient_directions(gray, 8, codes)
    sectors = np.rint(np.degrees(np.arctan2(dy, dx)) / 45).astype(int) % 8
    np.testing.assert_array_equal(codes[0, 0::3], np.where(np.abs(dx) + np.abs(dy) <= 8, 8, sectors))


def test_the_coefficient_is_the_mean_over_the_cells():
    rng = np.random.default_rng(1)
    shares, reference = rng.dirichlet(np.ones(3), (4, 2, 2)), rng.dirichlet(np.ones(3), (2, 2))
    shares[1] = reference
    shares[2] = 2 * reference  # cannot be, but for rounding: 1 at most
    found = np.full(4, np.nan)
    bhattacharyya(shares, reference, found)
    np.testing.assert_allclose(found[[0, 3]], np.sqrt(shares * reference).sum((1, 2, 3))[[0, 3]] / 4)
    np.testing.assert_allclose(found[1:3], [1.0, 1.0])


def test_each_direction_and_each_limit():
    """A gray level's gradient in each sector; `noise` itself is flat."""
    for dx, dy, code in [
        (20, 0, 0), (20, 8, 0), (20, 9, 1), (9, 20, 1), (8, 20, 2), (0, 20, 2), (-8, 20, 2), (-9, 20, 3),
        (-20, 9, 3), (-20, 8, 4), (-20, -8, 4), (-20, -9, 5), (-9, -20, 5), (-8, -20, 6), (8, -20, 6),
        (9, -20, 7), (20, -9, 7), (20, -8, 0), (5, 5, 8), (10, 0, 8), (6, 5, 1), (11, 0, 0),
    ]:  # fmt: skip
        gray = np.full((3, 3), 100, np.uint8)
        gray[1, 2], gray[2, 1] = 100 + dx, 100 + dy
        codes = np.full((1, 1), 77, np.uint8)
        gradient_directions(gray, 10, codes)
        assert codes[0, 0] == code, (dx, dy)


def test_patterns_of_single_rings():
    """Neighbours clockwise from the upper left, 1 for brighter."""
    ring = [(0, 0), (0, 1), (0, 2), (1, 2), (2, 2), (2, 1), (2, 0), (1, 0)]
    for bits in range(256):
        gray = np.full((3, 3), 50, np.uint8)
        on = [bits >> k & 1 for k in range(8)]
        for place, bright in zip(ring, on, strict=True):
            gray[place] = 56 if bright else 55  # exceeds by more than 5, or by 5
        codes = np.full((1, 1), 77, np.uint8)
        binary_patterns(gray, 5, codes)
        changes = sum(on[k] != on[k - 1] for k in range(8))
        assert codes[0, 0] == (sum(on) if changes <= 2 else 9)
