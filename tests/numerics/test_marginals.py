"""Marginal association probabilities against enumeration of every joint association."""

from itertools import pairwise, permutations

import numpy as np
import pytest

from bayesnet_track.numerics.association import Marginals, group_pairs, marginalise, weigh_pairs


def enumerated(weights: np.ndarray) -> np.ndarray:
    """(T, N) marginals of a table of weights, 0 for impossible, by going through all associations."""
    count, found = weights.shape
    total, pairs = 0.0, np.zeros_like(weights)
    choices = [*range(found), *([None] * count)]
    for chosen in set(permutations(choices, count)):
        product = np.prod([weights[t, n] for t, n in enumerate(chosen) if n is not None])
        total += product
        for t, n in enumerate(chosen):
            if n is not None:
                pairs[t, n] += product
    return pairs / total


def of_table(weights: np.ndarray, **settings) -> Marginals:
    rows, columns = np.nonzero(weights)
    return marginalise(rows, columns, weights[rows, columns], weights.shape, **settings)


def test_pairs_in_whatever_layout_need_one_compiled_version():
    pairs = np.array([[0, 0], [0, 1], [1, 1]])
    strided, whole = (
        marginalise(*columns, np.array([3.0, 1.0, 2.0]), (2, 2)) for columns in (pairs.T, pairs.T.copy())
    )
    assert not pairs.T[0].flags.c_contiguous
    np.testing.assert_array_equal(strided.pairs, whole.pairs)
    assert len(weigh_pairs.signatures) == 1


def table(found: Marginals, weights: np.ndarray) -> np.ndarray:
    result = np.zeros_like(weights)
    result[np.nonzero(weights)] = found.pairs
    return result


def random_table(seed: int, shape: tuple[int, int], spread: float = 4.0, possible: float = 0.7) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.exp(rng.normal(0, spread, shape)) * (rng.random(shape) < possible)


@pytest.mark.parametrize("shape", [(1, 1), (1, 4), (4, 1), (3, 3), (2, 5), (5, 2), (4, 4)])
def test_small_groups_are_exact(shape):
    for seed in range(5):
        weights = random_table(seed, shape)
        found = of_table(weights)
        assert found.is_exact.all()
        np.testing.assert_allclose(table(found, weights), enumerated(weights), rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(found.missed, 1 - enumerated(weights).sum(axis=1), atol=1e-9)
        np.testing.assert_allclose(found.free, 1 - enumerated(weights).sum(axis=0), atol=1e-9)


def test_a_group_with_one_small_side_is_exact_however_large_the_other():
    weights = random_table(1, (3, 40), possible=1.0)
    by_sets, by_messages = of_table(weights), of_table(weights, most_exact=0)
    assert by_sets.is_exact.all() and not by_messages.is_exact.any()
    assert of_table(weights.T).is_exact.all()
    np.testing.assert_allclose(table(of_table(weights.T), weights.T).T, table(by_sets, weights), rtol=1e-9)


@pytest.mark.parametrize("seed", range(8))
def test_belief_propagation_is_exact_on_trees(seed):
    rng = np.random.default_rng(seed)
    weights = np.zeros((4, 5))
    weights[0, :2], weights[1, 1:3], weights[2, 2:4], weights[3, [0]] = 1, 1, 1, 1
    weights[weights > 0] = np.exp(rng.normal(0, 4, int((weights > 0).sum())))
    found = of_table(weights, most_exact=0)
    np.testing.assert_allclose(table(found, weights), enumerated(weights), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(("ratio", "error"), [(1.0, 0.003), (2.0, 0.01), (10.0, 0.05)])
def test_belief_propagation_is_close_on_loops_that_tell_little(ratio, error):
    worst = 0.0
    for seed in range(20):
        weights = np.exp(np.random.default_rng(seed).uniform(0, np.log(ratio), (5, 5)))
        exact, loopy = of_table(weights), of_table(weights, most_exact=0)
        worst = max(worst, np.abs(exact.pairs - loopy.pairs).max())
    assert worst < error


def test_the_error_of_belief_propagation_grows_with_what_the_weights_tell():
    def worst(ratio):
        tables = (
            np.exp(np.random.default_rng(k).uniform(-1, 1, (5, 5)) * np.log(ratio) / 2) for k in range(20)
        )
        return max(np.abs(of_table(w).pairs - of_table(w, most_exact=0).pairs).max() for w in tables)

    assert worst(2.0) < worst(100.0) < worst(1e4) < 0.5


def test_a_group_is_the_same_bytes_alone_and_beside_others():
    one, other = random_table(3, (3, 4), possible=1.0), random_table(4, (9, 9), possible=1.0)
    both = np.zeros((12, 13))
    both[:3, :4], both[3:, 4:] = one, other
    found = of_table(both)
    np.testing.assert_array_equal(table(found, both)[:3, :4], table(of_table(one), one))
    np.testing.assert_array_equal(table(found, both)[3:, 4:], table(of_table(other), other))


def test_large_weights_stay_numbers():
    weights = np.full((7, 7), 1e300)
    found = of_table(weights)
    np.testing.assert_allclose(found.pairs, 1 / 7, rtol=1e-9)
    assert found.missed.max() < 1e-9
    wide = of_table(np.full((9, 9), 1e300))
    np.testing.assert_allclose(wide.pairs, 1 / 9, rtol=1e-3)


def test_where_nothing_is_possible_all_are_missed():
    nothing = marginalise(np.empty(0, int), np.empty(0, int), np.empty(0), (2, 3))
    assert nothing.missed.tolist() == [1, 1] and nothing.free.tolist() == [1, 1, 1]


@pytest.mark.parametrize("weight", [-1.0, np.nan])
def test_weights_are_numbers_from_0_on(weight):
    with pytest.raises(ValueError, match="expected a number from 0 on"):
        marginalise(np.array([0]), np.array([0]), np.array([weight]), (1, 1))


def test_pairs_are_grouped_by_what_they_share():
    order, starts = group_pairs(np.array([0, 2, 1, 2]), np.array([1, 0, 1, 3]), 3, 4)
    assert [order[a:b].tolist() for a, b in pairwise(starts)] == [[0, 2], [1, 3]]
