"""Compiled kernels that judge the rows of a table, and those over the detections that targets had."""

from __future__ import annotations

import math

import numpy as np

from bayesnet_track.numerics.arrays import Bools, Floats, Ints
from bayesnet_track.numerics.compiled import compiled


@compiled
def extend_streaks(
    counts: Ints, values: Floats, holds: Bools, latest: Floats, keeps: Bools
) -> tuple[Ints, Floats]:
    """Streaks (T, S) with one frame more where it `holds`, else 0; their last values (T, S, F).

    Those that it `keeps` stay as they are.
    """
    rows, streaks, size = values.shape
    extended, histories = counts.copy(), values.copy()
    for t in range(rows):
        for s in range(streaks):
            if keeps[t, s]:
                continue
            extended[t, s] = counts[t, s] + 1 if holds[t, s] else 0
            if holds[t, s]:
                for k in range(size - 1):
                    histories[t, s, k] = values[t, s, k + 1]
                histories[t, s, size - 1] = latest[t, s]
    return extended, histories


@compiled
def count_frames(
    counted: tuple[Ints, Ints, Ints], is_lost: Bools, lost_count: Ints, frame: int
) -> tuple[Ints, Ints, Ints, Bools]:
    """Frames of birth, in which rows are lost and in which they are unseen (T,), with `frame` counted.

    `counted` are those before; a birth of -1 is one of this frame. Also who is known well: new, or neither
    lost nor about to be (`lost_count` frames look so).
    """
    births, lost_frames, unseen_frames = counted[0].copy(), counted[1].copy(), counted[2].copy()
    is_known = np.empty(births.shape[0], np.bool_)
    for t in range(births.shape[0]):
        is_new = births[t] < 0
        is_known[t] = is_new or not (is_lost[t] or lost_count[t] > 0)
        if is_new:
            births[t], unseen_frames[t] = frame, 0
        if is_known[t] or not is_lost[t]:
            lost_frames[t] = 0
        if is_lost[t]:
            lost_frames[t] += 1
        unseen_frames[t] += 1
    return births, lost_frames, unseen_frames, is_known


@compiled
def earlier_rows(observed: Floats, count: int, recent: int, frames: int) -> Floats:
    """(T, 4) the earliest of the detections of the last `frames` frames that there is, else the last.

    NaN stands for none; so it does in what is returned, of those that have the first one only. Of a row of
    `observed` (T, H) the last detection comes first, the number of further ones is in the column `count`, and
    those of the last frames begin in the column `recent`.
    """
    origin = np.empty((observed.shape[0], 4))
    for t in range(observed.shape[0]):
        for k in range(4):
            origin[t, k] = observed[t, k] if observed[t, count] > 0 else np.nan
            for back in range(frames):
                value = observed[t, recent + 4 * back + k]
                if not math.isnan(value):
                    origin[t, k] = value
                    break
    return origin


@compiled
def units_of(ways: Floats) -> Floats:
    """(T, 2) the ways (T, 2) over their lengths, a little longer: 0 stays 0."""
    units = np.empty_like(ways)
    for t in range(ways.shape[0]):
        length = math.sqrt(ways[t, 0] * ways[t, 0] + ways[t, 1] * ways[t, 1]) + 1e-6
        units[t, 0], units[t, 1] = ways[t, 0] / length, ways[t, 1] / length
    return units


@compiled
def cosines_of(heading: Floats, origin: Floats, boxes: Floats) -> Floats:
    """(T, N) cosines between the headings (T, 2) and the ways from (T, 4) to the centres of boxes (N, 4).

    Within -1 and 1, NaN where a heading or an origin is.
    """
    cosines = np.empty((heading.shape[0], boxes.shape[0]))
    for t in range(heading.shape[0]):
        for n in range(boxes.shape[0]):
            x, y = boxes[n, 0] - origin[t, 0], boxes[n, 1] - origin[t, 1]
            length = math.sqrt(x * x + y * y) + 1e-6
            cosine = x / length * heading[t, 0] + y / length * heading[t, 1]
            if cosine > 1.0:  # NaN stays
                cosine = 1.0
            if cosine < -1.0:
                cosine = -1.0
            cosines[t, n] = cosine
    return cosines


@compiled
def weigh_angles(angles: Floats, weights: Floats) -> Floats:
    """(T, N) weight (N,) * (1/2 - angle / pi) of angles (T, N); 0 where they are NaN."""
    weighed = np.zeros(angles.shape)
    for t in range(angles.shape[0]):
        for n in range(angles.shape[1]):
            if not math.isnan(angles[t, n]):
                weighed[t, n] = weights[n] * (0.5 - angles[t, n] / np.pi)
    return weighed


@compiled
def append_detections(
    observed: Floats,
    detections: Floats,
    is_given: Bools,
    recent: int,
    frames: int,
    heading: Floats,
    elapsed: float,
) -> None:
    """Update the memory (T, H) in place after a frame in which rows were given `detections` (T, 4).

    The frame is `elapsed` frame intervals after the last one.

    The detections of the last frames begin in the column `recent`, the direction follows them; that of rows
    whose `heading` (T, 2) is NaN stays.
    """
    newest, turn = recent + 4 * (frames - 1), recent + 4 * frames
    for t in range(observed.shape[0]):
        if frames > 0:
            for k in range(recent, newest):
                observed[t, k] = observed[t, k + 4]
            for k in range(4):
                observed[t, newest + k] = detections[t, k] if is_given[t] else np.nan
            for k in range(2):
                if not math.isnan(heading[t, k]):
                    observed[t, turn + k] = heading[t, k]
        observed[t, 4] += elapsed
        if is_given[t]:
            for k in range(4):
                observed[t, k] = detections[t, k]
            observed[t, 4] = 0.0
            observed[t, 5] += 1.0


@compiled
def overlaps_of(first: Floats, second: Floats) -> Floats:
    """(T, N) as `numerics.boxes.overlap`, of centre boxes (T, 4) and (N, 4)."""
    overlaps = np.zeros((first.shape[0], second.shape[0]))
    for t in range(first.shape[0]):
        for n in range(second.shape[0]):
            shared, area, other_area = 1.0, 1.0, 1.0
            for k in range(2):
                low = max(first[t, k] - first[t, k + 2] / 2, second[n, k] - second[n, k + 2] / 2)
                high = min(first[t, k] + first[t, k + 2] / 2, second[n, k] + second[n, k + 2] / 2)
                shared *= max(high - low, 0.0)
                area *= first[t, k + 2]
                other_area *= second[n, k + 2]
            union = area + other_area - shared
            if union > 0.0:
                overlaps[t, n] = shared / union
    return overlaps
