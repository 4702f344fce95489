"""Which boxes of an input can be used: the one rule for files, scores, imports and `update`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.sources.entrances.notices import few

LARGEST_PX = 1e9
"""Beyond it differences of coordinates lose parts of a pixel."""


def usable(boxes: Floats) -> NDArray[np.bool_]:
    """(N,) True where a corner box left, top, width, height (N, 4) in px is finite and has an area.

    >>> usable(np.array([[1, 2, 3, 4], [1, 2, 0, 4], [np.nan, 2, 3, 4], [1, 2, 3, np.inf]])).tolist()
    [True, False, False, False]
    """
    with np.errstate(invalid="ignore"):
        finite = (np.abs(boxes) <= LARGEST_PX).all(axis=1)
        return np.asarray(finite & (boxes[:, 2:] > 0).all(axis=1), dtype=np.bool_)


def describe_unusable(total: int, places: Sequence[object], place: str = "line") -> str:
    """A sentence about the boxes at `places`, of `total`, that are left out.

    >>> describe_unusable(120, [4, 17])
    '2 of 120 boxes are not finite or have no area and are left out: line 4, 17'
    """
    verbs = (
        "is not finite or has no area and is"
        if len(places) == 1
        else "are not finite or have no area and are"
    )
    boxes = "box" if total == 1 else "boxes"
    return f"{len(places)} of {total} {boxes} {verbs} left out: {place} {few(places)}"
