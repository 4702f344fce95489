"""The edges that shapes are made from."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Region
from bayesnet_track.vision.planes import CONTRASTS, EdgePlane


def edges_of(gray: np.ndarray, plane: EdgePlane, region: Region | None = None) -> np.ndarray:
    frame = Frame(0, 0.0, cv2.merge([gray] * 3))
    whole = Region(0, 0, frame.width, frame.height)
    return PlaneCache(FramePair(frame, None)).planes([plane], region or whole)[plane]


def textured(seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).integers(0, 256, (90, 120), dtype=np.uint8)
    return cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 3.0), None, 0, 255, cv2.NORM_MINMAX)


def test_each_bit_is_canny_at_its_threshold() -> None:
    gray, plane = textured(), EdgePlane(4.0, 1.0)
    points = edges_of(gray, plane)
    smooth = cv2.GaussianBlur(gray, (0, 0), 1.0)
    for bit, factor in enumerate(CONTRASTS):
        high = 8 * factor * 4.0
        y, x = np.nonzero(cv2.Canny(smooth, high / 2, high, L2gradient=True))
        found = points[(points[:, 2] >> bit & 1) == 1, :2]
        assert len(found) > 20
        assert set(map(tuple, found)) == set(zip(x, y, strict=True))


def test_stronger_edges_are_among_the_fainter_ones() -> None:
    usual, faint, strong = (edges_of(textured(), EdgePlane(4.0))[:, 2] >> bit & 1 for bit in range(3))
    assert (strong <= usual).all() and (usual <= faint).all()
    assert strong.sum() < usual.sum() < faint.sum()


@pytest.mark.parametrize("slope", [6.0, 10.0])
def test_the_threshold_is_in_gray_levels_per_pixel(slope: float) -> None:
    """A ramp of a known slope: one edge line when it is above the threshold of 8, none below."""
    across = np.clip(100 + slope * (np.arange(80) - 40), 60, 140).round().astype(np.uint8)
    points = edges_of(np.repeat(across[None], 40, axis=0), EdgePlane(8.0, 0.0))
    usual = points[(points[:, 2] & 1) == 1]
    assert (len(usual) > 0) == (slope > 8)
    assert (np.abs(usual[:, 0] - 40) <= 80 / slope / 2 + 1).all()


def test_the_region_asked_for_changes_nothing() -> None:
    gray, plane = textured(), EdgePlane(4.0)
    assert np.array_equal(edges_of(gray, plane), edges_of(gray, plane, Region(30, 20, 50, 40)))
    assert np.array_equal(edges_of(gray, plane), edges_of(gray, plane, Region(0, 0, 0, 0)))


def test_a_flat_picture_has_none() -> None:
    assert edges_of(np.full((40, 50), 99, np.uint8), EdgePlane()).shape == (0, 3)
