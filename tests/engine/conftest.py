"""How two lines of the same frame are compared."""

import math

import pytest


def differing(one, other, rel, abs, path=""):
    """Paths at which two JSON values differ, numbers by more than `rel` of the larger and more than `abs`.

    Equal parts are not opened, and numbers not wrapped in `pytest.approx`: crowds have 100,000 of them.
    """
    if one == other:
        return []
    if isinstance(one, dict) and isinstance(other, dict) and one.keys() == other.keys():
        return [k for key in one for k in differing(one[key], other[key], rel, abs, f"{path}.{key}")]
    if isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        pairs = enumerate(zip(one, other, strict=True))
        return [k for key, (a, b) in pairs for k in differing(a, b, rel, abs, f"{path}.{key}")]
    if isinstance(one, float) and isinstance(other, int | float):
        return [] if math.isclose(one, other, rel_tol=rel, abs_tol=abs) else [path]
    return [path]


@pytest.fixture(scope="session")
def unlike():
    """Paths at which two JSON values differ."""
    return differing
