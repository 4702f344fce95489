"""Whole numbers as text, against Python's own."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from bayesnet_track.numerics.kernels.text_kernels import texts_of

LIMIT = 2**63 - 1


@given(
    arrays(
        np.int64,
        st.tuples(st.integers(0, 3), st.integers(1, 4), st.integers(1, 4)),
        elements=st.integers(-LIMIT, LIMIT),
    )
)
def test_lists_are_written_as_python_writes_them(lists):
    assert texts_of(lists) == [repr(one) for one in lists.tolist()]


def test_digits_and_signs():
    assert texts_of(np.array([[[0, 9, 10, -1]], [[-10, 99, 100, 1280]]])) == [
        "[[0, 9, 10, -1]]",
        "[[-10, 99, 100, 1280]]",
    ]
