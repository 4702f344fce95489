"""A stream depends on its seed and names alone."""

import hashlib
import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.numerics.streams import Streams

keys = st.tuples(st.text(max_size=4), st.text(max_size=4), st.integers(0, 99), st.text(max_size=4))


@given(st.integers(0, 2**63), st.lists(keys, min_size=2, max_size=6, unique=True), st.randoms())
def test_no_draw_depends_on_the_order(seed, names, random):
    drawn = {name: Streams(seed).of(*name).random(3).tolist() for name in names}
    streams = Streams(seed)
    for name in random.sample(names, len(names)):
        assert streams.of(*name).random(3).tolist() == drawn[name]


def test_every_part_of_the_key_counts():
    options = [("1", "2"), ("node", "other"), (1, 2), ("resample", "propagate")]
    first = {Streams(seed).of(*key).random() for seed in (0, 1) for key in itertools.product(*options)}
    assert len(first) == 32


def test_names_do_not_run_together():
    assert Streams(0).of("ab", "c", 1, "p").random() != Streams(0).of("a", "bc", 1, "p").random()


def test_streams_are_uncorrelated():
    draws = np.array([Streams(5).of("1", "n", frame, "p").standard_normal(2000) for frame in range(10)])
    correlation = np.corrcoef(draws)[np.triu_indices(10, 1)]
    # sd of a correlation of 2000 pairs is 1 / sqrt(2000); 45 of them within 4 sd.
    assert np.abs(correlation).max() < 4 / np.sqrt(2000)


def test_the_same_key_gives_the_same_numbers_on_every_machine():
    assert Streams(7).of("1", "square", 3, "propagate").integers(0, 2**32, 3).tolist() == GOLDEN


GOLDEN = [164445498, 2586350247, 3263270375]


def test_the_key_is_the_hash_of_the_names():
    digest = hashlib.blake2b(b"7\x1f1\x1fsquare\x1f3\x1fpropagate", digest_size=16).digest()
    keyed = np.random.Generator(np.random.Philox(key=int.from_bytes(digest, "little")))
    found = Streams(7).of("1", "square", 3, "propagate")
    assert found.standard_normal(100).tolist() == keyed.standard_normal(100).tolist()


def test_one_generator_serves_many_keys_with_the_numbers_of_each():
    """Also after a draw that leaves half of a word behind."""

    def draw(rng):
        return rng.integers(0, 2**32, 3, dtype=np.uint32).tolist(), rng.standard_normal(5).tolist()

    streams = Streams(7)
    assert [draw(rng) for rng in streams.of_each("abca", "n", 3, "p")] == [
        draw(streams.of(name, "n", 3, "p")) for name in "abca"
    ]
