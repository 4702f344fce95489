"""Compiled kernel for blobs over a grid of at most 64 cells, which are the bits of one word.

All neighbours of all cells of a blob are found by a few shifts, whatever its shape.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.compiled import compiled

MOST_CELLS = 64

# Numba makes a float of a signed and an unsigned integer together: all words are unsigned.
U = np.uint64
ONE, ZERO = U(1), U(0)


@compiled
def _count_bits(word: np.uint64) -> np.int64:
    """How many bits are set: sums of neighbouring bits, pairs, quartets, then of all bytes."""
    word = word - ((word >> U(1)) & U(0x5555555555555555))
    word = (word & U(0x3333333333333333)) + ((word >> U(2)) & U(0x3333333333333333))
    word = (word + (word >> U(4))) & U(0x0F0F0F0F0F0F0F0F)
    return np.int64((word * U(0x0101010101010101)) >> U(56))


@compiled
def grow_in_words(
    hue: NDArray[np.int16],
    boxes: Floats,
    left: int,
    top: int,
    cells: int,
    tolerance: int,
    least: int,
    cosines: Ints,
    sines: Ints,
    blobs: Floats,
    found: Ints,
) -> None:
    """`blob_kernels.grow_blobs`, its arguments and results alike, where ``cells * cells <= MOST_CELLS``."""
    rows, columns = hue.shape
    size = cells * cells
    most = blobs.shape[1]
    column_of = np.empty(cells, np.int64)
    here = np.full(cells + size, -1, np.int32)
    now, left_of, above = here[cells:], here[cells - 1 :], here[:size]
    across, down = np.empty(size, np.int64), np.empty(size, np.int64)
    cosine, sine = np.empty(size, np.int64), np.empty(size, np.int64)
    place = np.empty(size, np.uint64)
    first_column = ZERO
    for k in range(size):
        across[k], down[k] = k % cells, k // cells
        place[k] = ONE << U(k)
        if k % cells == 0:
            first_column |= place[k]
    masks, counts = np.empty(most + 1, np.uint64), np.empty(most + 1, np.int64)
    row_step = U(cells)
    for n in range(boxes.shape[0]):
        for i in range(cells):
            share = (i + 0.5) / cells - 0.5
            column_of[i] = math.floor(boxes[n, 0] + share * boxes[n, 2] + 0.5) - left
        at = cells
        for j in range(cells):
            share = (j + 0.5) / cells - 0.5
            row = math.floor(boxes[n, 1] + share * boxes[n, 3] + 0.5) - top
            for i in range(cells):
                column = column_of[i]
                inside = 0 <= row < rows and 0 <= column < columns
                here[at] = hue[row, column] if inside else -1
                at += 1
        colored, beside, below = ZERO, ZERO, ZERO
        for k in range(size):
            apart = (now[k] - left_of[k]) & 255
            joined = (min(apart, 256 - apart) <= tolerance) & ((now[k] | left_of[k]) >= 0)
            beside |= place[k] if joined else ZERO
            apart = (now[k] - above[k]) & 255
            joined = (min(apart, 256 - apart) <= tolerance) & ((now[k] | above[k]) >= 0)
            below |= place[k] if joined else ZERO
            colored |= place[k] if now[k] >= 0 else ZERO
        beside &= ~first_column
        kept = 0
        left_over = _count_bits(colored)
        while left_over >= least:
            blob = colored & (~colored + ONE)  # the first cell that is left
            before = ZERO
            while blob != before:  # one cell further in each direction
                before = blob
                blob |= ((blob << ONE) & beside) | ((blob & beside) >> ONE)
                blob |= ((blob << row_step) & below) | ((blob & below) >> row_step)
            colored &= ~blob
            count = _count_bits(blob)
            left_over -= count
            if count < least or (kept == most and count <= counts[most - 1]):
                continue
            kept = min(kept + 1, most)
            to = kept - 1
            while to > 0 and counts[to - 1] < count:
                masks[to], counts[to] = masks[to - 1], counts[to - 1]
                to -= 1
            masks[to], counts[to] = blob, count
        if kept > 0:
            for k in range(size):
                cosine[k], sine[k] = cosines[now[k]], sines[now[k]]
        for b in range(kept):
            blob, count = masks[b], counts[b]
            sum_x, sum_y, sum_cosine, sum_sine = 0, 0, 0, 0
            for k in range(size):
                own = -np.int64((blob >> U(k)) & ONE)
                sum_x += across[k] & own
                sum_y += down[k] & own
                sum_cosine += cosine[k] & own
                sum_sine += sine[k] & own
            blobs[n, b, 0] = (sum_x / count + 0.5) / cells - 0.5
            blobs[n, b, 1] = (sum_y / count + 0.5) / cells - 0.5
            blobs[n, b, 2] = math.degrees(math.atan2(sum_sine, sum_cosine)) % 360.0
            blobs[n, b, 3] = count / size
        found[n] = kept
