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
    each, measures = np.empty((4, log.shape[0])), np.empty((4, starts.shape[0] - 1))
    for m in range(measures.shape[1]):
        best_log = -np.inf
        for n in range(starts[m], starts[m + 1]):
            best_log = max(best_log, log[n])
        perfect, lowest, highest = max(tops[m], best_log), best_log, -np.inf
        for n in range(starts[m], starts[m + 1]):
            value = max(log[n], best_log - farthest)
            lowest, loss = min(lowest, value), perfect - value
            share = loss / agents[m]
            odds = np.log(np.expm1(share) + np.exp(share - steep))
            each[0, n], each[1, n] = value, loss
            each[2, n] = max((odds + steep) / (steep / half), 0.0)
            each[3, n] = weights[n] * np.exp(value - best_log)
            highest = max(highest, log_weights[n] - loss)
        total = 0.0
        for n in range(starts[m], starts[m + 1]):
            total += np.exp(log_weights[n] - each[1, n] - highest)
        measures[0, m], measures[1, m] = perfect, highest + np.log(total)
        measures[2, m], measures[3, m] = perfect - lowest, perfect - best_log
    return each, measures


@compiled
def together(messages: Floats, offsets: Indices, speaking: Indices, size: int) -> tuple[Floats, Floats]:
    """(N,) products of what the pairs say of one target: where none hides it, and where one does."""
    free, occluded = np.ones(size), np.zeros(size)
    for k in speaking:
        for n in range(size):
            factor = messages[0, offsets[k] + n] + messages[1, offsets[k] + n]
            occluded[n] = occluded[n] * factor + free[n] * messages[2, offsets[k] + n]
            free[n] *= factor
    return free, occluded


@compiled
def ask_partners(
    k: int,
    members: Members,
    starts: Indices,
    evidence: Floats,
    pairs: Pairs,
    hearing: HearingPairs,
    draws: Draws,
    messages: Floats,
) -> tuple[Indices, Floats, Floats, Floats]:
    """Partners (R, N) of the hearer's hypotheses in pair k, and of the speaker's M what weighs them.

    These are log beta / q, for partners drawn by q; and what further targets say, none or one of which hides
    them. See `speak`.
    """
    _, _, _, posterior, prior, prior_log, by_place = members
    speakers, hearers, offsets = pairs
    shifts, turns, begins, rounds = draws
    first, size = starts[speakers[k]], starts[speakers[k] + 1] - starts[speakers[k]]
    free, occluded = together(messages, offsets, hearing[1][hearing[0][k] : hearing[0][k + 1]], size)
    shares, log_importance, bounds = np.empty(size), np.empty(size), np.empty(size)
    total, level = 0.0, 0.0
    for n in range(size):
        shares[n] = posterior[first + n] * (free[n] + occluded[n])
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
    return partners, log_importance, free, occluded


@compiled
def speak(
    order: Indices,
    members: Members,
    starts: Indices,
    evidence: Floats,
    pairs: Pairs,
    hearing: HearingPairs,
    draws: Draws,
    rules: tuple[Floats, Floats, Floats],
    messages: Floats,
) -> None:
    """Fill in what the speakers of the pairs in `order` say, one after the other.

    Args:
        order: pairs; what one has to hear is said before.
        members: boxes (S, 4), then (S,) losses, shares that do not match, prior weights times L, prior
            weights, their logarithms, and the order of a target's hypotheses by place.
        starts: (M + 1,).
        evidence: (M,) log-evidence.
        pairs: (K,) speakers, hearers, and offsets of their messages.
        hearing: (K + 1,) where the pairs begin in the second (H,), whose speakers speak of the speaker
            before.
        draws: shifts, turns, (K,) where those of a pair begin, and (K,) partners of each hypothesis.
        rules: (K, 5) what stands for hidden pixels of the speaker, of the hearer; (K, 2) probability that the
            hearer is in front, and log-odds against one box wholly on the other.
        messages: (4, ...) as `pair_sums` has it.
    """
    boxes, losses, bad = members[0], members[1], members[2]
    for k in order:
        partners, log_importance, free, occluded = ask_partners(
            k, members, starts, evidence, pairs, hearing, draws, messages
        )
        first, stop = starts[pairs[0][k]], starts[pairs[0][k] + 1]
        begin, end = starts[pairs[1][k]], starts[pairs[1][k] + 1]
        speaker_rules, hearer_rules = rules[0][k], rules[1][k]
        sums = pair_sums(
            boxes[begin:end],
            losses[begin:end],
            bad[begin:end],
            (hearer_rules[0], hearer_rules[1], hearer_rules[2], hearer_rules[3], int(hearer_rules[4])),
            boxes[first:stop],
            losses[first:stop],
            bad[first:stop],
            (speaker_rules[0], speaker_rules[1], speaker_rules[2], speaker_rules[3], int(speaker_rules[4])),
            partners,
            log_importance,
            free,
            occluded,
            rules[2][k, 0],
            rules[2][k, 1],
        )
        for row in range(4):
            for n in range(end - begin):
                messages[row, pairs[2][k] + n] = sums[row, n]


@compiled
def conclude(
    log: Floats, posterior: Floats, starts: Indices, offsets: Indices, hearing: HearingPairs, messages: Floats
) -> tuple[Floats, Floats, Floats]:
    """Combine for each target all messages that it receives.

    Args:
        log: (S,) log-likelihoods.
        posterior: (S,) prior weights times L.
        starts: (M + 1,).
        offsets: (K,).
        hearing: (M + 1,) where the targets begin in the second (K,), the pairs in which each hears.
        messages: (4, ...).

    Returns:
        (S,) log of the likelihoods times all that is said; (K,) expected share that the speaker hides of the
        hearer; (K,) probability that the hearer is in front, by all that the hearer knows.
    """
    combined, hidden, fronts = log.copy(), np.zeros(offsets.shape[0]), np.full(offsets.shape[0], 0.5)
    for m in range(starts.shape[0] - 1):
        begin, size = starts[m], starts[m + 1] - starts[m]
        hears = hearing[1][hearing[0][m] : hearing[0][m + 1]]
        if hears.shape[0] == 0:
            continue
        free, occluded = together(messages, offsets, hears, size)
        total = 0.0
        for n in range(size):
            combined[begin + n] += np.log(free[n] + occluded[n])
            total += posterior[begin + n] * (free[n] + occluded[n])
        for i in range(hears.shape[0]):
            k, other_pairs = hears[i], hears[np.arange(hears.shape[0]) != i]
            other_free, other_occluded = together(messages, offsets, other_pairs, size)
            share, front, behind = 0.0, 0.0, 0.0
            for n in range(size):
                weight, column = posterior[begin + n], offsets[k] + n
                other_total = other_free[n] + other_occluded[n]
                share += weight * other_free[n] * messages[3, column]
                front += weight * other_total * messages[0, column]
                behind += weight * (other_total * messages[1, column] + other_free[n] * messages[2, column])
            if total > 0.0:
                hidden[k] = share / total
            if front + behind > 0.0:
                fronts[k] = front / (front + behind)
    return combined, hidden, fronts
