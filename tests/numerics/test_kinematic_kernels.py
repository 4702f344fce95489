"""The compiled motion is that of matrices and of NumPy's normals."""

import numpy as np
import pytest

from bayesnet_track.belief.motion.models import make_motion
from bayesnet_track.graph import spec
from bayesnet_track.numerics.kernels.box_kernels import drifted, driven, driven_by, scale_steps

F = {1: [[1.0]], 2: [[1.0, 0.7], [0.0, 0.8]], 3: [[1.0, 0.7, 0.2], [0.1, 0.9, 0.6], [0.0, -0.2, 0.5]]}


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def rows(matrix):
    return tuple(tuple(row) for row in np.asarray(matrix).tolist())


def plainly(states, moves, root, normals):
    """The same with a matrix for the whole state, sizes left alone."""
    order = len(moves)
    columns = [0, 1, *range(4, 2 * order + 2)]
    new = states.copy()
    both = states[:, columns] @ np.kron(moves, np.eye(2)).T
    new[:, columns] = both + normals @ np.kron(root, np.eye(2)).T
    return new


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, 2, 3])
def test_the_kernels_are_the_matrices(order, rng):
    moves, root = np.array(F[order]), np.tril(rng.normal(size=(order, order)))
    states, parents = rng.normal(size=(50, 2 * order + 2)), rng.integers(0, 50, 300)
    seeds = np.random.Generator(np.random.Philox(3)), np.random.Generator(np.random.Philox(3))
    new = driven_by(states, parents, rows(moves), rows(root), seeds[0])
    normals = seeds[1].standard_normal((300, 2 * order))
    np.testing.assert_array_equal(driven(states, parents, rows(moves), rows(root), normals), new)
    # Sums of at most seven products of order one: rounding is below 1e-14.
    np.testing.assert_allclose(new, plainly(states[parents], moves, root, normals), atol=1e-14)
    np.testing.assert_array_equal(new[:, 2:4], states[parents, 2:4])
    still = plainly(states, moves, root, np.zeros((50, 2 * order)))
    np.testing.assert_allclose(drifted(states, rows(moves)), still, atol=1e-14)
    assert seeds[0].random() == seeds[1].random()


def test_normals_are_numpys_bit_by_bit():
    """Over enough draws to meet the tail of the ziggurat, beyond 3.65: 1 in 3,900."""
    states, still = np.zeros((200_000, 4)), np.zeros(200_000, np.intp)
    seeds = np.random.Generator(np.random.Philox(9)), np.random.Generator(np.random.Philox(9))
    new = driven_by(states, still, ((1.0,),), ((1.0,),), seeds[0])
    normals = seeds[1].standard_normal((200_000, 2))
    assert np.abs(normals).max() > 4
    np.testing.assert_array_equal(new[:, :2], normals)


@pytest.mark.parametrize("kind", ["random_walk", "constant_velocity", "constant_acceleration"])
def test_given_parents_are_as_copied_ones(kind, rng):
    noise = {"sd_px": {"x": 2.0, "h": 0.5}, "sd_box": {"y": 0.1}, "sd_log": {"scale": 0.02}}
    motion = make_motion(spec.Motion.model_validate({kind: noise}))
    states = motion.start(np.array([50.0, 40.0, 20.0, 30.0]), 40, rng)
    parents = rng.integers(0, 40, 100)
    given = motion.propagate(states, 1.5, np.random.default_rng(1), parents)
    copied = motion.propagate(states[parents], 1.5, np.random.default_rng(1))
    np.testing.assert_array_equal(given, copied)


def test_read_only_states_and_every_other_row_are_moved_too(rng):
    motion = make_motion(spec.Motion.model_validate({"constant_velocity": {}}))
    states = motion.start(np.array([50.0, 40.0, 20.0, 30.0]), 40, rng)
    expected = motion.drift(states[::2].copy(), 1.0)
    np.testing.assert_array_equal(motion.drift(states[::2], 1.0), expected)
    states.setflags(write=False)
    np.testing.assert_array_equal(motion.drift(states, 1.0)[::2], expected)


def test_steps_are_as_long_as_the_boxes_ask_for(rng):
    normals, areas, wide = rng.normal(size=(20, 2)), rng.uniform(10, 1000, 20), rng.permutation(20)[:7]
    steps = normals.copy()
    scale_steps(steps, areas, (3.0, 0.0), (0.1, 0.2), 0.5, wide, 4.0)
    expected = normals * np.sqrt(0.5 * (np.array([9.0, 0.0]) + np.outer(areas, [0.01, 0.04])))
    expected[wide] *= 4.0
    np.testing.assert_allclose(steps, expected, rtol=1e-14)
