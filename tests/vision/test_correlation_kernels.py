"""Filters resized and answers read, against plain sums and polynomials."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from bayesnet_track.vision.kernels.correlation_kernels import add_product, read_answers, resized_filter


def test_scale_1_keeps_the_filter() -> None:
    source = np.random.default_rng(1).normal(size=(3, 10, 10)).astype(np.float32)
    target = np.empty((3, 18, 18), np.float32)
    resized_filter(source, 1.0, target)
    np.testing.assert_allclose(target[:, :10, :10], source, atol=1e-6)  # float32 of some units
    assert not target[:, 10:].any() and not target[:, :, 10:].any()


@pytest.mark.parametrize("scale", [0.8, 1.1, 1.3])
def test_a_resized_bump_stays_in_the_middle_keeps_its_sum_and_grows(scale: float) -> None:
    place = np.arange(24) - 11.5
    line = np.exp(-0.5 * (place / 2.5) ** 2)
    target = np.empty((1, 40, 40), np.float32)
    resized_filter(np.outer(line, line)[None].astype(np.float32), scale, target)
    total = target.sum()
    # linear interpolation between cells of a bump of 2.5 cells adds at most 1 / (8 * 2.5^2) = 2 % of its peak
    assert total == pytest.approx(line.sum() ** 2, rel=0.02)
    profile = target[0, :24, :24].sum(axis=0) / total
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
    read = np.full(50, np.nan)
    which = np.arange(0, 50, 2)
    read_answers(maps, -1, x, y, levels, which, read)
    np.testing.assert_allclose(read[which], value(levels, x, y)[which], rtol=1e-6)  # maps are float32
    assert np.isnan(read[1::2]).all()


def test_places_beyond_the_map_read_its_rim() -> None:
    maps = np.random.default_rng(3).normal(size=(1, 8, 8)).astype(np.float32)
    x = np.array([-5.0, 1.0, 99.0, 6.0])
    read = np.empty(4)
    read_answers(maps, 0, x, np.full(4, 4.0), np.zeros(4), np.arange(4), read)
    assert read[0] == read[1] and read[2] == read[3] == maps[0, 4, 6]


@pytest.mark.parametrize("side", [4, 24, 64])
def test_a_product_of_spectra_is_that_of_opencv_to_the_bit(side: int) -> None:
    rng = np.random.default_rng(side)
    one, other, total = (rng.normal(size=(side, side)).astype(np.float32) for _ in range(3))
    one, other = cv2.dft(one), cv2.dft(other)
    expected = total + cv2.mulSpectrums(one, other, 0, conjB=True)
    add_product(one, other, total)
    np.testing.assert_array_equal(total, expected)
