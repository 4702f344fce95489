"""The similarity that most points agree on, with outliers, noise and too few points."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.vision.motion_planes import similarity


def vectors(rng, count, a, b):
    """Points in a 300 x 200 picture whose flow is a z + b (complex)."""
    z = rng.uniform(0, 300, count) + 1j * rng.uniform(0, 200, count)
    flow = a * z + b
    return np.column_stack([z.real, z.imag, flow.real, flow.imag])


@given(
    st.floats(-0.05, 0.05),
    st.floats(-0.05, 0.05),
    st.floats(-20, 20),
    st.floats(-20, 20),
    st.integers(0, 5),
)
def test_an_exact_similarity_is_found_among_others(zoom, turn, dx, dy, seed):
    rng = np.random.default_rng(seed)
    points = vectors(rng, 60, complex(zoom, turn), complex(dx, dy))
    points[:20, 2:] += rng.uniform(30, 60, (20, 2))  # a third moves otherwise, each in its own way
    found = similarity(points, 0.5)
    assert found.matrix == pytest.approx(np.array([[zoom, -turn, dx], [turn, zoom, dy]]), abs=1e-9)
    assert not found.agree[:20].any() and found.agree[20:].all()


def test_noise_averages_out():
    """100 points with sd 0.2 px: the shift at their centre has sd 0.02 px; 5 of these."""
    rng = np.random.default_rng(1)
    points = vectors(rng, 100, 0.0, 4.0 - 2.0j)
    points[:, 2:] += rng.normal(0, 0.2, (100, 2))
    found = similarity(points, 1.0)
    assert found.matrix @ [*points[:, :2].mean(axis=0), 1] == pytest.approx([4.0, -2.0], abs=0.1)


@pytest.mark.parametrize("count", [0, 1])
def test_too_few_points_stand_still(count):
    found = similarity(np.full((count, 4), 7.0), 0.5)
    assert not found.matrix.any()
    assert found.agree.shape == (count,)


def test_points_in_one_place():
    found = similarity(np.tile([10.0, 10.0, 3.0, 4.0], (5, 1)), 0.5)
    assert np.isfinite(found.matrix).all()
