"""The figures that the page on the Gaussian belief states, with tolerances from their spread over runs."""

import numpy as np
import pytest

from tests.belief import kalman_experiments as experiments

RUNS = 10


def near(values, mean, sd):
    """The mean of these runs lies within 4 of its sds of the stated mean over 200 runs."""
    assert abs(np.mean(values) - mean) < 4 * sd / np.sqrt(len(values))


def test_uniform_motion():
    """Figure 3.11: the estimate errs by less than half of a measurement, the prediction by little more."""
    tracks, late = experiments.uniform_motion(RUNS), slice(10, None)
    near(experiments.rmse(tracks, late, "measured"), 5.60, 0.43)
    near(experiments.rmse(tracks, late, "predicted"), 2.90, 0.40)
    near(experiments.rmse(tracks, late), 2.61, 0.37)
    near([track.inside()[late].mean() for track in tracks], 0.95, 0.06)


@pytest.mark.slow
def test_occlusion():
    """Figure 3.12: predicted only, by the gate as when nothing is seen; without it, on the other ball."""
    found, hidden = experiments.occlusion(RUNS), experiments.HIDDEN
    unseen, gated, open_ = found.values()
    near(experiments.rmse(unseen, hidden), 5.03, 2.69)
    near(experiments.rmse(unseen, slice(39, 40)), 6.96, 3.85)
    near(experiments.rmse(open_, hidden), 70.90, 1.08)
    for blind, tracked in zip(unseen, gated, strict=True):
        assert tracked.gated[hidden].all() and not tracked.gated[40]
        np.testing.assert_array_equal(blind.estimated, tracked.estimated)
        spread = [np.trace(part) for part in blind.covariance[24:40]]
        assert np.all(np.diff(spread) > 0) and np.trace(blind.covariance[40]) < spread[-1] / 4


@pytest.mark.slow
def test_manoeuvre():
    """Figure 3.13: uniform motion with little noise loses the turn; much noise or a turn's model follows."""
    found, turning = experiments.manoeuvres(RUNS), slice(20, 44)
    for name, mean, sd in (
        ("Kalman, uniform motion", 13.50, 0.85),
        ("Kalman, wide noise", 4.36, 0.65),
        ("Kalman, damped velocity", 4.31, 0.63),
        ("EKF, turn", 3.91, 0.66),
        ("UKF, turn", 3.71, 0.60),
        ("particles, turn", 3.70, 0.66),
    ):
        near(experiments.rmse(found[name], turning), mean, sd)
    inside = {
        name: np.mean([track.inside()[5:].mean() for track in tracks]) for name, tracks in found.items()
    }
    assert inside["Kalman, uniform motion"] < 0.5 < 0.8 < min(list(inside.values())[1:])


def test_two_modes():
    """Figure 3.16: the mean of two modes is at neither, in none of 50 runs; the other two hold the target."""
    found = experiments.bimodal(50)
    assert {name: experiments.held(places) for name, places in found.items()} == {
        "mean": 0,
        "best": 50,
        "robust_mean": 50,
        "gaussian": 0,
    }
    off = {
        name: np.linalg.norm(found[name] - experiments.TARGET, axis=1).mean()
        for name in ("best", "robust_mean")
    }
    assert off["robust_mean"] < off["best"] < 3
