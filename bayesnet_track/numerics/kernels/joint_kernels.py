"""Compiled kernel of joint beliefs: messages between the hypotheses of two targets."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.compiled import compiled, compiled_fusing
from bayesnet_track.numerics.resampling import look_up_even

LARGEST = 700.0

_PER_HALVING = 1.4426950408889634
_HALVING = (6.93147180369123816490e-01, 1.90821492927058770002e-10)
"""log 2, in two parts, of which the first has few digits."""
_SHIFT = 6755399441055744.0
"""1.5 * 2^52: a number added to it is rounded to a whole one, which its last bits hold."""


@compiled_fusing
def exp_of(x: float) -> float:
    """e^x within 2 units in the last place; of x beyond +-700 that of this bound.

    e^x = 2^n e^r with |r| < log(2) / 2, and e^r is its series up to r^12 / 12!.
    """
    x = min(max(x, -LARGEST), LARGEST)
    shifted = x * _PER_HALVING + _SHIFT
    n = shifted - _SHIFT
    r = (x - n * _HALVING[0]) - n * _HALVING[1]
    e = 1 / 479001600
    e = e * r + 1 / 39916800
    e = e * r + 1 / 3628800
    e = e * r + 1 / 362880
    e = e * r + 1 / 40320
    e = e * r + 1 / 5040
    e = e * r + 1 / 720
    e = e * r + 1 / 120
    e = e * r + 1 / 24
    e = e * r + 1 / 6
    e = e * r + 0.5
    e = e * r + 1.0
    e = e * r + 1.0
    doubled = np.float64(e).view(np.int64) + (np.float64(shifted).view(np.int64) << np.int64(52))
    return float(np.int64(doubled).view(np.float64))


Indices = NDArray[np.intp]
Hidden = tuple[float, float, float, float, int]

LARGEST_LOG = 600.0
"""Losses below it have an exponential, and so has what they are compared with."""

_AT_BEST = float(np.exp(-4.0))


@compiled
def loss_of(bad: float, agents: int) -> float:
    """By how much the log-likelihood of `agents` falls when a share `bad` of the box does not match.

    Each falls by log (1 + e^(16 bad - 4)) / (1 + e^-4): to a half at a quarter (thesis eq. 3.3, corrected).
    """
    return float(agents * np.log((1.0 + np.exp(16.0 * bad - 4.0)) / (1.0 + np.exp(-4.0))))


@compiled_fusing
def bad_behind(bad: float, share: float, level: float, occluder: float, worst: float, best: float) -> float:
    """Share that does not match of a box of which `share` is hidden, all in shares; see `inference.joint`."""
    visible = min(max(bad - share * occluder, (1.0 - share) * best), (1.0 - share) * worst)
    return visible + share * level


@compiled
def pick_in_strata(order: Indices, bounds: Floats, shifts: Floats) -> Indices:
    """(R,) of the indices in `order` (M,), with cumulative shares `bounds` (M,): one from each of R strata.

    `shifts` (R,), from 0 to 1, say where in its stratum each is.
    """
    picked = np.empty(shifts.shape[0], np.intp)
    width, last_index, index = bounds[-1] / shifts.shape[0], order.shape[0] - 1, 0
    for k in range(shifts.shape[0]):
        point = (k + shifts[k]) * width
        while index < last_index and bounds[index] <= point:
            index += 1
        picked[k] = order[index]
    return picked


@compiled
def _edges(boxes: Floats, edges: Floats) -> None:
    """Fill in the sides and the area (5, N) of centre boxes (N, 4)."""
    for n in range(boxes.shape[0]):
        for axis in range(2):
            half = boxes[n, 2 + axis] / 2
            edges[axis, n], edges[2 + axis, n] = boxes[n, axis] - half, boxes[n, axis] + half
        edges[4, n] = boxes[n, 2] * boxes[n, 3]


@compiled
def _common(
    x0: Floats,
    y0: Floats,
    x1: Floats,
    y1: Floats,
    other_edges: tuple[Floats, Floats, Floats, Floats],
    area: Floats,
) -> None:
    """Fill in the area (N,) that boxes have in common with others."""
    other_x0, other_y0, other_x1, other_y1 = other_edges
    for n in range(area.shape[0]):
        width = min(x1[n], other_x1[n]) - max(x0[n], other_x0[n])
        height = min(y1[n], other_y1[n]) - max(y0[n], other_y0[n])
        area[n] = max(width, 0.0) * max(height, 0.0)


@compiled_fusing
def _fit_behind(area: Floats, box_areas: Floats, bad: Floats, hidden: Hidden, fits: Floats) -> None:
    """Fill in the likelihoods (N,) of boxes behind, of whose `box_areas` so much is hidden: e^-`loss_of`."""
    level, occluder, worst, best, agents = hidden
    for n in range(area.shape[0]):
        misfit = bad_behind(bad[n], min(area[n] / box_areas[n], 1.0), level, occluder, worst, best)
        fits[n] = (1.0 + _AT_BEST) / (1.0 + exp_of(16.0 * misfit - 4.0))
    each = fits.copy() if agents > 1 else fits
    for _ in range(agents - 1):
        for n in range(area.shape[0]):
            fits[n] *= each[n]


@compiled
def pair_sums(
    boxes: Floats,
    losses: Floats,
    bad: Floats,
    hidden: Hidden,
    speakers: Floats,
    other_losses: Floats,
    other_bad: Floats,
    other_hidden: Hidden,
    partners: Indices,
    log_importance: Floats,
    free: Floats,
    occluded: Floats,
    in_front: float,
    nats: float,
) -> Floats:
    """Messages of the partners of each hypothesis, by order; see `inference.joint`.

    Args:
        boxes: (N, 4) hypotheses that hear.
        losses: (N,) by how much their log L is below that of a perfect match.
        bad: (N,) shares of them that do not match.
        hidden: what `behind` needs of them: level, occluder, worst, best, agents.
        speakers: (M, 4) hypotheses that speak.
        other_losses: (M,) losses of those who speak.
        other_bad: (M,) shares of them that do not match.
        other_hidden: the same of those who speak.
        partners: (R, N) indices into `speakers`.
        log_importance: (M,) log beta / q, for partners drawn by q.
        free: (M,) what further targets say of them, none of which hides them.
        occluded: (M,) the same where one of these does.
        in_front: prior probability that those who hear are in front.
        nats: log-odds against one box wholly on the other.

    Returns:
        (4, N) means over the partners: in front; behind but not touched; behind and partly hidden; and the
        last times the hidden share.
    """
    (rounds, size), speaker_count = partners.shape, speakers.shape[0]
    sums, met, facts = np.zeros((4, size)), np.empty((8, size)), np.empty((8, speaker_count))
    edges, gains = np.empty((5, size)), np.empty(size)
    _edges(boxes, edges)
    _edges(speakers, facts)
    for j in range(speaker_count):
        weight = exp_of(log_importance[j])
        facts[5, j], facts[6, j] = other_bad[j], in_front * weight * free[j]
        facts[7, j] = weight * (free[j] + occluded[j]) * exp_of(-other_losses[j])
    for i in range(size):
        gains[i] = (1.0 - in_front) * (exp_of(losses[i]) if losses[i] < LARGEST_LOG else 1.0)
    level, occluder, worst, best, agents = hidden
    underflowing, by_partner = np.flatnonzero(losses >= LARGEST_LOG), np.ascontiguousarray(facts.T)
    area, front, behind = np.empty(size), np.empty(size), np.empty(size)
    for r in range(rounds):
        for i in range(size):
            for k in range(8):
                met[k, i] = by_partner[partners[r, i], k]
        _common(edges[0], edges[1], edges[2], edges[3], (met[0], met[1], met[2], met[3]), area)
        _fit_behind(area, met[4], met[5], other_hidden, front)
        _fit_behind(area, edges[4], bad, hidden, behind)
        for n in underflowing:
            misfit = bad_behind(bad[n], min(area[n] / edges[4, n], 1.0), level, occluder, worst, best)
            behind[n] = np.exp(losses[n] - loss_of(misfit, agents))
        if nats != 0.0:
            for i in range(size):
                penalty = exp_of(-nats * min(max(area[i] / edges[4, i], area[i] / met[4, i]), 1.0))
                front[i], behind[i] = front[i] * penalty, behind[i] * penalty
        for i in range(size):
            is_hit, message = area[i] > 0.0, met[7, i]
            value = message * gains[i] * behind[i] if is_hit else 0.0
            sums[0, i] += met[6, i] * front[i] if is_hit else in_front * message
            sums[1, i] += 0.0 if is_hit else (1.0 - in_front) * message
            sums[2, i] += value
            sums[3, i] += min(area[i] / edges[4, i], 1.0) * value
    sums /= rounds
    return sums


@compiled
def put_on_others(
    states: Floats,
    weights: Floats,
    rows: Indices,
    firsts: Indices,
    other_rows: Indices,
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
        other_rows: (K,) rows.
        uniforms: of each target its own shift, a shift for each other, then two numbers for each box.
        size: how many for each other.
    """
    placed = np.empty((other_rows.shape[0] * size, states.shape[2]))
    cursor = 0
    for r in range(rows.shape[0]):
        first, count = firsts[r], firsts[r + 1] - firsts[r]
        indices = look_up_even(weights[rows[r]], uniforms[cursor], count * size)
        box_cursor = cursor + 1 + count
        for k in range(count):
            host = other_rows[first + k]
            host_indices = look_up_even(weights[host], uniforms[cursor + 1 + k], size)
            for n in range(size):
                state, box = placed[(first + k) * size + n], states[host, host_indices[n]]
                for d in range(states.shape[2]):
                    state[d] = states[rows[r], indices[k * size + n], d]
                for axis in range(2):
                    room = max(box[2 + axis] - state[2 + axis], 0.0)
                    state[axis] = box[axis] + room * (uniforms[box_cursor + 2 * (k * size + n) + axis] - 0.5)
        cursor = box_cursor + 2 * count * size
    return placed
