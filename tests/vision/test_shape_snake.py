"""Snakes find drawn outlines and keep to what an active contour promises."""

from __future__ import annotations

import numpy as np
import pytest

from bayesnet_track.vision.kernels import shape_kernels
from bayesnet_track.vision.kernels.shape_kernels import POINTS, STAGES, run_snakes, smoothing_filters

FRAME = np.array([160, 120])


def snakes_of(edges: np.ndarray, boxes: list[list[float]]) -> tuple[np.ndarray, np.ndarray]:
    """Snakes on a map of exact distances to edge points (E, 2), which need not be pixels."""
    y, x = np.mgrid[: FRAME[1], : FRAME[0]]
    distance = np.full(x.shape, 1e6)
    for edge in edges:
        distance = np.minimum(distance, np.hypot(x - edge[0], y - edge[1]))
    snakes, support = np.empty((len(boxes), POINTS, 2)), np.zeros(len(boxes))
    steps = np.array([stage[2] for stage in STAGES])
    origin = np.zeros(2, np.int64)
    run_snakes(
        distance, origin, FRAME, np.array(boxes), smoothing_filters(), steps, 0.25, 0.05, snakes, support
    )
    return snakes, support


def ellipse(x: float, y: float, across: float, down: float, count: int = 200) -> np.ndarray:
    angle = 2 * np.pi * np.arange(count) / count
    return np.column_stack([x + across * np.cos(angle), y + down * np.sin(angle)])


def test_the_filters_solve_the_snakes_equation() -> None:
    eye = np.eye(POINTS)
    second = 2 * eye - np.roll(eye, 1, axis=0) - np.roll(eye, -1, axis=0)
    for row, (tension, rigidity, _) in zip(smoothing_filters(), STAGES, strict=True):
        exact = np.linalg.inv(eye + tension * second + rigidity * second @ second)[0]
        # up to 64 weights below 1e-5 are left out, and their sum is spread over the others
        np.testing.assert_allclose(row, exact, atol=1.1e-5 + 64e-5 * np.abs(exact).max())
        assert row.sum() == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("offset", [(0, 0), (4, -3), (-4, 4)])
def test_a_snake_finds_an_ellipse(offset: tuple[int, int]) -> None:
    edges = ellipse(80, 60, 25, 18)
    (snake,), (support,) = snakes_of(edges, [[80.0 + offset[0], 60 + offset[1], 50, 36]])
    away = np.abs(np.hypot((snake[:, 0] - 80) / 25, (snake[:, 1] - 60) / 18) - 1) * 18
    assert away.max() < 1.0  # the map is sampled once per pixel
    assert support == 1.0


def test_points_are_even_and_go_round_once() -> None:
    (snake,), _ = snakes_of(ellipse(80, 60, 25, 18), [[82.0, 58, 50, 36]])
    steps = np.hypot(*(np.roll(snake, -1, axis=0) - snake).T)
    assert steps.max() / steps.min() < 1.1
    angle = np.unwrap(np.arctan2(snake[:, 1] - 60, snake[:, 0] - 80))
    assert angle[-1] - angle[0] == pytest.approx(2 * np.pi * (POINTS - 1) / POINTS, abs=0.2)


def test_without_edges_it_rests_unsupported() -> None:
    (snake,), (support,) = snakes_of(np.empty((0, 2)), [[80.0, 60, 50, 36]])
    away = np.hypot((snake[:, 0] - 80) / 25, (snake[:, 1] - 60) / 18)
    assert np.abs(away - 1).max() < 0.1  # tension draws it in a little
    assert support == 0.0


def test_only_what_lies_in_the_frame_is_supported() -> None:
    _, (support,) = snakes_of(ellipse(0, 60, 25, 18), [[0.0, 60, 50, 36]])
    assert 0.35 < support < 0.6


def test_no_snake_leaves_its_bound_or_depends_on_the_others() -> None:
    edges = np.random.default_rng(2).uniform(0, 120, (300, 2))
    boxes = [[40.0, 40, 30, 50], [70.0, 60, 40, 40], [20.0, 90, 60, 30], [10.0, 10, 2, 1]]
    together = snakes_of(edges, boxes)
    for k, box in enumerate(boxes):
        reach = np.abs(together[0][k] - box[:2]) / box[2:]
        assert (reach <= 0.5 * shape_kernels.BOUND + 1e-9).all()
        alone = snakes_of(edges, [box])
        assert np.array_equal(alone[0][0], together[0][k]) and alone[1][0] == together[1][k]
