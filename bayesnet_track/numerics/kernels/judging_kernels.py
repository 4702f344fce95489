"""Compiled kernels that judge the rows of a table after a look, as `adapt.status` judges one target."""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Bools, Floats, Ints
from bayesnet_track.numerics.compiled import compiled


@compiled
def read_levels(
    ud: Floats, fit: Floats, scale: Floats, level: float, fit_below: float
) -> tuple[Floats, Floats, Floats, Bools, Bools]:
    """UD in the unit `scale` (T,); that of rows that look lost; their fits; who looks lost, and who found.

    A scale that is not above 0, or NaN, is unknown: no UD is too high then.
    """
    count = ud.shape[0]
    values, lost_values, unfit_values = np.empty(count), np.empty(count), np.empty(count)
    looks_lost, looks_found = np.empty(count, np.bool_), np.empty(count, np.bool_)
    for t in range(count):
        value = ud[t] / scale[t] if scale[t] > 0.0 else 0.0
        is_wide, fits = scale[t] > 0.0 and value > level, fit[t] >= fit_below
        values[t] = value
        lost_values[t] = value if fits else np.inf
        unfit_values[t] = -np.inf if is_wide else fit[t]
        looks_lost[t], looks_found[t] = is_wide or not fits, fits and not is_wide
    return values, lost_values, unfit_values, looks_lost, looks_found


@compiled
def append_streaks(
    counts: Ints, values: Floats, others: Floats, holds: Bools, new: Floats, new_others: Floats
) -> tuple[Ints, Floats, Floats]:
    """Streaks (T,) with one frame more where it `holds`, else 0; their last values (T, F), from the right.

    There are two values of each frame.
    """
    rows, size = values.shape
    after, last, last_others = np.zeros(rows, np.int64), np.empty((rows, size)), np.empty((rows, size))
    for t in range(rows):
        if holds[t]:
            after[t] = counts[t] + 1
        for k in range(size - 1):
            last[t, k], last_others[t, k] = values[t, k + 1], others[t, k + 1]
        last[t, size - 1], last_others[t, size - 1] = new[t], new_others[t]
    return after, last, last_others


@compiled
def count_frames(
    counted: tuple[Ints, Ints, Ints], is_lost: Bools, lost_count: Ints, frame: int
) -> tuple[Ints, Ints, Ints, Bools]:
    """Frames of birth, in which rows are lost and in which they are unseen (T,), with `frame` counted.

    `counted` are those before; a birth of -1 is one of this frame. Also who is known well: new, or neither
    lost nor about to be (`lost_count` frames look so).
    """
    since, lost_frames, unseen_frames = counted[0].copy(), counted[1].copy(), counted[2].copy()
    known = np.empty(since.shape[0], np.bool_)
    for t in range(since.shape[0]):
        is_new = since[t] < 0
        known[t] = is_new or not (is_lost[t] or lost_count[t] > 0)
        if is_new:
            since[t], unseen_frames[t] = frame, 0
        if known[t] or not is_lost[t]:
            lost_frames[t] = 0
        if is_lost[t]:
            lost_frames[t] += 1
        unseen_frames[t] += 1
    return since, lost_frames, unseen_frames, known
