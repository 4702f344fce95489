"""Joint beliefs against enumeration of all pairs, triples and orders; no pixel counts for two."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq

from bayesnet_track.inference.joint import (
    Edge,
    JointHypotheses,
    Marginal,
    Member,
    PairBatch,
    bad_shares,
    joint_marginals,
)
from bayesnet_track.numerics.kernels.joint_kernels import bad_behind, loss_of, pick_in_strata
from bayesnet_track.numerics.log_weights import DegenerateWeights, LogWeights
from bayesnet_track.numerics.streams import shuffled_of_each


def member(rng, centre, cells=9, copies=1, on=None):
    """A target on `cells` places of a line, each `copies` times: more draws of the same discrete belief."""
    x = np.repeat(centre + np.arange(cells) * 4.0 - 2.0 * (cells - 1), copies)
    boxes = np.column_stack([x, np.full((len(x), 1), 50.0), np.full((len(x), 2), 20.0)])
    prior = np.repeat(rng.uniform(0.2, 1.0, cells), copies)
    likelihood = np.repeat(rng.uniform(-5.0, -0.1, cells), copies)
    level = float(likelihood.min() + likelihood.max()) / 2
    return Member(boxes, LogWeights.normalise(np.log(prior))[0], likelihood, level, on or {})


def behind(bad, hidden, level, occluder, worst, best, agents):
    """Loss of log-likelihood of a box of which a share is hidden."""
    return loss_of(bad_behind(bad, hidden, level, occluder, worst, best), agents)


def share(a, b):
    """Share of the box `a` that lies under the box `b`."""
    sides = [
        min(a[k] + a[k + 2] / 2, b[k] + b[k + 2] / 2) - max(a[k] - a[k + 2] / 2, b[k] - b[k + 2] / 2)
        for k in (0, 1)
    ]
    return max(sides[0], 0.0) * max(sides[1], 0.0) / (a[2] * a[3])


def partly_hidden(one, log, hidden, front):
    """Log-likelihood of a box that is hidden in part: shares that do not match add up, logs do not."""
    top = max(one.top, one.log_likelihood.max())

    def share_of(value):  # solved by bisection for the share at which so much is lost
        return 0.0 if value >= top else brentq(lambda s: top - loss(s, one.agents) - value, 0.0, 9.0)

    worst, best = (share_of(value) for value in (one.log_likelihood.min(), one.log_likelihood.max()))
    on = min(max(share_of(one.on.get(front, top)), best), worst)
    rest = np.clip(share_of(log) - hidden * on, (1 - hidden) * best, (1 - hidden) * worst)
    return top - loss(rest + hidden * share_of(one.level), one.agents)


def loss(bad, agents):
    return agents * (np.logaddexp(0.0, 16.0 * bad - 4.0) - np.logaddexp(0.0, -4.0))


def enumerated(members, edges):
    """Marginals and orders by the sum over every combination of hypotheses and orders."""
    names = list(members)
    weights = {name: np.zeros(len(members[name].boxes)) for name in names}
    fronts = np.zeros(len(edges))
    for places in product(*(range(len(members[name].boxes)) for name in names)):
        at = dict(zip(names, places, strict=True))
        for orders in product((True, False), repeat=len(edges)):
            log, hidden_by = 0.0, {}
            allowed = True
            for edge, first_front in zip(edges, orders, strict=True):
                a, b = edge.pair
                front, back = (a, b) if first_front else (b, a)
                box, over = members[back].boxes[at[back]], members[front].boxes[at[front]]
                hidden = share(box, over)
                log += np.log(edge.first_in_front if first_front else 1 - edge.first_in_front)
                log -= edge.nats * max(hidden, share(over, box))
                if hidden > 0:
                    allowed &= back not in hidden_by
                    hidden_by[back] = (front, hidden)
            if not allowed:
                continue
            for name in names:
                one = members[name]
                own = one.log_likelihood[at[name]]
                if name in hidden_by:
                    front, hidden = hidden_by[name]
                    own = partly_hidden(one, own, hidden, front)
                log += one.prior.log[at[name]] + own
            weight = np.exp(log)
            for name in names:
                weights[name][at[name]] += weight
            fronts += weight * np.array(orders)
    total = weights[names[0]].sum()
    return {name: one / total for name, one in weights.items()}, fronts / total


def keys(seed):
    return lambda pairs: np.array([[seed, 256 * ord(one) + ord(other)] for one, other in pairs], np.uint64)


def sampled(members, edges, seed, closing=()):
    """The same by pairs of draws."""
    marginals, orders = joint_marginals(members, edges, keys(seed), closing)
    found = {
        name: LogWeights.normalise(members[name].prior.log + one.log_likelihood)[0].weights
        for name, one in marginals.items()
    }
    return found, np.array([orders[edge.pair] for edge in edges]), marginals


@pytest.mark.parametrize("nats", [0.0, 1.5])
def test_a_pair_agrees_with_enumeration(nats):
    """Each hypothesis averages R partners: of 300 runs the mean is off by at most 5 standard errors."""
    rng = np.random.default_rng(1)
    members = {"a": member(rng, 50.0, on={"b": -2.0}), "b": member(rng, 58.0)}
    edges = [Edge(("a", "b"), 0.7, nats, pairings=8)]
    truth, fronts = enumerated(members, edges)
    runs = [sampled(members, edges, seed) for seed in range(300)]
    for name in members:
        found = np.array([run[0][name] for run in runs])
        bound = (
            5 * found.std(axis=0) / np.sqrt(len(runs)) + 2e-3
        )  # normalising a few draws biases by O(1 / RN)
        assert np.all(np.abs(found.mean(axis=0) - truth[name]) < bound)
    order = np.array([run[1] for run in runs])
    assert abs(order.mean() - fronts[0]) < 5 * order.std() / np.sqrt(len(runs)) + 2e-3


def test_pairs_are_unbiased_before_they_are_normalised():
    rng = np.random.default_rng(2)
    members = {"a": member(rng, 50.0), "b": member(rng, 55.0)}
    edges = [Edge(("a", "b"), 0.4, pairings=2)]
    runs = [sampled(members, edges, seed)[2]["a"] for seed in range(600)]
    found = np.array([np.exp(one.log_likelihood) for one in runs])
    truth, _ = enumerated(members, edges)
    b, a = members["b"], members["a"]
    exact = joint_marginals(  # as many partners as make each hypothesis of b certain to be met
        members, [Edge(("a", "b"), 0.4, pairings=64)], keys(9)
    )[0]["a"]
    scale = np.exp(exact.log_likelihood) @ a.prior.weights
    expected = truth["a"] / a.prior.weights * scale
    error = found.std(axis=0) / np.sqrt(len(runs))
    assert len(b.boxes) == len(expected)
    assert np.all(np.abs(found.mean(axis=0) - expected) < 5 * error + 0.02 * expected)


def test_more_partners_and_more_hypotheses_come_nearer():
    """The error of a marginal falls as 1 / sqrt(R N): of a hundred times the draws, a fifth at most."""
    truth, _ = enumerated(*small(1))
    errors = []
    for copies, pairings in ((1, 1), (10, 10)):
        members, edges = small(copies, pairings)
        deviations = []
        for seed in range(20):
            found = sampled(members, edges, seed)[0]
            deviations += [found["a"].reshape(9, copies).sum(axis=1) - truth["a"]]
        errors.append(np.sqrt(np.mean(np.square(deviations))))
    assert errors[1] < errors[0] / 5


def small(copies, pairings=8):
    rng = np.random.default_rng(3)
    members = {name: member(rng, x, copies=copies) for name, x in (("a", 50.0), ("b", 57.0))}
    return members, [Edge(("a", "b"), 0.5, 0.5, pairings)]


@pytest.mark.slow
def test_a_chain_and_a_star_agree_with_enumeration():
    """Messages are exact on a tree up to sampling: with 400 hypotheses and 16 partners within 0.02."""
    for edges in (
        [Edge(("a", "b"), 0.6, 0.0, 16), Edge(("b", "c"), 0.3, 0.5, 16)],
        [Edge(("b", "a"), 0.5, 0.0, 16), Edge(("b", "c"), 0.5, 0.0, 16), Edge(("b", "d"), 0.8, 0.0, 16)],
    ):
        names = sorted({name for edge in edges for name in edge.pair})
        few, many = ({}, {})
        for copies, made in ((1, few), (80, many)):
            rng = np.random.default_rng(4)
            for number, name in enumerate(names):
                made[name] = member(rng, 50.0 + 6 * number, cells=5, copies=copies)
        truth, fronts = enumerated(few, edges)
        found, orders, _ = sampled(many, edges, 5)
        for name in names:
            assert np.abs(found[name].reshape(5, 80).sum(axis=1) - truth[name]).max() < 0.02
        assert np.abs(orders - fronts).max() < 0.02


def test_without_an_edge_and_far_apart_marginals_are_independent():
    rng = np.random.default_rng(6)
    members = {"a": member(rng, 50.0), "b": member(rng, 500.0)}
    alone, _ = joint_marginals(members, [], keys(0))
    for name, one in members.items():
        assert alone[name].log_likelihood == pytest.approx(one.log_likelihood)
        assert alone[name].hidden == {}
    found, orders, marginals = sampled(members, [Edge(("a", "b"), 0.7, 3.0, 8)], 0)
    for name, one in members.items():
        own = one.prior.times(one.log_likelihood)[0].weights
        # What b says of a is one number for all of a's hypotheses but for its own sampling: 8 partners.
        assert np.abs(found[name] - own).max() < 0.05
        assert sum(marginals[name].hidden.values()) == 0
    assert orders[0] == pytest.approx(0.7)


def test_swapping_the_two_targets_swaps_the_answers():
    rng = np.random.default_rng(7)
    a, b = member(rng, 50.0, copies=40), member(rng, 56.0, copies=40)
    one, front, _ = sampled({"a": a, "b": b}, [Edge(("a", "b"), 0.8, 0.0, 16)], 1)
    two, behind_, _ = sampled({"b": b, "a": a}, [Edge(("b", "a"), 0.2, 0.0, 16)], 2)
    for name in "ab":
        assert np.abs((one[name] - two[name]).reshape(9, 40).sum(axis=1)).max() < 0.02
    assert front[0] == pytest.approx(1 - behind_[0], abs=0.02)


@pytest.mark.parametrize("occluder", [0.0, 0.3, 0.6])
def test_to_be_hidden_is_better_than_a_bad_match_and_worse_than_a_good_one(occluder):
    level, worst, best = 0.4, 0.6, 0.0
    for hidden in (0.25, 0.5, 1.0):
        found = behind(best, hidden, level, occluder, worst, best, 1)
        assert 0 < found < loss(worst, 1)
    assert behind(worst, 1.0, level, occluder, worst, best, 1) == pytest.approx(loss(level, 1))
    assert behind(0.2, 0.0, level, occluder, worst, best, 2) == pytest.approx(loss(0.2, 2))


def test_a_hidden_target_is_not_pushed_from_under_another_like_it():
    """Its box is moved out from under the one in front: what no longer matches grows faster than what is
    hidden falls, so that the true place stays the best one. Logs that add up would have it elsewhere."""
    level, side = 0.45, 28.0
    for hidden in (0.2, 0.4, 0.6):
        lost = [behind(x / side, hidden - x / side, level, 0.0, 1.0, 0.0, 1) for x in (0.0, 1.0, 2.0, 4.0)]
        assert np.all(np.diff(lost) > 0)
        added = [loss(x / side, 1) + (hidden - x / side) * loss(level, 1) for x in (0.0, 2.0)]
        assert added[1] < added[0]


@pytest.mark.parametrize("agents", [1, 3])
def test_shares_and_losses_are_inverses(agents):
    losses = np.array([0.0, 1e-3, 0.5, 5.8, 150.0])
    shares = bad_shares(losses, agents)
    assert [loss_of(bad, agents) for bad in shares] == pytest.approx(losses, abs=1e-9)
    assert loss(0.25, agents) == pytest.approx(agents * np.log(2 / (1 + np.exp(-4))))


def test_what_matched_before_it_was_hidden_is_remembered():
    """Of a target that cannot be seen the best box is no match: to be hidden is better than any place."""
    boxes = np.array([[50.0, 50.0, 20.0, 20.0], [80.0, 50.0, 20.0, 20.0]])
    lost = Member(boxes, LogWeights.uniform(2), np.array([-5.8, -5.79]), -2.9, top=0.0, on={"b": -5.8})
    front = Member(boxes[:1], LogWeights.uniform(1), np.array([-0.1]), -2.9)
    found, fronts, marginals = sampled({"a": lost, "b": front}, [Edge(("a", "b"), 0.5)], 0)
    truth, orders = enumerated({"a": lost, "b": front}, [Edge(("a", "b"), 0.5)])
    assert found["a"] == pytest.approx(truth["a"], abs=1e-6)
    assert fronts == pytest.approx(orders, abs=2e-3)  # each end averages over its own 8 partners
    assert found["a"][0] > 0.8 and marginals["a"].hidden["b"] > 0.8


def test_pairs_that_close_a_ring_are_heard():
    """Three that meet: with the third pair heard once the marginals are nearer to those of the whole ring."""
    few, many = {}, {}
    for copies, made in ((1, few), (80, many)):
        rng = np.random.default_rng(11)
        for name, x in zip("abc", (50.0, 57.0, 61.0), strict=True):
            made[name] = member(rng, x, cells=5, copies=copies)
    tree, ring = (
        [Edge(("b", "c"), 0.5, 0.0, 16), Edge(("a", "b"), 0.5, 0.0, 16)],
        [Edge(("a", "c"), 0.9, 0, 16)],
    )
    truth, _ = enumerated(few, [*tree, *ring])
    errors = []
    for closing in ([], ring):
        found, orders, _ = sampled(many, tree, 5, closing)
        errors.append(sum(np.abs(found[n].reshape(5, 80).sum(axis=1) - truth[n]).sum() for n in "abc"))
    assert errors[1] < errors[0] / 2
    assert len(orders) == 2


@given(
    places=st.lists(st.tuples(st.floats(30, 70), st.floats(30, 70)), min_size=2, max_size=4),
    sides=st.tuples(st.floats(5, 40), st.floats(5, 40)),
    fronts=st.lists(st.booleans(), min_size=3, max_size=3),
)
def test_no_pixel_counts_for_two_joined_targets(places, sides, fronts):
    """Certain boxes and orders: along the chain, what stays visible of a joined pair never overlaps."""
    names = "abcd"[: len(places)]
    boxes = {name: np.array([[*place, *sides]]) for name, place in zip(names, places, strict=True)}
    members = {
        name: Member(box, LogWeights.uniform(1), np.array([-1.0]), -3.0) for name, box in boxes.items()
    }
    edges = [
        Edge((first, second), 1.0 - 1e-9 if front else 1e-9)
        for first, second, front in zip(names, names[1:], fronts, strict=False)
    ]
    marginals, _ = joint_marginals(members, edges, keys(0))
    for name in names:
        assert 0 <= sum(marginals[name].hidden.values()) <= 1 + 1e-9
    if len(names) > 2:
        return
    (first, second), (front,) = names, fronts[:1]
    back, over = (second, first) if front else (first, second)
    shared = share(boxes[back][0], boxes[over][0])
    # The one behind counts 1 - shared of its box: the pixels of the overlap count once, for the one in front.
    assert marginals[back].hidden[over] == pytest.approx(shared, abs=1e-6)
    assert marginals[over].hidden[back] == pytest.approx(0.0, abs=1e-6)


def test_partners_are_drawn_in_proportion_and_one_from_each_stratum():
    rng = np.random.default_rng(8)
    one = member(rng, 50.0)
    boxes, shares = one.boxes, rng.dirichlet(np.ones(len(one.boxes)))
    order = JointHypotheses.of({"a": one}).by_place
    each = shuffled_of_each(np.array([[8, 0]], np.uint64), np.array([0, 2000]), np.array([4]))
    shifts, turns = each[0], each[1].reshape(4, 500)
    picked = pick_in_strata(order, np.cumsum(shares[order]), shifts).reshape(4, 500)
    drawn = np.take_along_axis(picked, turns, axis=1)
    counts = np.bincount(drawn.ravel(), minlength=len(boxes))
    assert np.abs(counts - 2000 * shares).max() < 2  # systematic: within one draw at either end of a share
    assert np.all(np.diff(np.sort(boxes[drawn, 0].mean(axis=1))) >= 0)
    assert boxes[drawn[0], 0].max() <= boxes[drawn[1], 0].min()


def test_likelihoods_of_zero_and_rings():
    rng = np.random.default_rng(9)
    a, b = member(rng, 50.0), member(rng, 52.0)
    a.log_likelihood[2:] = -np.inf
    found, _, _ = sampled({"a": a, "b": b}, [Edge(("a", "b"), 0.5)], 0)
    assert np.isfinite(found["a"]).all() and found["a"].sum() == pytest.approx(1)
    ring = [Edge(pair, 0.5) for pair in (("a", "b"), ("b", "c"), ("c", "a"))]
    with pytest.raises(ValueError, match="close a ring"):
        sampled({"a": b, "b": b, "c": b}, ring, 0)
    assert Marginal(np.zeros(1), {}).hidden == {}


@pytest.mark.parametrize("nats", [0.0, 1.5])
def test_a_few_hypotheses_agree_with_enumeration(nats):
    """As a pair of nine places each, cheap enough for plain Python: four places, 60 runs."""
    rng = np.random.default_rng(7)
    members = {"a": member(rng, 50.0, cells=4, on={"b": -2.0}), "b": member(rng, 58.0, cells=4)}
    edges = [Edge(("a", "b"), 0.7, nats, pairings=8)]
    truth, fronts = enumerated(members, edges)
    runs = [sampled(members, edges, seed) for seed in range(60)]
    for name in members:
        found = np.array([run[0][name] for run in runs])
        bound = 5 * found.std(axis=0) / np.sqrt(len(runs)) + 5e-3  # O(1 / R N) by normalising
        assert np.all(np.abs(found.mean(axis=0) - truth[name]) < bound)
    order = np.array([run[1] for run in runs])
    assert abs(order.mean() - fronts[0]) < 5 * order.std() / np.sqrt(len(runs)) + 5e-3


def test_a_short_chain_agrees_with_enumeration():
    """With 90 hypotheses and 8 partners each within 0.05: 1 / sqrt(720), with a margin."""
    edges = [Edge(("a", "b"), 0.6, 0.0, 8), Edge(("b", "c"), 0.3, 0.5, 8)]
    few, many = {}, {}
    for copies, made in ((1, few), (30, many)):
        rng = np.random.default_rng(4)
        for number, name in enumerate("abc"):
            made[name] = member(rng, 50.0 + 6 * number, cells=3, copies=copies)
    truth, fronts = enumerated(few, edges)
    found, orders, _ = sampled(many, edges, 5)
    for name in "abc":
        assert np.abs(found[name].reshape(3, 30).sum(axis=1) - truth[name]).max() < 0.05
    assert np.abs(orders - fronts).max() < 0.05


def test_what_is_known_of_a_target_is_what_its_own_weights_say():
    """Of targets with different numbers of hypotheses, each as by itself."""
    rng = np.random.default_rng(12)
    members = {
        name: Member(one.boxes, one.prior, one.log_likelihood, one.level, {"b": -3.0}, agents)
        for name, agents, one in (
            ("a", 1, member(rng, 50.0)),
            ("b", 2, member(rng, 56.0)),
            ("c", 1, member(rng, 53.0, cells=4)),
        )
    }
    together = JointHypotheses.of(members)
    hidden = together.hidden(members, [("a", "b"), ("c", "a")])
    for m, (name, one) in enumerate(members.items()):
        alone, own = JointHypotheses.of({name: one}), slice(together.starts[m], together.starts[m + 1])
        for column in ("losses", "bad", "seen", "by_place", "log_likelihood"):
            assert getattr(together, column)[own].tobytes() == getattr(alone, column).tobytes()
        assert together.log_evidence[m] == alone.log_evidence[0]
        losses = one.log_likelihood.max() - one.log_likelihood
        np.testing.assert_allclose(alone.losses, losses, atol=1e-14)
        np.testing.assert_allclose(alone.bad, bad_shares(losses, one.agents), atol=1e-14)
        evidence = one.prior.times(one.log_likelihood)[1] - one.log_likelihood.max()
        assert alone.log_evidence[0] == pytest.approx(evidence, abs=1e-14)
    for row, name, on in ((0, "a", -3.0), (1, "c", None)):
        one = members[name]
        perfect, worst = one.log_likelihood.max(), one.log_likelihood.max() - one.log_likelihood.min()
        losses = [perfect - one.level, 0.0 if on is None else min(perfect - on, worst), worst, 0.0]
        np.testing.assert_allclose(hidden[row], [*bad_shares(np.array(losses), 1), 1], atol=1e-14)


def test_groups_of_targets_have_the_bits_of_each_group_alone():
    rng = np.random.default_rng(13)
    members = {
        name: member(rng, 50.0 + 4 * k, cells=9 if k < 3 else 4, on={"b": -2.0})
        for k, name in enumerate("abcde")
    }
    chain, ring = [Edge(("a", "b"), 0.3, 1.0), Edge(("b", "c"), 0.6)], [Edge(("c", "a"), 0.5)]
    pair = [Edge(("d", "e"), 0.8)]
    _, orders, together = sampled(members, chain + pair, 3, ring)
    for edges, closing, count in ((chain, ring, 2), (pair, [], 1)):
        some = {name: members[name] for edge in edges for name in edge.pair}
        _, own, alone = sampled(some, edges, 3, closing)
        assert own.tobytes() == (orders[:2] if count == 2 else orders[2:]).tobytes()
        for name, one in alone.items():
            assert one.log_likelihood.tobytes() == together[name].log_likelihood.tobytes()
            assert one.hidden == together[name].hidden


def test_a_target_without_a_hypothesis_is_an_error():
    one = member(np.random.default_rng(1), 50.0)
    none = Member(one.boxes, one.prior, np.full(len(one.boxes), -np.inf), -1.0)
    with pytest.raises(DegenerateWeights):
        joint_marginals({"a": one, "b": none}, [Edge(("a", "b"), 0.5)], keys(0))


def test_each_pair_speaks_after_those_whom_its_speaker_has_to_hear():
    rng = np.random.default_rng(14)
    crowd = JointHypotheses.of({name: member(rng, 50.0 + 4 * k) for k, name in enumerate("abcd")})
    edges = [Edge(pair, 0.4) for pair in (("a", "b"), ("b", "c"), ("b", "d"))]
    above = {"a": None, "b": "a", "c": "b", "d": "b"}
    batch = PairBatch.along(crowd, edges, [Edge(("c", "a"), 0.4)], above)
    assert sorted(batch.order) == list(range(8)) and batch.columns == 8 * 9
    for turn, k in enumerate(batch.order):
        assert set(batch.before[k]) <= set(batch.order[:turn])
        heard = {batch.pairs[one] for one in batch.before[k]}
        speaker, hearer = batch.pairs[k]
        if {speaker, hearer} == {"a", "c"}:
            assert not heard, "what closes a ring is said by itself"
        else:
            assert heard == {pair for pair in batch.pairs if pair[1] == speaker and pair[0] != hearer}
