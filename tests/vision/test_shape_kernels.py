"""Signed distances and shape scores against brute force and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt

from bayesnet_track.vision.kernels.shape_kernels import (
    cell_fields,
    map_points,
    score_shapes,
    shape_energy,
    shape_vector,
    signed_distance,
)


def field_of(contour: np.ndarray, xs: np.ndarray, ys: np.ndarray) -> np.ndarray:
    field = np.empty((len(ys), len(xs)))
    signed_distance(contour, xs, ys, field)
    return field


def star(seed: int, corners: int = 11) -> np.ndarray:
    """A polygon around (0, 0) that does not cross itself, not convex."""
    radius = np.random.default_rng(seed).uniform(0.4, 1.0, corners)
    angle = 2 * np.pi * np.arange(corners) / corners
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def brute(contour: np.ndarray, point: np.ndarray) -> float:
    """Distance to densely drawn sides; the sign by the angle that the polygon turns around the point."""
    after = np.roll(contour, -1, axis=0)
    share = np.linspace(0, 1, 4001)[:, None, None]
    drawn = contour + share * (after - contour)
    angle = np.arctan2(*(contour - point).T[::-1])
    turn = np.angle(np.exp(1j * (np.roll(angle, -1) - angle))).sum()
    nearest = np.hypot(*np.moveaxis(drawn - point, -1, 0)).min()
    return -nearest if abs(turn) > np.pi else nearest


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), x=st.floats(-1.5, 1.5), y=st.floats(-1.5, 1.5))
@example(seed=0, x=1.0, y=-1e-38)  # a hair's breadth beside the row of a corner
def test_distances_are_those_of_brute_force(seed: int, x: float, y: float) -> None:
    contour = star(seed)
    got = field_of(contour, np.array([x]), np.array([y]))[0, 0]
    # sides are shorter than 2 and drawn in steps of 1/4000: a step is at most 5e-4, the error at most half
    assert abs(got) == pytest.approx(abs(brute(contour, np.array([x, y]))), abs=2.5e-4)
    if abs(got) > 1e-3:
        assert got == pytest.approx(brute(contour, np.array([x, y])), abs=2.5e-4)


def test_distances_agree_with_scipys_transform() -> None:
    """A rectangle whose sides run through pixel edges: the transform counts from pixel centres."""
    xs, ys = np.arange(40.0), np.arange(30.0)
    contour = np.array([[9.5, 7.5], [30.5, 7.5], [30.5, 20.5], [9.5, 20.5]])
    field = field_of(contour, xs, ys)
    inside = np.zeros((30, 40), bool)
    inside[8:21, 10:31] = True
    assert np.array_equal(field < 0, inside)
    # distance to the rim is up to half a pixel less than to the first pixel beyond it; at corners sqrt(2)/2
    beyond = np.where(inside, distance_transform_edt(inside), distance_transform_edt(~inside))
    assert (np.abs(field) <= beyond).all() and (np.abs(field) >= beyond - np.sqrt(0.5) - 1e-9).all()


def test_a_circles_distance_is_the_radius() -> None:
    angle = 2 * np.pi * np.arange(400) / 400
    contour = np.column_stack([3 + 5 * np.cos(angle), -2 + 5 * np.sin(angle)])
    xs, ys = np.linspace(-4, 10, 15), np.linspace(-9, 5, 13)
    exact = np.hypot(xs[None] - 3, ys[:, None] + 2) - 5
    # a chord of 1/400 turn lies at most 5 (1 - cos(pi / 400)) inside the circle
    np.testing.assert_allclose(field_of(contour, xs, ys), exact, atol=5 * (1 - np.cos(np.pi / 400)) + 1e-12)


def test_a_vector_is_the_same_at_any_place_and_scale() -> None:
    box, found = np.array([2.0, -1.0, 3.0, 2.0]), []
    for scale, shift in ((1.0, [0.0, 0.0]), (7.3, [40.0, 11.0]), (0.2, [-5.0, 0.3])):
        contour = (star(5) + box[:2]) * scale + shift
        moved = np.concatenate([box[:2] * scale + shift, box[2:] * scale])
        fields, vector = np.empty((1, 24, 24)), np.empty(256)
        cell_fields(contour[None], moved[None], 1.5, fields)
        shape_vector(fields[0], moved, 1.5, moved, vector)
        found.append(vector)
    np.testing.assert_allclose(found[1], found[0], atol=1e-9)
    np.testing.assert_allclose(found[2], found[0], atol=1e-9)


def test_a_shifted_box_sees_the_field_shifted() -> None:
    """A half plane's distance is linear, which bilinear sampling keeps exactly."""
    contour = np.array([[-1e3, 0.0], [1e3, 0.0], [1e3, 1e3], [-1e3, 1e3]])
    cell, box = np.array([0.0, 0.0, 20.0, 10.0]), np.array([1.5, -1.0, 18.0, 11.0])
    fields, vector = np.empty((1, 24, 24)), np.empty(16)
    cell_fields(contour[None], cell[None], 1.5, fields)
    shape_vector(fields[0], cell, 1.5, box, vector)
    rows = box[1] + (np.arange(4) + 0.5) / 4 * box[3] - box[3] / 2
    expected = -rows * 2 / np.sqrt(box[2] * box[3])
    np.testing.assert_allclose(vector.reshape(4, 4), np.repeat(expected[:, None], 4, axis=1), atol=1e-12)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 999), modes=st.integers(0, 5), noise=st.floats(0.05, 3.0))
def test_the_energy_is_that_of_the_full_gaussian(seed: int, modes: int, noise: float) -> None:
    rng = np.random.default_rng(seed)
    axes = np.ascontiguousarray(np.linalg.qr(rng.normal(size=(25, 25)))[0][:modes])
    variances, mean, vector = rng.uniform(0.1, 4, modes), rng.normal(size=25), rng.normal(size=25)
    covariance = axes.T @ np.diag(variances) @ axes + noise * np.eye(25)
    expected = (vector - mean) @ np.linalg.solve(covariance, vector - mean)
    assert shape_energy(vector, mean, axes, variances, noise) == pytest.approx(expected, rel=1e-9)


def test_what_lies_outside_the_modes_counts() -> None:
    mean, modes = np.zeros(16), np.eye(16)[:2]
    outside = 3.0 * np.eye(16)[7]
    assert shape_energy(mean, mean, modes, np.ones(2), 0.5) == 0.0
    assert shape_energy(outside, mean, modes, np.ones(2), 0.5) == pytest.approx(9 / 0.5)


def test_boxes_without_a_field_are_left_alone() -> None:
    fields, cells = np.zeros((1, 24, 24)), np.array([[0.0, 0, 10, 10]])
    energies = np.full(2, -7.0)
    empty = np.zeros((0, 16)), np.zeros(0)
    score_shapes(
        fields, cells, 1.5, np.array([-1, 0]), np.repeat(cells, 2, 0), np.zeros(16), *empty, 1.0, energies
    )
    assert energies.tolist() == [-7.0, 0.0]


def test_points_are_mapped_run_by_run() -> None:
    rng = np.random.default_rng(1)
    matrix, points = rng.normal(size=(5, 7)), rng.normal(size=(3, 7, 2))
    mapped = np.empty((3, 5, 2))
    map_points(matrix, points, mapped)
    np.testing.assert_allclose(mapped, matrix @ points, atol=1e-12)
