"""The digest of what a kernel is compiled from: it changes with the machine code, and only then."""

import math
import types

import numpy as np
import pytest

from bayesnet_track.numerics.compiled import fingerprint


def recursive(n):
    return 1 if n == 0 else n * recursive(n - 1) + OFFSET


def listed(values):
    return [math.sqrt(one) * LIMIT for one in values] + [names.LIMIT]  # noqa: F821


OFFSET, LIMIT = 0, 2.0


def with_globals(function, **changed):
    return types.FunctionType(function.__code__, {**function.__globals__, **changed})


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (2.0, 2),
        (1.0, 2.0),
        (0.0, -0.0),
        (np.float32(1), np.float64(1)),
        ((1, 2), (2, 1)),
        (np.arange(3), np.arange(4)),
        (np.zeros(2), np.zeros((1, 2))),
        (math.exp, math.log),
        (types.SimpleNamespace, types.MethodType),
        (None, False),
    ],
)
def test_another_constant_gives_another_digest(one, other):
    assert fingerprint(with_globals(listed, LIMIT=one)) != fingerprint(with_globals(listed, LIMIT=other))
    assert fingerprint(with_globals(listed, LIMIT=one)) == fingerprint(with_globals(listed, LIMIT=one))


def test_constants_found_through_a_module_count():
    names = types.ModuleType("names")
    names.LIMIT, names.UNUSED = 1.0, 1.0
    before = fingerprint(with_globals(listed, names=names))
    names.UNUSED = 2.0
    assert fingerprint(with_globals(listed, names=names)) == before
    names.LIMIT = 2.0
    assert fingerprint(with_globals(listed, names=names)) != before


def test_a_function_that_calls_itself_has_a_digest():
    assert fingerprint(recursive) == fingerprint(recursive) != fingerprint(with_globals(recursive, OFFSET=1))
