"""States of what is detected, against sums over all their sequences; estimates against what was drawn."""

from itertools import product

import numpy as np
import pytest

from bayesnet_track.adapt.existence import count_lasting, estimate_chain, share_hidden
from bayesnet_track.adapt.presence import LASTS, UNSEEN, Known, Presence, Weights, expect_cover, pass_time
from bayesnet_track.numerics.records import evolve

SURVIVAL, SHARE = 0.97, 0.4
CHAIN = estimate_chain(0.75, 0.85, 4.0, 5.0)
OPEN, BLIND, HIDDEN, SPOT, DOUBLE, ABSENT = range(6)
START = np.array([0.35, 0.05, 0.0, 0.2, 0.1, 0.3])


def transition(cover):
    """(6, 6) from the states of one look to those of the next, written down one by one."""
    time, covered = np.eye(6), np.eye(6)
    time[OPEN, [OPEN, BLIND]] = 1 - CHAIN.enter, CHAIN.enter
    time[BLIND, [OPEN, BLIND]] = CHAIN.leave, 1 - CHAIN.leave
    for state in (OPEN, BLIND, HIDDEN):
        time[state] *= SURVIVAL
        time[state, ABSENT] = 1 - SURVIVAL
    for state in (SPOT, DOUBLE):
        time[state, [state, ABSENT]] = 0.8, 0.2
    stay = cover * (SHARE + (1 - SHARE) * LASTS * cover)
    enter = cover * SHARE * (1 - LASTS * cover)
    covered[OPEN, [OPEN, HIDDEN]] = 1 - enter, enter
    covered[HIDDEN, [OPEN, HIDDEN]] = 1 - stay, stay
    covered[DOUBLE, [DOUBLE, ABSENT]] = cover, 1 - cover
    return time @ covered


@pytest.mark.parametrize("cover", [0.0, 0.6, 1.0])
@pytest.mark.parametrize("looks", ["1111", "1000", "0010", "1101"])
def test_the_filter_is_the_sum_over_all_sequences_of_states(looks, cover):
    d = np.array([CHAIN.detection, UNSEEN, UNSEEN, CHAIN.detection, CHAIN.detection, 0.0])
    moves, total = transition(cover), np.zeros(6)
    for states in product(range(6), repeat=len(looks) + 1):
        p = START[states[0]]
        for before, after, look in zip(states, states[1:], looks, strict=False):
            p *= moves[before, after] * (d[after] if look == "1" else 1 - d[after])
        total[states[-1]] += p
    total /= total.sum()
    existence = START[None, :3].sum(axis=1)
    presence = evolve(
        Presence.sure(1), blind=START[1:2] / existence, spot=START[3:4].copy(), double=START[4:5].copy()
    )
    for look in looks:
        presence = expect_cover(pass_time(presence, CHAIN, 1.0), np.full(1, cover), SHARE)
        weights = Weights.of(SURVIVAL * existence, presence, CHAIN)
        existence, presence = weights.after(np.array([float(look)]))
    assert existence[0] == pytest.approx(total[:3].sum(), rel=1e-9)
    parts = presence.blind[0] * existence[0], presence.hidden[0] * existence[0]
    np.testing.assert_allclose([*parts, presence.spot[0], presence.double[0]], total[1:5], atol=1e-12)


def test_runs_of_misses_keep_a_target_that_independent_misses_would_end():
    runs, independent = estimate_chain(0.8, 0.95, 6.0, 1.0), estimate_chain(0.8, 0.95, 1.0, 1.0)
    left = []
    for chain in (runs, independent):
        existence, presence = np.ones(1), Presence.sure(1)
        for _ in range(4):
            presence = pass_time(presence, chain, 1.0)
            existence, presence = Weights.of(0.99 * existence, presence, chain).after(np.zeros(1))
        left.append(float(existence[0]))
    assert left[0] > 0.6 > 0.2 > left[1]
    assert presence.blind[0] == 0.0  # independent misses make nobody blind


def test_the_chain_has_the_rates_that_it_was_estimated_from():
    chain, rng = estimate_chain(0.7, 0.85, 6.0, 5.0), np.random.default_rng(0)
    draws, states = rng.random((2, 4000, 50)), np.zeros((4000, 50), bool)
    states[0] = draws[0, 0] < chain.blind_share
    for k in range(1, 4000):
        states[k] = draws[0, k] < np.where(states[k - 1], 1 - chain.leave, chain.enter)
    seen = ~states & (draws[1] < chain.detection)
    assert seen.mean() == pytest.approx(0.7, abs=0.01)
    assert seen[1:][seen[:-1]].mean() == pytest.approx(0.85, abs=0.01)
    assert estimate_chain(0.9, 0.8, 6.0, 5.0).enter == 0.0  # misses that are not in runs


def test_lasting_false_alarms_are_counted_by_how_often_they_were_seen():
    rng = np.random.default_rng(1)
    lasting = rng.random(4000) < 0.3
    seen = np.where(lasting, rng.geometric(0.2, 4000), 1).astype(float)
    ones = np.ones(4000)
    over = evolve(Presence.sure(4000), seen=seen, begun=ones, near=0.25 * ones)
    found, false = count_lasting(over, 0.995, 5.0)
    assert found.sum() / false.sum() == pytest.approx(0.3, abs=0.03)
    assert found[1] / found.sum() == pytest.approx(0.25)
    targets = evolve(over.take(slice(100)), seen=np.full(100, 60.0))
    assert count_lasting(targets, 0.995, 5.0)[1].sum() < 1.0  # who was seen so often was a target


def test_presence_is_found_by_name_and_a_new_target_was_just_detected():
    known = Known(("1", "2"), evolve(Presence.sure(2), blind=np.array([0.1, 0.2])))
    assert known.of(("2", "7", "1")).blind.tolist() == [0.2, 0.0, 0.1]
    assert known.of(("1", "2")) is known.presence
    assert share_hidden(0.02, 0.5) == share_hidden(0.02, 0.02) == 0.0  # nothing tells one from the other
