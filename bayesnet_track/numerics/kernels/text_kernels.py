"""Compiled kernel: lists of whole numbers as text."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Ints
from bayesnet_track.numerics.compiled import compiled

MOST_BYTES = 22
"""Of a number: a sign, 19 digits, a comma and a space."""

_ZERO, _MINUS, _COMMA, _SPACE, _OPEN, _CLOSE = (ord(character) for character in "0-, []")


def texts_of(lists: Ints) -> list[str]:
    """Each of the lists (T, N, K) as JSON has it.

    >>> texts_of(np.array([[[1, -2], [30, 4]]]))
    ['[[1, -2], [30, 4]]']
    """
    count, rows, columns = lists.shape
    buffer = np.empty(count * (rows * (columns * MOST_BYTES + 4) + 2), np.uint8)
    ends = _write(np.ascontiguousarray(lists), buffer)
    text = buffer[: ends[-1]].tobytes().decode("ascii")
    return [text[first:end] for first, end in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True)]


@compiled
def _write(lists: Ints, buffer: NDArray[np.uint8]) -> Ints:
    """Fill in the texts one after the other; (T + 1,) where each begins and the last one ends."""
    ends, cursor = np.zeros(lists.shape[0] + 1, np.int64), 0
    for t in range(lists.shape[0]):
        buffer[cursor] = _OPEN
        cursor += 1
        for n in range(lists.shape[1]):
            buffer[cursor] = _OPEN
            cursor += 1
            for k in range(lists.shape[2]):
                value = lists[t, n, k]
                if value < 0:
                    buffer[cursor], value = _MINUS, -value
                    cursor += 1
                digits, limit = 1, value // 10
                while limit > 0:
                    digits, limit = digits + 1, limit // 10
                for place in range(cursor + digits - 1, cursor - 1, -1):
                    buffer[place], value = _ZERO + value % 10, value // 10
                cursor += digits
                buffer[cursor], buffer[cursor + 1] = _COMMA, _SPACE
                cursor += 2
            buffer[cursor - 2], buffer[cursor - 1], buffer[cursor] = _CLOSE, _COMMA, _SPACE
            cursor += 1
        buffer[cursor - 2] = _CLOSE
        cursor -= 1
        ends[t + 1] = cursor
    return ends
