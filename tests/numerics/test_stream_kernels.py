"""Uniforms and permutations of many streams against NumPy's own generator, bit by bit."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.numerics.resampling import look_up_even, look_up_even_of_each
from bayesnet_track.numerics.streams import Streams, shuffled_of_each, uniforms_of_each

WORD = st.integers(0, 2**64 - 1)


def philox(key):
    return np.random.Generator(np.random.Philox(key=np.array(key, np.uint64), counter=0))


@given(st.lists(st.tuples(WORD, WORD, st.integers(0, 9)), min_size=1, max_size=8))
def test_uniforms_are_those_of_philox(several):
    expected = np.concatenate([philox(key).random(count) for *key, count in several])
    starts = np.cumsum([0, *(count for *_, count in several)])
    found = uniforms_of_each(np.array([key for *key, _ in several], np.uint64), starts)
    np.testing.assert_array_equal(found, expected)


@given(st.lists(st.tuples(WORD, WORD, st.integers(1, 4), st.integers(1, 40)), min_size=1, max_size=4))
def test_permutations_follow_the_uniforms(several):
    """Fisher and Yates with the halves of the words that come next, masked, those too large left out."""
    starts = np.cumsum([0, *(rounds * size for *_, rounds, size in several)])
    keys = np.array([key for *key, _, _ in several], np.uint64)
    uniforms, turns = shuffled_of_each(keys, starts, np.array([rounds for *_, rounds, _ in several]))
    np.testing.assert_array_equal(uniforms, uniforms_of_each(keys, starts))
    for (*key, rounds, size), first, last in zip(several, starts[:-1], starts[1:], strict=True):
        words = philox(key).bit_generator.random_raw(8 * rounds * size + 400)[rounds * size :]
        halves = iter(np.column_stack([words & 0xFFFFFFFF, words >> np.uint64(32)]).ravel().tolist())
        for found in turns[first:last].reshape(rounds, size).tolist():
            row = [*range(size)]
            for n in range(size - 1, 0, -1):
                mask = 2 ** n.bit_length() - 1
                chosen = next(value & mask for value in halves if value & mask <= n)
                row[n], row[chosen] = row[chosen], row[n]
            assert found == row


def test_uniforms_of_streams_are_their_first_numbers():
    streams, targets = Streams(11), [str(k) for k in range(50)]
    expected = [streams.of(target, "root", 7, "cloud").random() for target in targets]
    assert streams.uniforms(targets, "root", 7, "cloud").tolist() == expected
    several = streams.uniforms(["1", "2"], "root", 7, "cloud", [3, 1]).tolist()
    assert several == [*streams.of("1", "root", 7, "cloud").random(3), expected[2]]


@given(st.integers(0, 1000))
def test_parents_of_each_are_those_of_one(seed):
    rng = np.random.default_rng(seed)
    weights, shifts = rng.exponential(size=(4, 30)) ** 3, rng.random(4)
    for row, *one in zip(look_up_even_of_each(weights, shifts, 25), weights, shifts, strict=True):
        np.testing.assert_array_equal(row, look_up_even(*one, 25))
