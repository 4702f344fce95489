"""Rendering is exact area coverage plus independent Gaussian noise."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.sources.scenes.scene import Movie, Sprite, Veil, coverage, paint

FINE = 8  # boxes on a grid of 1/8 px, so that 8 x 8 sub-pixels reproduce area coverage without error
eighths = st.integers(-40, 200).map(lambda n: n / FINE)


def supersampled(
    cells: np.ndarray, box: tuple[float, ...], height: int, width: int, ground: float
) -> np.ndarray:
    x, y, w, h = box
    rows, columns = cells.shape[:2]
    ys = (np.arange(height * FINE) + 0.5) / FINE - 0.5
    xs = (np.arange(width * FINE) + 0.5) / FINE - 0.5
    row = np.floor((ys - (y - h / 2)) / h * rows).astype(int)
    column = np.floor((xs - (x - w / 2)) / w * columns).astype(int)
    fine = np.full((height * FINE, width * FINE, 3), ground)
    inside = np.outer((row >= 0) & (row < rows), (column >= 0) & (column < columns))
    fine[inside] = cells[np.clip(row, 0, rows - 1)][:, np.clip(column, 0, columns - 1)][inside]
    return fine.reshape(height, FINE, width, FINE, 3).mean(axis=(1, 3))


@given(left=eighths, top=eighths, columns=st.integers(1, 3), rows=st.integers(1, 3), side=st.integers(1, 6))
def test_painting_equals_supersampling(left, top, columns, rows, side):
    cells = np.random.default_rng(rows * 7 + columns).uniform(0, 255, (rows, columns, 3))
    w, h = side * columns / 2, side * rows / 2  # every cell is side / 2 px: its edges lie on the grid too
    box = (left + w / 2, top + h / 2, w, h)
    canvas = np.full((12, 20, 3), 77.0)
    paint(canvas, Sprite(cells, np.array([box])), 0)
    np.testing.assert_allclose(canvas, supersampled(cells, box, 12, 20, 77.0), atol=1e-9)


@given(
    centre=st.floats(-30, 60), size=st.floats(0.01, 40), cells=st.integers(1, 5), pixels=st.integers(1, 30)
)
def test_coverage_sums_to_the_part_inside(centre, size, cells, pixels):
    first, covered = coverage(centre, size, cells, pixels)
    assert 0 <= first <= first + covered.shape[0] <= pixels
    inside = min(centre + size / 2, pixels - 0.5) - max(centre - size / 2, -0.5)
    assert covered.sum() == pytest.approx(max(inside, 0.0), abs=1e-9)
    assert (covered.sum(axis=1) <= 1 + 1e-9).all()


def movie(noise_sd: float) -> Movie:
    path = np.tile([100.3, 80.0, 30.0, 20.0], (5, 1))
    return Movie(np.full((240, 320, 3), 120.0), (Sprite(np.full((1, 1, 3), 90.0), path),), noise_sd, seed=3)


def test_noise_has_the_stated_sd_and_is_independent():
    clean, noisy = movie(0.0), movie(4.0)
    first, second = (noisy[i].astype(float) - clean[i] for i in (1, 2))
    n = first.size
    # Rounding to whole gray levels adds 1/12 to the variance; 5 standard errors for n samples.
    assert abs(first.std() - np.sqrt(16 + 1 / 12)) < 5 * 4 / np.sqrt(2 * n)
    assert abs(first.mean()) < 5 * 4 / np.sqrt(n)
    for other in (second, np.roll(first, 1, axis=0), np.roll(first, 1, axis=1), np.roll(first, 1, axis=2)):
        assert abs(np.corrcoef(first.ravel(), other.ravel())[0, 1]) < 5 / np.sqrt(n)


def test_a_frame_depends_on_its_index_alone():
    frames = movie(4.0)
    whole = list(frames)
    assert len(whole) == len(frames) == 5
    for index in (3, 0, 4):
        np.testing.assert_array_equal(frames[index], whole[index])
    np.testing.assert_array_equal(frames[-1], whole[4])
    assert whole[0].dtype == np.uint8 and whole[0].shape == (240, 320, 3)
    with pytest.raises(IndexError, match="frame 5 of a scene of 5 frames"):
        frames[5]


@pytest.mark.parametrize("box", [(20.0, 15.0, 12.0, 18.0), (7.3, 11.6, 9.5, 9.5), (1.0, 28.0, 16.0, 10.0)])
def test_a_round_sprite_is_its_ellipse(box):
    canvas = np.zeros((30, 40, 3))
    paint(canvas, Sprite(np.full((1, 1, 3), 100.0), np.array([box]), is_round=True), 0)
    x, y, w, h = box
    fine = 8
    points = [(np.arange(n * fine) + 0.5) / fine - 0.5 for n in (30, 40)]
    inside = ((points[0][:, None] - y) / (h / 2)) ** 2 + ((points[1] - x) / (w / 2)) ** 2 <= 1
    share = inside.reshape(30, fine, 40, fine).mean(axis=(1, 3))
    # 4 x 4 points against 8 x 8 on a smooth border: at most one row of 4 of them apart.
    np.testing.assert_allclose(canvas[:, :, 0] / 100, share, atol=0.25)
    assert canvas[:, :, 0].sum() / 100 == pytest.approx(share.sum(), rel=0.01)


def test_a_veil_lights_what_is_behind_it_and_the_camera_cuts_it_off():
    """Black, a sprite of 100, then light of 200 over the background alone or over both; 255 at most."""
    sprite = Sprite(np.full((1, 1, 3), 100.0), np.full((2, 4), (4.5, 4.5, 4.0, 4.0)))
    light, strength = np.full((10, 10, 3), 200.0), np.array([0.0, 1.0])
    for above, seen in ((0, 100), (1, 255)):
        movie = Movie(np.zeros((10, 10, 3)), (sprite,), 0.0, 0, (Veil(light, strength, above),))
        dark, lit = movie
        assert (dark[4, 4] == 100).all() and (dark[0, 0] == 0).all()
        assert (lit[4, 4] == seen).all() and (lit[0, 0] == 200).all()
