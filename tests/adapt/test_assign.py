"""The assignment of detections: optimal, one to one, gated; what speaks for a pair is exact."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment
from scipy.stats import chi2, multivariate_normal

from bayesnet_track.adapt.association import assign, gated_gains
from bayesnet_track.observation.cue import AssociationRule

RULE = AssociationRule(sd_place=0.1, sd_size=0.05, gate=0.99, min_overlap=0.3, appearance=0.0)


@given(st.integers(0, 2**32), st.integers(1, 9), st.integers(1, 9), st.sampled_from([0.0, 0.3, 0.7, 1.0]))
def test_as_many_pairs_as_can_be_and_of_those_the_best(seed, rows, columns, forbidden):
    """Against scipy, which is told that a forbidden pair costs more than all others together."""
    rng = np.random.default_rng(seed)
    gain = rng.normal(scale=30.0, size=(rows, columns))
    gain[rng.random(gain.shape) < forbidden] = -np.inf
    owner = assign(gain)
    taken = owner[owner >= 0]
    assert len(set(taken.tolist())) == len(taken)
    own = gain[owner >= 0, taken]
    assert np.isfinite(own).all()
    row, column = linear_sum_assignment(np.where(np.isfinite(gain), gain, -1e5), maximize=True)
    best = gain[row, column][np.isfinite(gain[row, column])]
    assert len(own) == len(best)
    assert own.sum() == pytest.approx(best.sum(), abs=1e-7)


def test_nobody_and_nothing():
    assert assign(np.empty((0, 3))).tolist() == []
    assert assign(np.empty((2, 0))).tolist() == [-1, -1]


def test_the_nearest_pair_is_given_up_for_the_best_of_all():
    """The first would rather have 0, but the second can have nothing else."""
    assert assign(np.array([[0.0, -3.0], [-1.0, -np.inf]])).tolist() == [1, 0]


def test_what_speaks_for_a_detection_is_its_density_under_the_prediction():
    """log N(z; m, P + R) by scipy, up to its constant."""
    mean, root = np.array([100.0, 80.0, 40.0, 90.0]), np.random.default_rng(1).normal(size=(4, 4))
    covariance = root @ root.T
    boxes = mean + np.array([[0.0, 0, 0, 0], [3, -4, 2, 1]])
    found = gated_gains(mean, covariance, boxes, RULE, lambda at: np.zeros(len(at)))
    for z, own in zip(boxes, found, strict=True):
        noise = np.diag([(0.1 * z[2]) ** 2, (0.1 * z[3]) ** 2, (0.05 * z[2]) ** 2, (0.05 * z[3]) ** 2])
        exact = multivariate_normal(mean, covariance + noise).logpdf(z) + 2.0 * np.log(2.0 * np.pi)
        assert own == pytest.approx(exact, abs=1e-9)


def test_both_gates_shut():
    """Just within and just beyond the chi-square quantile; and near enough, but of too little overlap."""
    mean = np.array([100.0, 80.0, 40.0, 40.0])
    reach = np.sqrt(chi2.ppf(0.99, 4) * (4.0 + 16.0))  # variances 4 of the belief and (0.1 x 40)^2
    boxes = mean + np.outer([0.999 * reach, 1.001 * reach], [1.0, 0, 0, 0])
    found = gated_gains(mean, 4.0 * np.eye(4), boxes, RULE, lambda at: np.zeros(len(at)))
    assert np.isfinite(found).tolist() == [True, False]
    wide = gated_gains(
        mean, 1e4 * np.eye(4), mean + np.array([[25.0, 0, 0, 0]]), RULE, lambda at: np.zeros(1)
    )
    assert not np.isfinite(wide).any()  # 15 / 65 of the union is shared


def test_looks_count_in_the_gain_and_in_the_gate():
    rule = AssociationRule(0.1, 0.05, 0.99, 0.3, appearance=0.5)
    mean = np.array([100.0, 80.0, 40.0, 40.0])
    boxes = np.stack([mean, mean, mean + [300.0, 0, 0, 0]])
    asked = []

    def log_looks(at):
        asked.append(len(at))
        return np.array([-1.0, -20.0])

    plain = gated_gains(mean, np.eye(4), boxes, RULE, log_looks)
    found = gated_gains(mean, np.eye(4), boxes, rule, log_looks)
    assert asked == [2]  # only of those that are near, and only where looks count
    assert found[0] == pytest.approx(plain[0] - 0.5)
    assert np.isfinite(found).tolist() == [True, False, False]  # 20 nats are 20 of d^2, beyond 13.3
