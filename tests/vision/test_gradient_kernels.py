"""Oriented gradients on ramps and edges whose histograms are known."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track.vision.kernels.correlation_kernels import (
    TRUNCATED,
    cell_means,
    normalised_cells,
    oriented_gradients,
)

SIGNED = 8
SIDE = 48


def histograms_of(gray: np.ndarray, count: int = SIGNED) -> np.ndarray:
    histograms = np.empty((gray.shape[0] // 4, gray.shape[1] // 4, count), np.float32)
    oriented_gradients(gray, SIGNED // 2, histograms)
    return histograms


def ramp(degrees: float) -> np.ndarray:
    """Brightness that rises by about 2 gray levels a pixel toward `degrees` (0 right, 90 down)."""
    y, x = np.mgrid[:SIDE, :SIDE] - SIDE / 2
    turn = np.radians(degrees)
    return np.rint(128 + 2.0 * (x * np.cos(turn) + y * np.sin(turn))).astype(np.uint8)


@pytest.mark.parametrize("degrees", [0, 90, 180, 270])
def test_a_ramp_votes_by_the_fourth_power_of_the_cosine(degrees: float) -> None:
    """Central differences of 4 on 16 pixels a cell: 64 for its own direction, 64 / 4 at 45 degrees."""
    inner = histograms_of(ramp(degrees))[2:-2, 2:-2]
    expected = np.zeros(SIGNED)
    k = round(degrees / 45)
    expected[k % 8], expected[(k + 1) % 8], expected[(k - 1) % 8] = 64.0, 16.0, 16.0
    # float32: some 1e-7 of the largest at each of tens of additions
    np.testing.assert_allclose(inner, np.broadcast_to(expected, inner.shape), atol=1e-3)


@pytest.mark.parametrize("degrees", [20.0, 45.0, 77.0, 200.0, 291.0])
def test_every_direction_has_the_same_votes_in_all(degrees: float) -> None:
    """sum_k cos^4(t - 45 k) = 3 / 2; the rounding of gray levels makes single gradients long or short."""
    inner = histograms_of(ramp(degrees))[2:-2, 2:-2]
    assert inner.sum(axis=2).mean() == pytest.approx(1.5 * 64.0, rel=0.05)
    means = inner.mean(axis=(0, 1))
    assert np.argmax(means) == round(degrees / 45) % 8


def test_a_pixel_is_shared_between_the_nearest_cells_by_distance() -> None:
    """One step of 60 from column 23 to 24: votes of 60 at both columns, 3.5 and 0.5 px from two centres."""
    gray = np.full((SIDE, SIDE), 100, np.uint8)
    gray[:, 24:] = 160
    row = histograms_of(gray)[5, :, 0]
    # a cell's centre is 4 i + 1.5; shares (1 - d / 4) of columns 23 and 24; 4 lines of pixels a cell
    centres = 4 * np.arange(SIDE // 4) + 1.5
    shares = sum(np.clip(1 - np.abs(centres - column) / 4, 0, None) for column in (23, 24))
    np.testing.assert_allclose(row, 4 * 60 * shares, atol=1e-3)


def test_cells_are_indifferent_to_contrast_and_blind_to_faint_grain() -> None:
    rng = np.random.default_rng(4)
    pattern = rng.integers(0, 60, (SIDE, SIDE)).astype(np.uint8)

    def features(gray: np.ndarray) -> np.ndarray:
        made = np.zeros((SIGNED * 3 // 2, SIDE // 4 - 2, SIDE // 4 - 2), np.float32)
        normalised_cells(histograms_of(gray), SIGNED // 2, 400.0, made)
        return made

    weak, strong = features(pattern), features(pattern * 4)
    np.testing.assert_allclose(weak, strong, rtol=0.02)  # energies are some 100 times the noise's 400
    assert strong.max() <= TRUNCATED
    grain = features((pattern > 58).astype(np.uint8))  # one pixel of 60 by one gray level
    assert grain.mean() < 0.1 * strong.mean()
    assert not features(np.full((SIDE, SIDE), 90, np.uint8)).any()


def test_turning_light_to_dark_swaps_opposite_orientations() -> None:
    rng = np.random.default_rng(5)
    pattern = rng.integers(0, 256, (SIDE, SIDE)).astype(np.uint8)
    one, other = histograms_of(pattern), histograms_of(255 - pattern)
    np.testing.assert_array_equal(one, np.roll(other, SIGNED // 2, axis=2))


def test_without_signs_are_the_same_features_without_the_others() -> None:
    gray = np.random.default_rng(6).integers(0, 256, (SIDE, SIDE)).astype(np.uint8)
    half, side = SIGNED // 2, SIDE // 4 - 2
    every, alike = np.zeros((3 * half, side, side), np.float32), np.zeros((half, side, side), np.float32)
    normalised_cells(histograms_of(gray), half, 400.0, every)
    normalised_cells(histograms_of(gray, half), half, 400.0, alike)
    np.testing.assert_allclose(alike, every[SIGNED:], rtol=1e-5)  # sums of float32 in another order


def test_means_of_cells_are_those_of_an_exact_division_rounded_to_even() -> None:
    pixels = np.random.default_rng(5).integers(0, 256, (4 * 9, 4 * 7, 3), dtype=np.uint8)
    pixels[:4, :4] = 10
    pixels[0, :2, 0] = 14  # 168 / 16 = 10.5, which is rounded to 10
    pixels[4:8, :4] = 11
    pixels[4, :2, 0] = 15  # 184 / 16 = 11.5, which is rounded to 12
    means = np.empty((9, 7, 3), np.uint8)
    cell_means(pixels.reshape(36, -1), means.reshape(9, -1))
    exact = pixels.reshape(9, 4, 7, 4, 3).mean(axis=(1, 3))
    np.testing.assert_array_equal(means, np.rint(exact))
    assert means[0, 0, 0] == 10
    assert means[1, 0, 0] == 12
