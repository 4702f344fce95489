"""Boxes of an input: forms of lines of numbers, usable boxes, and signs that boxes are of another video."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.observation.settings import setting
from bayesnet_track.sources.entrances.notices import few

LEAST_LINES = 3
"""With fewer lines nothing is said about how numbers change."""

MOST_LINES = 5000
"""So many lines are looked at."""
LARGEST = 1e100
"""Products and squares of larger numbers overflow; no box or identity has such."""


def is_mot_of_8(rows: Floats, name: str) -> bool:
    """True if lines of 8 numbers (N, 8) are MOT (.., confidence, class), rather than polygons.

    Raises:
        ValueError: they can be both, or neither.
    """
    rows = _moderate(rows)[:MOST_LINES]
    if not len(rows):
        return False
    frames, ids, confidence, number = rows[:, 0], rows[:, 1], rows[:, 6], rows[:, 7]
    is_whole = (rows[:, [0, 1, 7]] % 1 == 0).all() and (frames >= 0).all() and (ids >= -1).all()
    sized = float((rows[:, 4:6] > 0).all(axis=1).mean()) > 0.5
    can_be_mot = bool(is_whole and sized and (number >= -1).all() and _grow(frames, ids))
    highest = 100 if len(rows) >= LEAST_LINES else 1
    can_be_mot = can_be_mot and bool(((confidence >= -1) & (confidence <= highest)).all())
    is_flag = bool((np.abs(confidence) <= 1).all())
    points = rows.reshape(-1, 4, 2)
    convex, rectangles = float(_are_convex(points).mean()) > 0.9, float(_are_rectangles(points).mean()) > 0.9
    if can_be_mot and rectangles and not is_flag:
        return False
    if can_be_mot and (rectangles or (convex and not is_flag)):
        raise ValueError(
            f"{name}: lines of 8 numbers that can be MOT (frame,id,left,top,width,height,confidence,class) "
            "or polygons (x1,y1,..,x4,y4); say which: "
            f"{setting('--truth-format', 'mot or polygons')}, or a header line of these names"
        )
    if not can_be_mot and len(rows) >= LEAST_LINES and float(_are_convex(points).mean()) < 0.5:
        tenths = " or boxes of 4 numbers with decimal commas (write points);" if (rows % 1 == 0).all() else ""
        raise ValueError(
            f"{name}: lines of 8 numbers that are polygons (x1,y1,..,x4,y4) whose sides cross;{tenths} and "
            "no MOT (frame,id,left,top,width,height,confidence,class); say "
            f"{setting('--truth-format', 'polygons or mot')}, or write a header line of names"
        )
    return can_be_mot


def _moderate(rows: Floats) -> Floats:
    """Rows of finite numbers with which one can calculate."""
    return rows[(np.abs(rows) < LARGEST).all(axis=1)]


def _grow(frames: Floats, ids: Floats) -> bool:
    """True if frames never fall, or not within an identity; and no identity but -1 is twice in one."""
    if (np.diff(frames) < 0).any():
        order = np.argsort(ids, kind="stable")
        same = np.diff(ids[order]) == 0
        if (np.diff(frames[order])[same] < 0).any():
            return False
    return len(frames) < LEAST_LINES or bool((np.diff(frames) != 0).any())


def _are_convex(points: Floats) -> NDArray[np.bool_]:
    """(N,) whether the corners (N, 4, 2) go round a convex area."""
    sides = np.roll(points, -1, axis=1) - points
    following = np.roll(sides, -1, axis=1)
    turns = sides[..., 0] * following[..., 1] - sides[..., 1] * following[..., 0]
    area = np.abs(turns).sum(axis=1) > 0
    return np.asarray(area & ((turns >= 0).all(axis=1) | (turns <= 0).all(axis=1)))


def _are_rectangles(points: Floats) -> NDArray[np.bool_]:
    """(N,) whether the diagonals (N, 4, 2) halve each other, to a tenth of their length."""
    first, second = points[:, 2] - points[:, 0], points[:, 3] - points[:, 1]
    distance = np.hypot(*(points[:, 0] + points[:, 2] - points[:, 1] - points[:, 3]).T)
    longest = np.maximum(np.hypot(*first.T), np.hypot(*second.T))
    return np.asarray(_are_convex(points) & (distance <= 0.1 * longest))


def are_polygons(rows: Floats) -> bool:
    """True if lines of 8 numbers (N, 8) are the corners of rectangles, upright or rotated."""
    rows = _moderate(rows)
    return len(rows) >= LEAST_LINES and float(_are_rectangles(rows.reshape(-1, 4, 2)).mean()) > 0.9


def are_corners(boxes: Floats) -> bool:
    """True if boxes (N, 4), read as left, top, width, height, are rather left, top, right, bottom.

    They are if width and height always exceed left and top, and follow them: right - left and bottom - top
    vary much less than right and bottom.

    >>> boxes = np.array([[10.0, 20, 30, 60], [100, 50, 120, 90], [300, 80, 320, 120]])
    >>> are_corners(boxes), are_corners(boxes - [[0, 0, 10, 20], [0, 0, 100, 50], [0, 0, 300, 80]])
    (True, False)
    """
    boxes = _moderate(boxes)[:MOST_LINES]
    if len(boxes) < LEAST_LINES or not ((boxes[:, 2:] > boxes[:, :2]) & (boxes[:, :2] >= 0)).all():
        return False
    as_sizes, as_corners = boxes[:, 2:].var(axis=0).sum(), (boxes[:, 2:] - boxes[:, :2]).var(axis=0).sum()
    return bool(as_corners < as_sizes / 4)


def refuse_corners(boxes: Floats, name: str, mend: str) -> None:
    """Raise ValueError where sizes are rather corners; `mend` says how the user decides."""
    if are_corners(boxes):
        raise ValueError(
            f"{name}: boxes that can be left,top,width,height or corners left,top,right,bottom (the last two "
            f"numbers always exceed the first two, and move with them); say which: {mend}"
        )


def refuse_scores(boxes: Floats, name: str) -> None:
    """Raise ValueError where a score stands in a column of the boxes, as in lines x,y,w,h,score.

    It does where every width, or every height, is from 0 to 1, or every left is and some is no whole number.
    """
    moderate = _moderate(boxes)
    if len(moderate) < LEAST_LINES:
        return
    low = [bool(((values >= 0) & (values <= 1)).all()) for values in moderate.T]
    for column, side in ((2, "width"), (3, "height"), (0, "left")):
        if low[column] and (column or (moderate[:, 0] % 1 != 0).any()):
            raise ValueError(
                f"{name}: every {side} is from 0 to 1: lines can be boxes or scores in another order, "
                "as frame,x,y,w,h,score; write a header line that names the columns, such as "
                "frame,left,top,width,height,confidence"
            )


MOST_SHARE = 1.5
"""Of the frame, for a coordinate of a box that is partly outside of it."""


def refuse_shares(boxes: Floats, name: str) -> None:
    """Raise ValueError where all coordinates are shares of the frame's width and height.

    Those of a target that is partly outside of the frame are below 0 or above 1.
    """
    finite = boxes[np.isfinite(boxes).all(axis=1)]
    if len(finite) and (np.abs(finite) <= MOST_SHARE).all() and (finite % 1 != 0).any():
        raise ValueError(
            f"{name}: all coordinates are about 0 to 1, as shares of a frame's width and height; boxes are "
            "in px: multiply x and width by the frame's width, y and height by its height, or give the "
            "size of the frames in columns: frame,id,xmin,ymin,xmax,ymax,width,height,confidence in a "
            "header line"
        )


def count_up(column: Floats | Ints) -> bool:
    """True if a column (N,) counts lines from 0 or 1.

    >>> count_up(np.array([1.0, 2, 3])), count_up(np.array([1.0, 3, 5]))
    (True, False)
    """
    lines = np.arange(len(column))
    return len(column) >= LEAST_LINES and (bool((column == lines).all()) or bool((column == lines + 1).all()))


def far_outside(boxes: Floats, size: tuple[int, int]) -> NDArray[np.bool_]:
    """(N,) whether boxes (N, 4) begin in frames of this width and height, and end a tenth of it beyond.

    >>> far_outside(np.array([[50.0, 40, 110, 85], [100, 40, 25, 20]]), (120, 90)).tolist()
    [True, False]
    """
    begins_inside = (boxes[:, :2] < size).all(axis=1)
    return np.asarray(begins_inside & (boxes[:, :2] + boxes[:, 2:] > 1.1 * np.array(size)).any(axis=1))


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


LONG, LONG_SHARE = 10, 0.25
"""Frames without boxes before the first, or after the last one, from which on they are spoken of."""

QUESTION = ": is the file of this video, and of its frame rate?"


def explain_places(boxes: Floats, size: tuple[int, int], noun: str) -> Iterator[str]:
    """Sentences about corner boxes (N, 4) far outside of frames of this width and height, px.

    >>> print(*explain_places(np.array([[500.0, 40, 60, 45], [50, 40, 20, 45]]), (120, 90), "true boxes"))
    1 of 2 true boxes lie outside of the frames of 120x90 px: is the file of this video, and of its size?
    """
    frame = f"the frames of {size[0]}x{size[1]} px"
    is_outside = (boxes[:, :2] >= size).any(axis=1) | (boxes[:, :2] + boxes[:, 2:] <= 0).any(axis=1)
    if is_outside.any():
        yield (
            f"{is_outside.sum()} of {len(boxes)} {noun} lie outside of {frame}: is the file of this video, "
            "and of its size?"
        )
    yield from explain_corners(boxes, size, noun)


def explain_corners(boxes: Floats, size: tuple[int, int], noun: str) -> Iterator[str]:
    """A sentence where most boxes begin inside and reach far out, as corners do that are given as sizes."""
    is_far = far_outside(boxes, size)
    if len(is_far) and is_far.mean() > 0.5:
        fits = (boxes[:, 2:] > boxes[:, :2]) & (boxes[:, 2:] <= np.array(size) + 1)
        cause = (
            "they can be corners left,top,right,bottom, which a header line frame,id,x1,y1,x2,y2,.. names"
            if fits.all(axis=1).mean() > 0.9
            else "are they boxes left,top,width,height of this video, and of its size?"
        )
        yield (
            f"{is_far.sum()} of {len(boxes)} {noun} begin inside of the frames of {size[0]}x{size[1]} px and "
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
    final = max(ran[-1] if ran else 0, int(tracked.max(initial=0)))
    later = truth[truth > final]
    if len(later) and (ran or _is_long(int(truth.max()), final)):
        place = "after the last one of the run" if ran else "after the last tracked box"
        yield (
            f"{len(later)} of {len(truth)} true boxes are of frames {place} ({later.min()} to {later.max()}, "
            f"counted from 0), and count as missed{QUESTION}"
        )
    spare = tracked[tracked > truth.max()]
    if len(spare) and _is_long(int(tracked.max()), int(truth.max())):
        yield (
            f"{len(spare)} of {len(tracked)} tracked boxes are of frames after the last true box "
            f"({spare.min()} to {spare.max()}, counted from 0), and count as false{QUESTION}"
        )


def _is_long(final: int, end: int) -> bool:
    return final - end >= max(LONG, LONG_SHARE * (final + 1))
