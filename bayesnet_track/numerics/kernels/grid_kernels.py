"""Compiled kernels of grids: spread the mass of each line by a short kernel of its own."""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.compiled import compiled

STRIP = 256
"""Cells that are turned at a time."""


@compiled
def spread_columns(mass: Floats, taps: Floats, first: Ints, out: Floats) -> None:
    """Add to `out` (A, B, Y, X') the lines along X of `mass` (A, B, Y, X), each spread by its kernel.

    The kernel of B is `taps[b]` (T,); its first tap takes column 0 to column `first[b]`, all inside `out`.
    """
    a_size, b_size, rows, columns = mass.shape
    for a in range(a_size):
        for b in range(b_size):
            for y in range(rows):
                line = mass[a, b, y]
                for t in range(taps.shape[1]):
                    weight, low = taps[b, t], first[b] + t
                    to = out[a, b, y, low : low + columns]
                    for x in range(columns):
                        to[x] += weight * line[x]


@compiled
def spread_rows(mass: Floats, taps: Floats, first: Ints, out: Floats) -> None:
    """Spread mass along Y: add to `out` (A, B, Y', X), with the kernel `taps[a]` of A."""
    a_size, b_size, rows, columns = mass.shape
    for a in range(a_size):
        for b in range(b_size):
            for y in range(rows):
                line = mass[a, b, y]
                for t in range(taps.shape[1]):
                    weight = taps[a, t]
                    to = out[a, b, first[a] + t + y]
                    for x in range(columns):
                        to[x] += weight * line[x]


@compiled
def turn(mass: Floats, down: Floats, across: Floats, out: Floats) -> None:
    """Fill `out` (A, B, P) with sum down[a, c] across[b, d] mass[c, d, p]; strips of P stay in the cache."""
    a_size, b_size, places = mass.shape
    strip = np.empty((a_size, b_size, STRIP))
    for low in range(0, places, STRIP):
        count = min(STRIP, places - low)
        for c in range(a_size):
            for b in range(b_size):
                line = strip[c, b]
                line[:] = 0.0
                for d in range(b_size):
                    weight, known = across[b, d], mass[c, d, low : low + count]
                    for p in range(count):
                        line[p] += weight * known[p]
        for a in range(a_size):
            for b in range(b_size):
                to = out[a, b, low : low + count]
                to[:] = 0.0
                for c in range(a_size):
                    weight, line = down[a, c], strip[c, b]
                    for p in range(count):
                        to[p] += weight * line[p]
