"""The first uniform of many streams against NumPy's own generator, bit by bit."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.numerics.kernels.resampling_kernels import look_up_even, look_up_even_of_each
from bayesnet_track.numerics.kernels.stream_kernels import first_uniforms
from bayesnet_track.numerics.streams import Streams

WORD = st.integers(0, 2**64 - 1)


@given(st.lists(st.tuples(WORD, WORD), min_size=1, max_size=8))
def test_uniforms_are_those_of_philox(keys):
    expected = [
        np.random.Generator(np.random.Philox(key=np.array(key, np.uint64), counter=0)).random()
        for key in keys
    ]
    np.testing.assert_array_equal(first_uniforms(np.array(keys, np.uint64)), expected)


def test_uniforms_of_streams_are_their_first_numbers():
    streams, targets = Streams(11), [str(k) for k in range(50)]
    expected = [streams.of(target, "root", 7, "cloud").random() for target in targets]
    assert streams.uniforms(targets, "root", 7, "cloud").tolist() == expected


@given(st.integers(0, 1000))
def test_parents_of_each_are_those_of_one(seed):
    rng = np.random.default_rng(seed)
    weights, shifts = rng.exponential(size=(4, 30)) ** 3, rng.random(4)
    for row, *one in zip(look_up_even_of_each(weights, shifts, 25), weights, shifts, strict=True):
        np.testing.assert_array_equal(row, look_up_even(*one, 25))
