"""Scores of several targets by class, such as people and cars."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from bayesnet_track.evaluate.gospa import CUTOFF_PX
from bayesnet_track.evaluate.mot import MotScore, score_mot
from bayesnet_track.evaluate.mot_pairs import EPSILON, Tracks, assign
from bayesnet_track.numerics.boxes import centre_from_corner, overlap

MATCHED_IOU = 0.5
COLUMNS = ("true_ids", "true_boxes", "mota", "idf1", "hota", "fp", "fn", "idsw")
"""Of the table."""


def class_names(tracks: Tracks) -> list[str]:
    """The classes of boxes, numbers in their order, then names; none where boxes have none."""
    if tracks.classes is None:
        return []
    names = [str(one) for one in np.unique(tracks.classes) if one]
    return sorted(names, key=lambda name: (not name.isdigit(), int(name) if name.isdigit() else 0, name))


def of_classes(truth: Tracks, tracks: Tracks, classes: Collection[str]) -> tuple[Tracks, Tracks]:
    """The true and the tracked boxes of some classes.

    Tracked boxes without classes, or with none of the ground truth's, are those of all but the ones that
    match a true box of another class in their frame (IoU 0.5 or more): those are neither right nor false.

    Raises:
        ValueError: the ground truth has no classes, or not one of these.
    """
    present = class_names(truth)
    missing = [name for name in classes if name not in present]
    if missing or truth.classes is None:
        allowed = f"it has {', '.join(present)}" if present else "its boxes have no class"
        raise ValueError(f"class {missing[0] if missing else ''!r} is not in the ground truth; {allowed}")
    mine = np.isin(truth.classes, list(classes))
    if tracks.classes is not None and set(class_names(tracks)) & set(present):
        return truth.only(mine), tracks.only(np.isin(tracks.classes, list(classes)))
    return truth.only(mine), tracks.only(~_on_others(truth, mine, tracks))


def _on_others(truth: Tracks, mine: np.ndarray, tracks: Tracks) -> np.ndarray:
    """(N,) whether tracked boxes match true ones without `mine`."""
    found = np.zeros(len(tracks), dtype=np.bool_)
    centres, tracked = centre_from_corner(truth.boxes), centre_from_corner(tracks.boxes)
    for frame in np.intersect1d(truth.frames[~mine], tracks.frames):
        rows, columns = np.flatnonzero(truth.frames == frame), np.flatnonzero(tracks.frames == frame)
        iou = overlap(centres[rows][:, None], tracked[columns][None])
        reached = np.where(iou >= MATCHED_IOU - EPSILON, iou, 0.0)
        for i, j in zip(*assign(reached), strict=True):
            found[columns[j]] = reached[i, j] > 0 and not mine[rows[i]]
    return found


def score_classes(
    truth: Tracks,
    tracks: Tracks,
    classes: Collection[str] = (),
    cutoff_px: float = CUTOFF_PX,
    trajectories: bool = False,
) -> dict[str, MotScore]:
    """Scores of each class by itself, of all in the ground truth where none are named; see `of_classes`.

    Raises:
        ValueError: as `of_classes` and `score_mot`.
    """
    return {
        name: score_mot(*of_classes(truth, tracks, [name]), cutoff_px, trajectories)
        for name in classes or class_names(truth)
    }


def class_table(scores: Mapping[str, MotScore]) -> str:
    """A line for each class, under a line of names."""
    width = max(len(name) for name in (*scores, "class"))
    lines = [f"{'class':<{width}} " + " ".join(f"{name:>10}" for name in COLUMNS)]
    for name, one in scores.items():
        values = [getattr(one, column) for column in COLUMNS]
        shown = [f"{value:>10}" if isinstance(value, int) else f"{value:>10.4f}" for value in values]
        lines.append(f"{name:<{width}} " + " ".join(shown))
    return "\n".join(lines)
