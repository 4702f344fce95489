"""Signs that boxes of a file are not of this video: they lie outside of its images, or in other frames."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.sources.entrances.line_forms import far_outside

LONG, LONG_SHARE = 10, 0.25
"""Frames without boxes before the first, or after the last one, from which on they are spoken of."""

QUESTION = ": is the file of this video, and of its frame rate?"


def explain_places(boxes: Floats, size: tuple[int, int], what: str) -> Iterator[str]:
    """Sentences about corner boxes (N, 4) far outside of frames of this width and height, px.

    >>> print(*explain_places(np.array([[500.0, 40, 60, 45], [50, 40, 20, 45]]), (120, 90), "true boxes"))
    1 of 2 true boxes lie outside of the frames of 120x90 px: is the file of this video, and of its size?
    """
    frame = f"the frames of {size[0]}x{size[1]} px"
    outside = (boxes[:, :2] >= size).any(axis=1) | (boxes[:, :2] + boxes[:, 2:] <= 0).any(axis=1)
    if outside.any():
        yield (
            f"{outside.sum()} of {len(boxes)} {what} lie outside of {frame}: is the file of this video, and "
            "of its size?"
        )
    yield from explain_corners(boxes, size, what)


def explain_corners(boxes: Floats, size: tuple[int, int], what: str) -> Iterator[str]:
    """A sentence where most boxes begin inside and reach far out, as corners do that are given as sizes."""
    far = far_outside(boxes, size)
    if len(far) and far.mean() > 0.5:
        fits = (boxes[:, 2:] > boxes[:, :2]) & (boxes[:, 2:] <= np.array(size) + 1)
        cause = (
            "they can be corners left,top,right,bottom, which a header line frame,id,x1,y1,x2,y2,.. names"
            if fits.all(axis=1).mean() > 0.9
            else "are they boxes left,top,width,height of this video, and of its size?"
        )
        yield (
            f"{far.sum()} of {len(boxes)} {what} begin inside of the frames of {size[0]}x{size[1]} px and "
            f"reach far beyond them: {cause}"
        )


def explain_lengths(truth: Ints, tracked: Ints, ran: range | None = None) -> Iterator[str]:
    """Sentences about true boxes where nothing was tracked, and tracked ones where nothing is true.

    Args:
        truth: (N,) frames of the true boxes, from 0.
        tracked: (M,) frames of the tracked ones.
        ran: the frames that were tracked in, None where that is not known.

    >>> print(next(explain_lengths(np.arange(60), np.arange(30))).partition(" (")[0])
    30 of 60 true boxes are of frames after the last tracked box
    """
    if not len(truth) or not (len(tracked) or ran):
        return
    last = max(ran[-1] if ran else 0, int(tracked.max(initial=0)))
    later = truth[truth > last]
    if len(later) and (ran or _is_long(int(truth.max()), last)):
        after = "after the last one of the run" if ran else "after the last tracked box"
        yield (
            f"{len(later)} of {len(truth)} true boxes are of frames {after} ({later.min()} to {later.max()}, "
            f"counted from 0), and count as missed{QUESTION}"
        )
    spare = tracked[tracked > truth.max()]
    if len(spare) and _is_long(int(tracked.max()), int(truth.max())):
        yield (
            f"{len(spare)} of {len(tracked)} tracked boxes are of frames after the last true box "
            f"({spare.min()} to {spare.max()}, counted from 0), and count as false{QUESTION}"
        )


def _is_long(last: int, end: int) -> bool:
    return last - end >= max(LONG, LONG_SHARE * (last + 1))
