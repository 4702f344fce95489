"""Uniform cubic B-splines against scipy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from bayesnet_track.vision.shape import CONTROL_POINTS, basis, curve_matrix, fit_matrix


@settings(max_examples=30, deadline=None)
@given(
    controls=st.integers(4, 50),
    at=st.lists(st.floats(0, 1, exclude_max=True), min_size=1, max_size=9),
    seed=st.integers(0, 99),
)
def test_the_curve_is_scipys_closed_uniform_cubic(controls: int, at: list[float], seed: int) -> None:
    points = np.random.default_rng(seed).normal(size=(controls, 2))
    # scipy's control point i has its greatest weight at knot i + 2 of its support, ours at parameter i
    wrapped = np.concatenate([points, points[:3]])
    spline = BSpline(np.arange(-3.0, controls + 4.0), wrapped, 3)
    where = np.array(at) * controls
    shifted = (where - 1.0) % controls
    np.testing.assert_allclose(basis(where, controls) @ points, spline(shifted), atol=1e-9)


def test_the_fit_is_the_least_squares_one() -> None:
    rng = np.random.default_rng(3)
    for count in (CONTROL_POINTS, 64, 100):
        points = rng.normal(size=(count, 2))
        matrix = basis(np.arange(count) * (CONTROL_POINTS / count), CONTROL_POINTS)
        expected = np.linalg.lstsq(matrix, points, rcond=None)[0]
        np.testing.assert_allclose(fit_matrix(count) @ points, expected, atol=1e-8)


def test_a_spline_is_fitted_to_itself() -> None:
    controls = np.random.default_rng(4).normal(size=(CONTROL_POINTS, 2))
    back = fit_matrix(64) @ (curve_matrix(64) @ controls)
    np.testing.assert_allclose(back, controls, atol=1e-9)


def test_a_circle_stays_a_circle() -> None:
    angle = 2 * np.pi * np.arange(64) / 64
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    curve = curve_matrix(80) @ (fit_matrix(64) @ circle)
    # an interpolating cubic errs by h^4 / 384 times the fourth derivative, h = 2 pi / 40: below 2e-6
    assert np.abs(np.hypot(*curve.T) - 1).max() < 1e-5


def test_nobody_changes_the_shared_matrices() -> None:
    with pytest.raises(ValueError, match="read-only"):
        fit_matrix(64)[0, 0] = 1.0
