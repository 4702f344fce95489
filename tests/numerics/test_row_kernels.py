"""The kernels over rows against the same arithmetic for one target at a time."""

import numpy as np
import pytest

from bayesnet_track.adapt.association import assign, assign_pairs, gated_gains
from bayesnet_track.belief.gaussian.belief import predict
from bayesnet_track.belief.motion.borders import Confined
from bayesnet_track.belief.motion.models import linear_gaussian, make_motion
from bayesnet_track.graph.spec import Gaussian, Motion
from bayesnet_track.numerics.gaussian import ALONE, chi_square_quantile, fill_root, linear_update, root
from bayesnet_track.numerics.kernels.pair_kernels import gate_rows
from bayesnet_track.numerics.kernels.row_kernels import (
    ESS,
    FIT,
    LOG_EVIDENCE,
    UD,
    append_medians,
    predict_rows,
    take_median,
    update_rows,
)
from bayesnet_track.observation.cue import AssociationRule

IMAGE = np.array([640.0, 480.0])
MOTION = make_motion(
    Motion.model_validate({"constant_velocity": {"sd_px": {"w": 8, "h": 4}, "sd_velocity_px": 0.7}})
)


@pytest.fixture
def beliefs():
    """Means and covariances of 30 targets, some at the border, one wide."""
    rng = np.random.default_rng(3)
    mean = np.column_stack(
        [rng.uniform([0, 0, 5, 5], [640, 480, 60, 90], (30, 4)), rng.normal(0, 3, (30, 2))]
    )
    mixed = rng.normal(size=(30, 6, 6))
    covariance = mixed @ mixed.transpose(0, 2, 1) * rng.uniform(0.2, 3, (30, 1, 1))
    covariance[7] *= 1e5
    return mean, covariance


def test_rows_are_predicted_as_one_target_is(beliefs):
    mean, covariance = beliefs
    moved, spread = predict_rows(mean, covariance, *linear_gaussian(MOTION, 1.5), IMAGE)
    for row in range(len(mean)):
        one, its = predict(mean[row], covariance[row], Confined(MOTION, 640, 480), 1.5, Gaussian())
        np.testing.assert_allclose(moved[row], one, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(spread[row], its, rtol=1e-12, atol=1e-9)


def test_a_root_is_that_of_numerics_gaussian(beliefs):
    flat = beliefs[1][0].copy()
    flat[2], flat[:, 2] = 0.0, 0.0  # a field that does not vary has no column
    for covariance in (beliefs[1][0], flat):
        lower = np.zeros((6, 6))
        width = fill_root(covariance, lower, np.empty((6, 6)), np.empty(6), ALONE)
        np.testing.assert_allclose(lower[:, :width], root(covariance), rtol=1e-10, atol=1e-12)


def test_rows_are_corrected_by_the_kalman_update(beliefs):
    mean, covariance = (array[:7].copy() for array in beliefs)
    rng = np.random.default_rng(0)
    own, variances = mean[:, :4] + rng.normal(0, 1, (7, 4)), rng.uniform(1, 9, (7, 4))
    seen = np.arange(7) != 2
    before = mean.copy(), covariance.copy()
    counts = np.array([True, True, False, False])
    limits = 0.05, np.inf, ALONE
    nothing = np.empty((7, 0, 4))
    found = update_rows((mean, covariance), own, seen, variances, nothing, limits, IMAGE, counts)
    for row in range(7):
        after = linear_update(
            before[0][row],
            before[1][row],
            own[row] - before[0][row, :4],
            np.eye(6)[:4],
            np.diag(variances[row]),
        )
        expected = (after.mean, after.covariance) if seen[row] else (before[0][row], before[1][row])
        np.testing.assert_allclose(
            mean[row], np.maximum(expected[0], [-np.inf] * 2 + [1] * 2 + [-np.inf] * 2)
        )
        np.testing.assert_allclose(covariance[row], expected[1], rtol=1e-9, atol=1e-10)
        assert found[row, LOG_EVIDENCE] == pytest.approx(after.log_likelihood if seen[row] else 0.0)
        assert found[row, UD] == pytest.approx(np.trace(expected[1][:2, :2]))
    assert found[2, FIT] == 0.0 and found[2, ESS] == pytest.approx(1 / (1 / 49 + 12 / 14**2))


def test_pairs_within_the_gate_have_the_gains_of_one_target_at_a_time(beliefs):
    mean, covariance = (array[:25] for array in beliefs)
    rng = np.random.default_rng(1)
    boxes = np.concatenate([mean[:, :4] + rng.normal(0, 2, (25, 4)), mean[::3, :4]])
    boxes[:, 2:] = np.maximum(boxes[:, 2:], 2)
    rule = AssociationRule(0.06, 0.06, 0.999, 0.2, 0.0)
    order = np.argsort(boxes[:, 0])
    everything = np.zeros(25, np.int64), np.full(25, len(boxes))
    limit = chi_square_quantile(rule.gate, 4)
    rows, columns, gains = gate_rows(
        mean, covariance, boxes, rule.variances(boxes), order, *everything, limit, rule.min_overlap
    )
    gain = np.full((25, len(boxes)), -np.inf)
    gain[rows, columns] = gains
    expected = np.array(
        [gated_gains(m[:4], p[:4, :4], boxes, rule, len) for m, p in zip(mean, covariance, strict=True)]
    )
    assert np.isfinite(expected).sum() > 15
    np.testing.assert_allclose(gain, expected, rtol=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_groups_assigned_alone_are_the_assignment_of_all(seed):
    rng = np.random.default_rng(seed)
    gain = np.where(rng.random((30, 25)) < rng.uniform(0.02, 0.15), rng.normal(0, 5, (30, 25)), -np.inf)
    rows, columns = np.nonzero(np.isfinite(gain))
    found = assign_pairs(rows, columns, gain[rows, columns], 30, 25)
    assert found.tolist() == assign(gain).tolist()


@pytest.mark.parametrize("levels", [1, 3, 1000])
def test_the_median_is_that_of_numpy_also_of_equal_values(levels):
    rng = np.random.default_rng(2)
    for count in range(1, 52):
        values = rng.integers(0, levels, 60) / 7.0
        assert take_median(values.copy(), count) == np.median(values[:count])


def test_windows_keep_the_last_values_and_know_their_medians():
    values, counts = np.zeros((2, 5)), np.zeros(2, np.int64)
    seen: list[float] = []
    for new in np.random.default_rng(0).normal(size=12):
        seen.append(float(new))
        values, counts, medians = append_medians(values, counts, np.full(2, new), np.array([True, False]), 3)
        expected = np.median(seen[-5:]) if len(seen) >= 3 else np.nan
        np.testing.assert_equal(medians, [expected, np.nan])
    assert counts.tolist() == [5, 0]
