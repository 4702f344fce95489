"""What pairs of hypotheses say of each other: sums over the partners, one by one."""

import numpy as np
import pytest

from bayesnet_track.numerics.kernels.joint_kernels import bad_behind, loss_of, pair_sums


def behind(bad, share, level, occluder, worst, best, agents):
    return loss_of(bad_behind(bad, share, level, occluder, worst, best), agents)


def test_a_quarter_of_a_box_that_does_not_match_halves_each_agents_likelihood():
    assert np.exp(-loss_of(0.25, 1)) == pytest.approx(0.5 * (1 + np.exp(-4.0)))
    assert loss_of(0.25, 3) == pytest.approx(3 * loss_of(0.25, 1))
    assert loss_of(0.0, 5) == 0.0
    assert np.exp(-loss_of(1.0, 2)) == pytest.approx(((1 + np.exp(-4.0)) / (1 + np.exp(12.0))) ** 2)


@pytest.mark.parametrize(
    ("bad", "rest"),
    [
        (0.5, 0.5 - 0.4 * 0.6),  # what the occluder alone explains is taken off
        (0.1, (1 - 0.4) * 0.2),  # but no better than a target that matches as well as it can
        (0.95, (1 - 0.4) * 0.9),  # and no worse than one that matches nowhere
    ],
)
def test_what_is_hidden_does_not_speak(bad, rest):
    """Share 0.4 is hidden; its pixels count `level` 0.3, the occluder's colours mismatch 0.6."""
    assert behind(bad, 0.4, 0.3, 0.6, 0.9, 0.2, 2) == pytest.approx(loss_of(rest + 0.4 * 0.3, 2))


def overlap(a, b):
    sides = [
        min(a[k] + a[k + 2] / 2, b[k] + b[k + 2] / 2) - max(a[k] - a[k + 2] / 2, b[k] - b[k + 2] / 2)
        for k in (0, 1)
    ]
    return sides[0] * sides[1] if min(sides) > 0 else 0.0


@pytest.mark.parametrize("in_front", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("farther", [0.0, 650.0])  # beyond what has an exponential
def test_sums_over_the_partners(in_front, farther):
    rng = np.random.default_rng(6)
    boxes = np.column_stack([rng.uniform(0, 30, (6, 2)), rng.uniform(8, 20, (6, 2))])
    others = np.column_stack([rng.uniform(0, 30, (5, 2)), rng.uniform(8, 20, (5, 2))])
    others[0] = [100, 100, 5, 5]  # touches nobody
    others[1, :2], others[1, 2:] = boxes[0, :2], boxes[0, 2:] * 3  # all around the first
    bad, other_bad = rng.random(6), rng.random(5)
    losses, other_losses = rng.random(6) + farther, rng.random(5)
    hidden, other_hidden = (0.3, 0.6, 0.9, 0.2, 2), (0.2, 0.5, 0.8, 0.1, 3)
    partners = np.array([[0, 1, 2, 3, 4, 0], [1, 2, 3, 4, 2, 4], [1, 1, 1, 1, 1, 1]])
    log_importance, free, taken, nats = rng.normal(size=5), rng.random(5), rng.random(5), 1.7
    found = pair_sums(
        boxes, losses, bad, hidden, others, other_losses, other_bad, other_hidden, partners, log_importance,
        free, taken, in_front, nats,
    )  # fmt: skip
    expected = np.zeros((4, 6))
    for row in partners:
        for i, j in enumerate(row):
            w, area = np.exp(log_importance[j]), overlap(boxes[i], others[j])
            seen = w * (free[j] + taken[j]) * np.exp(-other_losses[j])
            if area == 0:
                expected[:2, i] += np.array([in_front, 1 - in_front]) * seen
                continue
            own, share = area / boxes[i, 2:].prod(), area / others[j, 2:].prod()
            penalty = np.exp(-nats * max(own, share))
            expected[0, i] += (
                in_front * penalty * w * free[j] * np.exp(-behind(other_bad[j], share, *other_hidden))
            )
            value = (1 - in_front) * penalty * seen * np.exp(losses[i] - behind(bad[i], own, *hidden))
            expected[2:, i] += np.array([1, own]) * value
    np.testing.assert_allclose(found, expected / 3, rtol=1e-12)
    assert (found[:2] > 0).any(axis=1).sum() == (2 if 0 < in_front < 1 else 1)
