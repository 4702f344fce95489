"""Mass inside a disc: closed forms, and invariance under rotation."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from bayesnet_track.numerics.distributions import gaussian_mass_in_disc, weighted_mass_in_disc


@given(st.floats(0.05, 20.0), st.floats(0.0, 12.0), st.floats(0.0, 6.3), st.floats(0.5, 10.0))
def test_a_round_gaussian_is_a_noncentral_chi_square(sd, away, angle, radius):
    offset = away * np.array([math.cos(angle), math.sin(angle)])
    expected = stats.ncx2.cdf((radius / sd) ** 2, 2, (away / sd) ** 2)
    found = gaussian_mass_in_disc(offset, sd**2 * np.eye(2), radius)
    assert found == pytest.approx(expected, abs=1e-8)


@given(st.floats(1e-3, 30.0), st.floats(1e-3, 30.0), st.floats(0.0, 3.2), st.floats(0.0, 5.0))
def test_it_turns_with_the_axes(first, second, angle, away):
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    covariance, offset = np.diag([first**2, second**2]), np.array([away, -0.3 * away])
    straight = gaussian_mass_in_disc(offset, covariance, 4.0)
    turned = gaussian_mass_in_disc(turn @ offset, turn @ covariance @ turn.T, 4.0)
    # the smaller variance is known to 1e-16 of the larger one only
    assert turned == pytest.approx(straight, abs=1e-6)


def test_a_line_and_a_point():
    assert gaussian_mass_in_disc(np.zeros(2), np.diag([4.0, 0.0]), 2.0) == pytest.approx(
        math.erf(1 / math.sqrt(2)), abs=1e-9
    )
    assert gaussian_mass_in_disc(np.zeros(2), np.zeros((2, 2)), 3.0) == pytest.approx(1.0, abs=1e-12)
    assert gaussian_mass_in_disc(np.array([5.0, 0.0]), np.zeros((2, 2)), 3.0) == 0.0


def test_weighted_points():
    points = np.array([[0.0, 0.0], [3.0, 4.0], [6.0, 0.0]])
    weights = np.array([0.5, 0.3, 0.2])
    assert weighted_mass_in_disc(points, weights, np.zeros(2), 5.0) == pytest.approx(0.8)
    assert weighted_mass_in_disc(points, weights, np.zeros(2), 4.999) == pytest.approx(0.5)
