"""Lucas-Kanade: its sums against NumPy's, and points that follow a pattern moved by a known fraction."""

import numpy as np
import pytest

from bayesnet_track.observation.planes import for_reading
from bayesnet_track.vision.kernels.flow_kernels import (
    _copy,
    _gradients,
    _mismatch,
    _track_level,
    _weights,
    flow_in_boxes,
    track_points,
)

WINDOW = 5
STRIDE = WINDOW + 3


def pattern(dx=0.0, dy=0.0, size=32, scale=1.0):
    """Waves of two directions, moved by (dx, dy); `scale` pixels of the finest level to one here."""
    y, x = np.mgrid[:size, :size] * scale + (scale - 1) / 2
    x, y = x - dx, y - dy
    wave = 127 + 50 * np.sin(0.31 * x + 0.17 * y) + 50 * np.cos(0.13 * x - 0.29 * y)
    return np.rint(wave).astype(np.uint8)


def bilinear(image, x, y):
    """Values at (x + i, y + j) for the window's i and j, edge pixels repeated."""
    i, j = np.arange(WINDOW + 2) - 1, np.arange(WINDOW + 2) - 1
    x0, y0 = int(np.floor(x)), int(np.floor(y))
    rows, columns = (np.clip(at[:, None] + np.arange(2), 0, 31) for at in (y0 + j, x0 + i))
    fx, fy = x - x0, y - y0
    part = image.astype(float)[rows[:, None, :, None], columns[None, :, None, :]]
    return np.einsum("jiab,a,b->ji", part, [1 - fy, fy], [1 - fx, fx])


def mask():
    found = np.zeros(WINDOW * STRIDE, np.float32)
    for j in range(WINDOW):
        found[j * STRIDE : j * STRIDE + WINDOW] = 1.0
    return found


@pytest.mark.parametrize(("left", "top"), [(3, 4), (-2, 4), (3, -1), (27, 28), (24, 24)])
def test_a_crop_repeats_the_edge(left, top):
    raw = np.full(STRIDE * STRIDE, -1, np.float32)
    _copy(pattern(), left, top, STRIDE, STRIDE, raw)
    rows, columns = (np.clip(at + np.arange(STRIDE), 0, 31) for at in (top, left))
    np.testing.assert_array_equal(raw.reshape(STRIDE, STRIDE), pattern()[np.ix_(rows, columns)])


def test_bilinear_weights():
    np.testing.assert_allclose(_weights(0.25, 0.5), [0.375, 0.125, 0.375, 0.125])


def test_sums_of_gradients_and_of_the_mismatch():
    source, target, fx, fy = pattern(), pattern(0.6, -0.4), 0.3, 0.6
    windows = np.zeros((5, (WINDOW + 5) * STRIDE), np.float32)
    raw, smooth, patch, slopes = windows[0], windows[1], windows[2], windows[3:]
    _copy(source, 9, 12, STRIDE, STRIDE, raw)
    sums = _gradients(raw, fx, fy, WINDOW, mask(), smooth, patch, slopes)
    at = bilinear(source, 10 + fx, 13 + fy)
    gx, gy, value = (at[1:-1, 2:] - at[1:-1, :-2]) / 2, (at[2:, 1:-1] - at[:-2, 1:-1]) / 2, at[1:-1, 1:-1]
    np.testing.assert_allclose(sums, [(gx * gx).sum(), (gx * gy).sum(), (gy * gy).sum()], rtol=1e-4)
    for flat, expected in ((patch, value), (slopes[0], gx), (slopes[1], gy)):
        shown = flat[: WINDOW * STRIDE].reshape(WINDOW, STRIDE)[:, :WINDOW]
        np.testing.assert_allclose(shown, expected, atol=1e-3)
    _copy(target, 10, 13, WINDOW + 1, STRIDE, raw)
    away = value - bilinear(target, 10 + 0.7, 13 + 0.2)[1:-1, 1:-1]
    found = _mismatch(raw, 0.7, 0.2, WINDOW, patch, slopes)
    np.testing.assert_allclose(found, [(away * gx).sum(), (away * gy).sum()], rtol=1e-3)


def level(source, target, start=(0.0, 0.0), flow=(0.0, 0.0), limit=5.0, at=(15, 16)):
    windows, flow = np.zeros((5, (WINDOW + 5) * STRIDE), np.float32), np.array(flow)
    good = _track_level(source, target, *at, np.array(start), flow, WINDOW, mask(), windows, limit)
    return good, flow


def test_one_level_follows_a_fraction_of_a_pixel():
    for moved, start, first in [
        ((0.4, -0.7), (0.0, 0.0), (0.0, 0.0)),
        ((1.3, 0.9), (0.5, 0.25), (1.0, 1.0)),
        ((-1.2, 0.3), (-0.4, 0.8), (-1.0, 0.0)),
    ]:
        good, flow = level(pattern(), pattern(*moved), start, first)
        assert good
        np.testing.assert_allclose(flow, moved, atol=0.06)  # gray levels are rounded; a step of 0.03 ends it


def test_what_has_no_texture_or_goes_too_far_is_not_followed():
    flat = np.full((32, 32), 90, np.uint8)
    assert not level(flat, flat)[0]
    edge = np.tile(np.where(np.arange(32) < 16, 60, 160), (32, 1)).astype(np.uint8)
    assert not level(edge, edge)[0]  # of one direction only
    assert level(pattern(), pattern(1.5, 0.0), limit=2.5)[0]
    assert not level(pattern(), pattern(1.5, 0.0), limit=1.3)[0]
    assert not level(pattern(), pattern(0.0, -1.5), limit=1.3)[0]
    assert not level(pattern(), pattern(), start=(0.0, 1.4), limit=1.3)[0]


def tracked(moved, points, target=None, reach=9.0, agree=0.5, origin=(0, 0)):
    size = 48
    frames = []
    for by in ((0.0, 0.0), moved):
        frames.append([pattern(*by, size // s, s) for s in (4, 2, 1)])
    if target is not None:
        frames[1] = [target(one) for one in frames[1]]
    for levels in frames:
        levels[2] = for_reading(levels[2])
    flows, valid = np.full((len(points), 2), np.nan), np.full(len(points), 7, np.uint8)
    points = np.array(points) + origin
    track_points(*frames[0], *frames[1], points, np.array(origin), WINDOW, reach, agree, flows, valid)
    return flows, valid.tolist()


def test_points_follow_over_three_levels_and_back():
    points = [(20, 21), (27, 22), (23, 30)]
    for moved in ((3.3, -2.6), (-4.2, 1.5)):
        for origin in ((0, 0), (8, 4)):
            flows, valid = tracked(moved, points, origin=origin)
            assert valid == [1, 1, 1]
            np.testing.assert_allclose(flows, [moved] * 3, atol=0.1)


def test_points_that_leave_or_come_back_elsewhere_are_invalid():
    assert tracked((3.3, -2.6), [(20, 21)], agree=1e-6)[1] == [0]
    assert tracked((3.3, -2.6), [(20, 21)], reach=1.0)[1] == [0]
    assert tracked((6.0, 0.0), [(45, 21)])[1] == [0]
    assert tracked((0.0, 6.0), [(21, 45)])[1] == [0]
    assert tracked((-6.0, 0.0), [(2, 21)])[1] == [0]
    assert tracked((3.3, -2.6), [(20, 21)], target=lambda image: np.full_like(image, 80))[1] == [0]


def test_mean_flow_of_the_points_in_a_box():
    points = np.array(
        [[1.0, 2.0, 0.5, -1.0], [4.0, 2.0, 1.5, 1.0], [2.0, 6.0, 2.5, 0.25], [9.0, 9.0, 4.0, 4.0]]
    )
    boxes = np.array(
        [
            [2.5, 2.0, 3.0, 1.0],  # both points of the first row, on its edges
            [2.5, 4.0, 3.0, 4.0],  # the third, too
            [4.0, 2.0, 0.0, 0.0],
            [20.0, 2.0, 3.0, 3.0],
            [2.0, 20.0, 3.0, 3.0],
            [5.0, 5.0, 20.0, 20.0],
        ]
    )
    counts, means = np.full(6, np.nan), np.full((6, 2), np.nan)
    flow_in_boxes(for_reading(points), boxes, counts, means)
    assert counts.tolist() == [2, 3, 1, 0, 0, 4]
    np.testing.assert_allclose(
        means, [(1.0, 0.0), (1.5, 0.25 / 3), (1.5, 1.0), (0, 0), (0, 0), (8.5 / 4, 4.25 / 4)], atol=1e-6
    )
    flow_in_boxes(for_reading(np.empty((0, 4))), boxes[:1], counts, means)
    assert counts[0] == 0 and means[0].tolist() == [0.0, 0.0]
