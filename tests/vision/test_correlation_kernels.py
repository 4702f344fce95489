"""Filters resized and answers read, against plain sums and polynomials."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from bayesnet_track.vision.correlation import halves, scaled_answers, spectral_halves, tile_spectra
from bayesnet_track.vision.kernels.correlation_kernels import add_answers, conjugate_product


@pytest.mark.parametrize(("side", "around"), [(8, 24), (10, 30), (24, 64)])
def test_a_product_at_scale_1_is_that_of_plain_spectra(side: int, around: int) -> None:
    """Packed as OpenCV has it, for sides of the filter that are and are not multiples of 8."""
    rng = np.random.default_rng(side)
    patch = rng.normal(size=(3, around, around)).astype(np.float32)
    kernel = rng.normal(size=(3, side, side)).astype(np.float32)
    placed = np.zeros_like(patch)
    placed[:, :side, :side] = kernel
    expected = sum(
        cv2.mulSpectrums(cv2.dft(one), cv2.dft(other), 0, conjB=True)
        for one, other in zip(patch, placed, strict=True)
    )
    total = np.full((around, around), np.nan, np.float32)
    conjugate_product(tile_spectra(patch, side), spectral_halves(halves(kernel), around, 1.0), total)
    scale = float(np.abs(expected).max())
    np.testing.assert_allclose(total, expected, atol=2e-6 * scale)  # float32


@pytest.mark.parametrize("scale", [0.8, 1.1, 1.3])
def test_a_resized_bump_stays_in_the_middle_keeps_its_sum_and_grows(scale: float) -> None:
    """The answers to a single cell that is not nothing are the filter, mirrored."""
    place = np.arange(24) - 11.5
    line = np.exp(-0.5 * (place / 2.5) ** 2)
    dot = np.zeros((1, 64, 64), np.float32)
    dot[0, 32, 32] = 1.0
    bump = halves(np.outer(line, line)[None].astype(np.float32))
    found = scaled_answers(tile_spectra(dot, 24), bump, scale)[9:33, 9:33]
    total = found.sum()
    # linear interpolation between cells of a bump of 2.5 cells adds at most 1 / (8 * 2.5^2) = 2 % of its peak
    assert total == pytest.approx(line.sum() ** 2, rel=0.02)
    for profile in (found.sum(axis=0) / total, found.sum(axis=1) / total):
        assert profile @ place == pytest.approx(0.0, abs=1e-3)
        assert np.sqrt(profile @ place**2) == pytest.approx(2.5 * scale, rel=0.03)


def test_answers_are_exact_for_quadratics_between_cells_and_lines_between_levels() -> None:
    """Catmull and Rom's cubic reproduces polynomials up to the second degree."""
    rows, columns = np.mgrid[:12, :12].astype(float)

    def value(level: float, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return (3.0 + 2.0 * level) * (1.0 + 0.5 * x - 0.25 * y + 0.125 * x * x - 0.0625 * x * y)

    maps = np.stack([value(level, columns, rows) for level in (-1, 0, 1)]).astype(np.float32)
    rng = np.random.default_rng(2)
    x, y, levels = rng.uniform(1, 10, 50), rng.uniform(1, 10, 50), rng.uniform(-1, 1, 50)
    boxes = np.column_stack([100 + 3.0 * (x - 5.5), 60 + 3.0 * (y - 5.5), x, x])  # cells of 3 px
    read, which, shares = np.ones(50), np.arange(0, 50, 2), np.tile([0.0, 0.5, 0.5, 1.0, 1.0], 5)
    add_answers(maps, -1, boxes, (100.0, 60.0, 3.0), which, levels[which], shares, read)
    expected = 1.0 + shares * value(levels, x, y)[which]
    np.testing.assert_allclose(read[which], expected, rtol=1e-6)  # maps are float32
    assert (read[1::2] == 1.0).all()


def test_places_beyond_the_map_read_its_rim() -> None:
    maps = np.random.default_rng(3).normal(size=(1, 8, 8)).astype(np.float32)
    x = np.array([-5.0, 1.0, 99.0, 6.0])
    boxes, read = np.column_stack([x, np.full((4, 3), 4.0)]), np.zeros(4)
    add_answers(maps, 0, boxes, (3.5, 3.5, 1.0), np.arange(4), np.zeros(4), np.ones(4), read)
    assert read[0] == read[1] and read[2] == read[3] == maps[0, 4, 6]
