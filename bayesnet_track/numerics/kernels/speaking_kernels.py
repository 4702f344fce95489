"""Messages between targets that are near each other, of all pairs in one call; see `inference.joint`.

Hypotheses of all targets stand below each other; those of target m are `starts[m]` to `starts[m + 1] - 1`.
What a pair's speaker says of its hearer has a column for each of the hearer's hypotheses: those of pair k
begin at `at[k]`.
"""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.compiled import compiled
from bayesnet_track.numerics.kernels.joint_kernels import Indices, pair_sums, pick_in_strata

Members = tuple[Floats, Floats, Floats, Floats, Floats, Floats, Indices]
Pairs = tuple[Indices, Indices, Indices]
HearingPairs = tuple[Indices, Indices]
Draws = tuple[Floats, Indices, Indices, Indices]


@compiled
def weigh_members(
    log: Floats,
    prior: tuple[Floats, Floats],
    starts: Indices,
    tops: Floats,
    agents: Indices,
    limits: tuple[float, float, float],
) -> tuple[Floats, Floats]:
    """Weights of each hypothesis and measures of each target.

    Args:
        log: (S,) log-likelihoods L.
        prior: (S,) prior weights, and their logarithms.
        starts: (M + 1,).
        tops: (M,) log L of a perfect match; that of the best hypothesis where it is higher.
        agents: (M,) number of agents that each likelihood is a product of.
        limits: how far below the best a log L counts at most; log-odds at a perfect match; share of a box
            whose misfit halves an agent's likelihood.

    Returns:
        (4, S) log L within the limit, its loss against a perfect match, the share that does not match, and
        prior weight times L in units of the best hypothesis. (4, M) log L of a perfect match, log-evidence in
        its units, largest and smallest loss.
    """
    farthest, steep, half = limits
    weights, log_weights = prior
    each, found = np.empty((4, log.shape[0])), np.empty((4, starts.shape[0] - 1))
    for m in range(found.shape[1]):
        best = -np.inf
        for n in range(starts[m], starts[m + 1]):
            best = max(best, log[n])
        perfect, least, highest = max(tops[m], best), best, -np.inf
        for n in range(starts[m], starts[m + 1]):
            value = max(log[n], best - farthest)
            least, loss = min(least, value), perfect - value
            share = loss / agents[m]
            odds = np.log(np.expm1(share) + np.exp(share - steep))
            each[0, n], each[1, n] = value, loss
            each[2, n] = max((odds + steep) / (steep / half), 0.0)
            each[3, n] = weights[n] * np.exp(value - best)
            highest = max(highest, log_weights[n] - loss)
        total = 0.0
        for n in range(starts[m], starts[m + 1]):
            total += np.exp(log_weights[n] - each[1, n] - highest)
        found[0, m], found[1, m] = perfect, highest + np.log(total)
        found[2, m], found[3, m] = perfect - least, perfect - best
    return each, found


@compiled
def together(said: Floats, at: Indices, speaking: Indices, size: int) -> tuple[Floats, Floats]:
    """(N,) products of what the pairs say of one target: where none hides it, and where one does."""
    free, taken = np.ones(size), np.zeros(size)
    for k in speaking:
        for n in range(size):
            own = said[0, at[k] + n] + said[1, at[k] + n]
            taken[n] = taken[n] * own + free[n] * said[2, at[k] + n]
            free[n] *= own
    return free, taken


@compiled
def ask(
    k: int,
    members: Members,
    starts: Indices,
    evidence: Floats,
    pairs: Pairs,
    heard: HearingPairs,
    draws: Draws,
    said: Floats,
) -> tuple[Indices, Floats, Floats, Floats]:
    """Partners (R, N) of the hearer's hypotheses in pair k, and of the speaker's M what weighs them.

    These are log beta / q, for partners drawn by q; and what further targets say, none or one of which hides
    them. See `speak`.
    """
    _, _, _, seen, prior, prior_log, by_place = members
    speakers, hearers, at = pairs
    shifts, turns, begins, rounds = draws
    first, size = starts[speakers[k]], starts[speakers[k] + 1] - starts[speakers[k]]
    free, taken = together(said, at, heard[1][heard[0][k] : heard[0][k + 1]], size)
    shares, log_importance, bounds = np.empty(size), np.empty(size), np.empty(size)
    total, level = 0.0, 0.0
    for n in range(size):
        shares[n] = seen[first + n] * (free[n] + taken[n])
        total += shares[n]
    for n in range(size):
        shares[n] = 0.5 * (prior[first + n] + shares[n] / total)
        log_importance[n] = prior_log[first + n] - np.log(shares[n]) - evidence[speakers[k]]
    for n in range(size):
        level += shares[by_place[first + n]]
        bounds[n] = level
    count, begin = starts[hearers[k] + 1] - starts[hearers[k]], begins[k]
    picked = pick_in_strata(by_place[first : first + size], bounds, shifts[begin : begin + rounds[k] * count])
    partners = np.empty((rounds[k], count), np.intp)
    for r in range(rounds[k]):
        for n in range(count):
            partners[r, n] = picked[r * count + turns[begin + r * count + n]]
    return partners, log_importance, free, taken


@compiled
def speak(
    order: Indices,
    members: Members,
    starts: Indices,
    evidence: Floats,
    pairs: Pairs,
    heard: HearingPairs,
    draws: Draws,
    rules: tuple[Floats, Floats, Floats],
    said: Floats,
) -> None:
    """Fill in what the speakers of the pairs in `order` say, one after the other.

    Args:
        order: pairs; what one has to hear is said before.
        members: boxes (S, 4), then (S,) losses, shares that do not match, prior weights times L, prior
            weights, their logarithms, and the order of a target's hypotheses by place.
        starts: (M + 1,).
        evidence: (M,) log-evidence.
        pairs: (K,) speakers, hearers, and `at`.
        heard: (K + 1,) where the pairs begin in the second (H,), whose speakers speak of the speaker before.
        draws: shifts, turns, (K,) where those of a pair begin, and (K,) partners of each hypothesis.
        rules: (K, 5) what stands for hidden pixels of the speaker, of the hearer; (K, 2) probability that the
            hearer is in front, and log-odds against one box wholly on the other.
        said: (4, ...) as `pair_sums` has it.
    """
    boxes, losses, bad = members[0], members[1], members[2]
    for k in order:
        partners, log_importance, free, taken = ask(k, members, starts, evidence, pairs, heard, draws, said)
        first, last = starts[pairs[0][k]], starts[pairs[0][k] + 1]
        begin, end = starts[pairs[1][k]], starts[pairs[1][k] + 1]
        other, own = rules[0][k], rules[1][k]
        sums = pair_sums(
            boxes[begin:end],
            losses[begin:end],
            bad[begin:end],
            (own[0], own[1], own[2], own[3], int(own[4])),
            boxes[first:last],
            losses[first:last],
            bad[first:last],
            (other[0], other[1], other[2], other[3], int(other[4])),
            partners,
            log_importance,
            free,
            taken,
            rules[2][k, 0],
            rules[2][k, 1],
        )
        for row in range(4):
            for n in range(end - begin):
                said[row, pairs[2][k] + n] = sums[row, n]


@compiled
def conclude(
    log: Floats, seen: Floats, starts: Indices, at: Indices, heard: HearingPairs, said: Floats
) -> tuple[Floats, Floats, Floats]:
    """Combine for each target all messages that it receives.

    Args:
        log: (S,) log-likelihoods.
        seen: (S,) prior weights times L.
        starts: (M + 1,).
        at: (K,).
        heard: (M + 1,) where the targets begin in the second (K,), the pairs in which each hears.
        said: (4, ...).

    Returns:
        (S,) log of the likelihoods times all that is said; (K,) expected share that the speaker hides of the
        hearer; (K,) probability that the hearer is in front, by all that the hearer knows.
    """
    after, hidden, fronts = log.copy(), np.zeros(at.shape[0]), np.full(at.shape[0], 0.5)
    for m in range(starts.shape[0] - 1):
        begin, size = starts[m], starts[m + 1] - starts[m]
        hears = heard[1][heard[0][m] : heard[0][m + 1]]
        if hears.shape[0] == 0:
            continue
        free, taken = together(said, at, hears, size)
        total = 0.0
        for n in range(size):
            after[begin + n] += np.log(free[n] + taken[n])
            total += seen[begin + n] * (free[n] + taken[n])
        for i in range(hears.shape[0]):
            k, others = hears[i], hears[np.arange(hears.shape[0]) != i]
            rest, rest_taken = together(said, at, others, size)
            share, front, behind = 0.0, 0.0, 0.0
            for n in range(size):
                weight, column = seen[begin + n], at[k] + n
                every = rest[n] + rest_taken[n]
                share += weight * rest[n] * said[3, column]
                front += weight * every * said[0, column]
                behind += weight * (every * said[1, column] + rest[n] * said[2, column])
            if total > 0.0:
                hidden[k] = share / total
            if front + behind > 0.0:
                fronts[k] = front / (front + behind)
    return after, hidden, fronts
