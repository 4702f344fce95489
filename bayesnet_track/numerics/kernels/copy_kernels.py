"""Compiled copies from one array into another, element by element.

Numba compiles `to[:] = values` with the text of the error for unequal shapes, which takes seconds.
"""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from bayesnet_track.numerics.compiled import compiled


@compiled
def copy_row(values: NDArray[Any], to: NDArray[Any]) -> None:
    """Fill `to` (N,) with the first N of `values`."""
    for n in range(to.shape[0]):
        to[n] = values[n]


@compiled
def copy_rows(values: NDArray[Any], to: NDArray[Any]) -> None:
    """Fill `to` (N, K) with the first N rows and K columns of `values`."""
    for n in range(to.shape[0]):
        for k in range(to.shape[1]):
            to[n, k] = values[n, k]
