"""Generated expressions."""

from __future__ import annotations

import pytest
from hypothesis import strategies as st

from bayesnet_track.graph.expressions.terms import BINARY, FUNCTIONS, MASK, Call, Number, Variable

NAMES = ("x", "y", "w", "h", "parent.x")


CALLS = [
    *[(name, len(function.parameters)) for name, function in FUNCTIONS.items() if name != MASK],
    *[(sign, 2) for sign in BINARY],
    ("neg", 1),
    ("not", 1),
]


def _calls_of(count, inside):
    names = [name for name, takes in CALLS if takes == count]
    arguments = st.tuples(*[inside] * count)
    return st.builds(Call, st.sampled_from(names), arguments)


def _calls(inside):
    return st.one_of(*(_calls_of(count, inside) for count in (1, 2, 3, 4)))


@pytest.fixture(scope="session")
def terms():
    """Terms of every operation and function."""
    numbers = st.floats(min_value=0, allow_infinity=False, allow_nan=False)
    atoms = numbers.map(Number) | st.sampled_from(NAMES).map(Variable)
    return st.recursive(atoms, _calls, max_leaves=8)
