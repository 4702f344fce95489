"""A grid's moments, regions and windows by enumeration of a few cells."""

import math

import numpy as np
import pytest

from bayesnet_track.belief.grid.belief import (
    _around_zero,
    _bounding_box,
    _heaviest,
    _nearest,
    unknown_velocity,
    window_around,
)
from bayesnet_track.belief.grid.cells import (
    GridBelief,
    GridLimits,
    Lattice,
    Patch,
    crop_patch,
    find_kept,
    limits_of,
    stack_patches,
)
from bayesnet_track.belief.motion.borders import Confined

LATTICE = Lattice(
    (50.0, 40.0), 2.0, -3, 4, (20.0, 10.0), np.array([-0.2, 0.0, 0.2]), np.array([-1.5, 0.0, 1.5])
)


@pytest.fixture
def belief(rng):
    mass = rng.random((3, 3, 3, 4, 5)) ** 4
    return GridBelief(mass / mass.sum(), LATTICE, np.outer([0.2, 0.6, 0.2], [0.3, 0.4, 0.3]))


def states_of(belief):
    """(cells, 6) states and (cells,) masses, one by one."""
    states, masses = [], []
    for (s, b, a, row, column), mass in np.ndenumerate(belief.mass):
        x, y = 50.0 + 2.0 * (column - 3), 40.0 + 2.0 * (row + 4)
        factor, v = math.exp(0.2 * (s - 1)), 1.5 * (np.array([a, b]) - 1)
        states.append([x, y, 20.0 * factor, 10.0 * factor, *v])
        masses.append(mass)
    return np.array(states), np.array(masses)


def test_moments_are_sums_over_the_cells(belief):
    states, masses = states_of(belief)
    mean = masses @ states
    np.testing.assert_allclose(belief.mean, mean, rtol=1e-12)
    away = states - mean
    np.testing.assert_allclose(belief.covariance, (away * masses[:, None]).T @ away, rtol=1e-9, atol=1e-12)
    about, chosen = np.array([49.0, 50.0, 21.0, 9.0, 0.5, -0.5]), [0, 3, 4]
    expected = masses @ ((states - about)[:, chosen] ** 2).sum(axis=1)
    assert belief.uncertainty(about, chosen) == pytest.approx(expected)
    assert belief.most_probable().tolist() == pytest.approx(states[masses.argmax()].tolist())
    assert belief.fields == ("x", "y", "w", "h", "vx", "vy") and len(belief) == 1


def test_mass_within_a_circle_counts_the_cells_on_it(belief):
    states, masses = states_of(belief)
    centre = np.array([48.0, 50.0])
    for radius in (0.0, 2.0, 4.5, 100.0):
        inside = np.hypot(*(states[:, :2] - centre).T) <= radius
        share, trials = belief.mass_within(centre, radius)
        assert share == pytest.approx(masses[inside].sum()) and trials == math.inf
    assert belief.mass_within(centre, 100.0)[0] <= 1.0


def test_the_central_region_is_even_inside_a_cell():
    mass = np.zeros((1, 1, 1, 2, 4))
    mass[0, 0, 0] = [[0.1, 0.1, 0.1, 0.1], [0.1, 0.1, 0.2, 0.2]]
    lattice = Lattice((10.0, 20.0), 2.0, 0, 0, (4.0, 4.0), np.zeros(1), np.zeros(1))
    belief = GridBelief(mass, lattice, np.ones((1, 1)))
    # columns .2 .2 .3 .3 from 9 on: .1 of the mass ends half way through the first, .9 two thirds of the last
    assert belief.regions((0.8,))[0] == pytest.approx((10.0, 15.0 + 4 / 3, 19.5, 23.0 - 1 / 3))
    assert belief.regions((0.8,))[0][2:] == pytest.approx((19.0 + 0.5, 21.0 + 2 * 0.5 / 0.6))
    assert belief.fields == ("x", "y", "w", "h") and len(belief.values) == 4


def test_boxes_are_drawn_evenly_inside_cells_by_their_mass(belief):
    drawn = belief.draw(4000, np.random.default_rng(0))
    states, masses = states_of(belief)
    mean, spread = masses @ states[:, :4], masses @ (states[:, :4] - masses @ states[:, :4]) ** 2
    # Of cells drawn systematically the mean is closer than this; the place inside adds sd 2 / sqrt(12 N).
    np.testing.assert_allclose(drawn.mean(axis=0), mean, atol=0.15)
    inside = np.array([4 / 12, 4 / 12, 0, 0])
    np.testing.assert_allclose(drawn.var(axis=0), spread + inside, rtol=0.1)
    off = (drawn[:, 0] - 50.0) / 2.0
    assert 0.45 < np.abs(off - np.rint(off)).max() <= 0.5
    order = np.arange(belief.positions.size)
    assert belief.boxes(order)[0].tolist() == pytest.approx(
        [44.0, 48.0, *(np.exp(-0.2) * np.array([20.0, 10.0]))]
    )
    assert belief.boxes(order)[-1].tolist() == pytest.approx(
        [52.0, 54.0, *(np.exp(0.2) * np.array([20.0, 10.0]))]
    )


# ------------------------------------------------------------------------------------ windows


def test_a_line_inside_its_bounds_keeps_what_counts():
    line = np.array([0.0, 0.0, 1.0, 3.0, 1.0, 0.0])
    assert find_kept(line, 7, None, 10) == (9, slice(2, 5), (False, False))
    assert find_kept(line, 7, (0, 20), 10) == (9, slice(2, 5), (False, False))
    assert find_kept(line, 7, (7, 12), 10) == (9, slice(2, 5), (False, False))
    negligible = np.array([1e-14, 1e-12, 1.0, 1e-12, 1e-14])
    assert find_kept(negligible, 0, None, 10) == (1, slice(1, 4), (False, False))


def test_an_end_of_the_image_takes_what_lies_beyond():
    line = np.array([1.0, 2.0, 3.0, 2.0, 1.0])
    assert find_kept(line, -2, (0, 10), 10) == (0, slice(2, 5), (True, False))
    assert find_kept(line, 7, (0, 9), 10) == (7, slice(0, 3), (False, True))
    assert find_kept(line, -2, (-1, 1), 10) == (-1, slice(1, 4), (True, True))
    assert find_kept(line, 20, (0, 9), 10) == (9, slice(0, 1), (False, True))
    assert find_kept(line, -20, (0, 9), 10) == (0, slice(4, 5), (True, False))


def test_of_too_many_cells_those_around_the_mean_are_kept():
    line = np.array([1.0, 1.0, 1.0, 1.0, 8.0, 8.0, 1.0])  # the mean is 84 / 21
    assert find_kept(line, 0, None, 3) == (3, slice(3, 6), (False, False))
    assert find_kept(line, 0, None, 7) == (0, slice(0, 7), (False, False))
    assert find_kept(line, 0, None, 6) == (1, slice(1, 7), (False, False))
    assert find_kept(line[::-1], 0, None, 6) == (0, slice(0, 6), (False, False))
    assert find_kept(line, -1, (0, 20), 3) == (2, slice(3, 6), (False, False))


def test_masses_beyond_the_image_fold_onto_its_border(rng):
    mass = rng.random((2, 2, 4, 5))
    found = crop_patch(Patch(mass, -1, 8), GridLimits((0, 2), (0, 9), 50), 50)
    assert (found.column, found.row) == (0, 8)
    across = np.stack([mass[..., :2].sum(-1), mass[..., 2], mass[..., 3:].sum(-1)], axis=-1)
    expected = np.stack([across[:, :, 0], across[:, :, 1:].sum(axis=2)], axis=2)
    np.testing.assert_allclose(found.mass, expected)
    free = crop_patch(Patch(mass, -1, 8), GridLimits(None, None, 50), 50)
    assert (free.column, free.row) == (-1, 8)
    np.testing.assert_array_equal(free.mass, mass)


def test_patches_are_laid_over_each_other(rng):
    one, two = Patch(rng.random((1, 2, 2, 3)), 4, -1), Patch(rng.random((1, 2, 3, 2)), 2, 0)
    layers, column, row = stack_patches([one, two])
    assert (column, row, layers.shape) == (2, -1, (2, 1, 2, 4, 5))
    np.testing.assert_array_equal(layers[0, :, :, :2, 2:], one.mass)
    np.testing.assert_array_equal(layers[1, :, :, 1:, :2], two.mass)
    assert layers.sum() == pytest.approx(one.mass.sum() + two.mass.sum())
    alone, column, row = stack_patches([one])
    assert (column, row) == (4, -1) and alone.shape == (1, 1, 2, 2, 3)


def test_limits_are_the_cells_whose_points_lie_in_the_image(motion_of):
    walk = motion_of("random_walk")
    assert limits_of(LATTICE, walk, 30) == GridLimits(None, None, 30)
    # columns at 50 + 2 k from 0 to 98, rows at 40 + 2 k from 0 to 60
    assert limits_of(LATTICE, Confined(walk, 99, 62), 30) == GridLimits((-25, 24), (-20, 10), 30)
    assert limits_of(LATTICE, Confined(walk, 100, 61), 30) == GridLimits((-25, 24), (-20, 10), 30)
    coarse = Lattice((1.0, 1.0), 50.0, 0, 0, (4.0, 4.0), np.zeros(1), np.zeros(1))
    assert limits_of(coarse, Confined(walk, 3, 2), 30) == GridLimits((0, 0), (0, 0), 30)


def test_a_window_around_a_place_is_even_and_cut_to_the_image(belief):
    found = window_around(belief, np.array([50.0 + 2 * 7.2, 40.0 - 2 * 3.9]), GridLimits((-20, 8), None, 6))
    assert (found.lattice.column, found.lattice.row) == (4, -7)
    assert found.mass.shape == (3, 3, 3, 6, 5)  # columns 4 .. 8 of 4 .. 9, rows -7 .. -2
    scales = belief.positions.sum(axis=(1, 2))
    np.testing.assert_allclose(found.positions, scales[:, None, None] * np.ones((6, 5)) / 30)
    np.testing.assert_allclose(found.mass.sum(axis=(0, 3, 4)), belief.first_velocities)
    cut = window_around(belief, np.array([50.0 - 2 * 19, 40.0]), GridLimits((-20, 8), (-1, 9), 7))
    assert (cut.lattice.column, cut.lattice.row, cut.mass.shape[3:]) == (-20, -1, (5, 5))


def test_nothing_known_of_the_velocity(belief, rng):
    positions = rng.random((3, 4, 5))
    found = unknown_velocity(belief, positions).mass
    expected = np.einsum("syx,ba->sbayx", positions, belief.first_velocities) / positions.sum()
    np.testing.assert_allclose(found, expected)


def test_the_nearest_of_the_coarse_places():
    assert _nearest(np.arange(-3, 14), np.array([1, 5, 9])).tolist() == [
        0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 2, 2, 2, 2, 2, 2, 2,
    ]  # fmt: skip
    assert _nearest(np.arange(3), np.array([1])).tolist() == [0, 0, 0]


def test_the_heaviest_cells_hold_all_but_the_cut():
    masses = np.array([[[0.1, 0.0, 0.4], [0.2, 0.25, 0.05]]])
    assert _heaviest(masses, 0.0).tolist() == [0, 2, 3, 4, 5]
    assert _heaviest(masses, 0.1).tolist() == [0, 2, 3, 4]
    assert _heaviest(masses, 0.3).tolist() == [2, 3, 4]
    assert _heaviest(masses, 0.4).tolist() == [2, 4]
    assert _heaviest(2 * masses, 0.4).tolist() == [2, 4]
    assert _bounding_box((2, 3, 4), np.array([5, 18])).tolist() == [5, 6, 17, 18]
    assert _bounding_box((1, 3, 4), np.array([1, 11])).tolist() == [1, 2, 3, 5, 6, 7, 9, 10, 11]
    assert _around_zero(5).tolist() == [-2, -1, 0, 1, 2]
