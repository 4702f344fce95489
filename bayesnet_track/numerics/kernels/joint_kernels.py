"""The compiled kernel of joint beliefs: what pairs of hypotheses of two targets say of each one's own."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.compiled import compiled
from bayesnet_track.numerics.kernels.resampling_kernels import look_up_even

Indices = NDArray[np.intp]

LARGEST_LOG = 600.0
"""Losses below it have an exponential, and so has what they are compared with."""


@compiled
def loss_of(bad: float, agents: int) -> float:
    """By how much the log-likelihood of `agents` falls when a share `bad` of the box does not match.

    Each falls by log (1 + e^(16 bad - 4)) / (1 + e^-4): to a half at a quarter (thesis eq. 3.3, corrected).
    """
    return float(agents * np.log((1.0 + np.exp(16.0 * bad - 4.0)) / (1.0 + np.exp(-4.0))))


@compiled
def likelihood_of(bad: float, agents: int) -> float:
    """exp(-loss_of(bad, agents)), without a logarithm."""
    each = (1.0 + np.exp(-4.0)) / (1.0 + np.exp(16.0 * bad - 4.0))
    product = each
    for _ in range(agents - 1):
        product *= each
    return float(product)


@compiled
def bad_behind(bad: float, share: float, level: float, occluder: float, worst: float, best: float) -> float:
    """Share that does not match of a box of which `share` is hidden, all in shares; see `inference.joint`."""
    rest = min(max(bad - share * occluder, (1.0 - share) * best), (1.0 - share) * worst)
    return rest + share * level


@compiled
def pick_in_strata(order: Indices, bounds: Floats, shifts: Floats) -> Indices:
    """(R,) of the indices in `order` (M,), with cumulative shares `bounds` (M,): one from each of R strata.

    `shifts` (R,), from 0 to 1, say where in its stratum each is.
    """
    chosen = np.empty(shifts.shape[0], np.intp)
    width, last, at = bounds[-1] / shifts.shape[0], order.shape[0] - 1, 0
    for k in range(shifts.shape[0]):
        point = (k + shifts[k]) * width
        while at < last and bounds[at] <= point:
            at += 1
        chosen[k] = order[at]
    return chosen


@compiled
def pair_sums(
    boxes: Floats,
    losses: Floats,
    bad: Floats,
    hidden: tuple[float, float, float, float, int],
    others: Floats,
    other_losses: Floats,
    other_bad: Floats,
    other_hidden: tuple[float, float, float, float, int],
    partners: Indices,
    log_importance: Floats,
    free: Floats,
    taken: Floats,
    in_front: float,
    nats: float,
) -> Floats:
    """What the partners of each hypothesis say of it, by order; see `inference.joint`.

    Args:
        boxes: (N, 4) hypotheses that hear.
        losses: (N,) by how much their log L is below that of a perfect match.
        bad: (N,) shares of them that do not match.
        hidden: what `behind` needs of them: level, occluder, worst, best, agents.
        others: (M, 4) hypotheses that speak.
        other_losses: (M,) losses of those who speak.
        other_bad: (M,) shares of them that do not match.
        other_hidden: the same of those who speak.
        partners: (R, N) indices into `others`.
        log_importance: (M,) log beta / q, for partners drawn by q.
        free: (M,) what further targets say of them, none of which hides them.
        taken: (M,) the same where one of these does.
        in_front: prior probability that those who hear are in front.
        nats: log-odds against one box wholly on the other.

    Returns:
        (4, N) means over the partners: in front; behind but not touched; behind and partly hidden; and the
        last times the hidden share.
    """
    rounds, size = partners.shape
    sums = np.zeros((4, size))
    level, occluder, worst, best, agents = hidden
    other_level, other_occluder, other_worst, other_best, other_agents = other_hidden
    weights, all_seen = np.empty(others.shape[0]), np.empty(others.shape[0])
    for j in range(others.shape[0]):
        weights[j] = np.exp(log_importance[j])
        all_seen[j] = weights[j] * (free[j] + taken[j]) * np.exp(-other_losses[j])
    gains = np.exp(np.minimum(losses, LARGEST_LOG))
    for r in range(rounds):
        for i in range(size):
            j = partners[r, i]
            weight, seen = weights[j], all_seen[j]
            across = min(boxes[i, 0] + boxes[i, 2] / 2, others[j, 0] + others[j, 2] / 2) - max(
                boxes[i, 0] - boxes[i, 2] / 2, others[j, 0] - others[j, 2] / 2
            )
            down = min(boxes[i, 1] + boxes[i, 3] / 2, others[j, 1] + others[j, 3] / 2) - max(
                boxes[i, 1] - boxes[i, 3] / 2, others[j, 1] - others[j, 3] / 2
            )
            if across <= 0 or down <= 0:
                sums[0, i] += in_front * seen
                sums[1, i] += (1.0 - in_front) * seen
                continue
            own = min(across * down / (boxes[i, 2] * boxes[i, 3]), 1.0)
            share = min(across * down / (others[j, 2] * others[j, 3]), 1.0)
            penalty = np.exp(-nats * max(own, share)) if nats != 0.0 else 1.0
            if in_front > 0:
                left = bad_behind(other_bad[j], share, other_level, other_occluder, other_worst, other_best)
                sums[0, i] += in_front * penalty * weight * free[j] * likelihood_of(left, other_agents)
            if in_front < 1:
                left = bad_behind(bad[i], own, level, occluder, worst, best)
                if losses[i] < LARGEST_LOG:
                    gain = gains[i] * likelihood_of(left, agents)
                else:
                    gain = np.exp(losses[i] - loss_of(left, agents))
                value = (1.0 - in_front) * penalty * seen * gain
                sums[2, i] += value
                sums[3, i] += own * value
    sums /= rounds
    return sums


@compiled
def put_on_others(
    states: Floats,
    weights: Floats,
    rows: Indices,
    firsts: Indices,
    others: Indices,
    uniforms: Floats,
    size: int,
) -> Floats:
    """(K * size, D) hypotheses of some targets, moved onto hypotheses of others.

    Where a box is the larger one, it is in the middle of the other's; else anywhere on it.

    Args:
        states: (T, N, D) hypotheses of all targets, centre boxes first.
        weights: (T, N).
        rows: (R,) the targets.
        firsts: (R + 1,) where the others of each begin among all K of them.
        others: (K,) rows.
        uniforms: of each target its own shift, a shift for each other, then two numbers for each box.
        size: how many for each other.
    """
    found = np.empty((others.shape[0] * size, states.shape[2]))
    at = 0
    for r in range(rows.shape[0]):
        first, count = firsts[r], firsts[r + 1] - firsts[r]
        own = look_up_even(weights[rows[r]], uniforms[at], count * size)
        across = at + 1 + count
        for k in range(count):
            other = others[first + k]
            there = look_up_even(weights[other], uniforms[at + 1 + k], size)
            for n in range(size):
                one, box = found[(first + k) * size + n], states[other, there[n]]
                for d in range(states.shape[2]):
                    one[d] = states[rows[r], own[k * size + n], d]
                for axis in range(2):
                    room = max(box[2 + axis] - one[2 + axis], 0.0)
                    one[axis] = box[axis] + room * (uniforms[across + 2 * (k * size + n) + axis] - 0.5)
        at = across + 2 * count * size
    return found
