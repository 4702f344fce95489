"""SIAP measures (Votruba et al. 2001), defined as in Stone-Soup: which targets are tracked, and how long."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesnet_track.evaluate.gospa import CUTOFF_PX, check_metric
from bayesnet_track.evaluate.mot_pairs import Pairs
from bayesnet_track.evaluate.siap_associations import NOBODY, Association, associate


@dataclass(frozen=True)
class Siap:
    """SIAP measures of a sequence; shares are 0..1.

    Attributes:
        completeness: share of the true boxes that have an associated tracked box.
        ambiguity: associated tracked boxes for each of these; 1 without any.
        spuriousness: share of the tracked boxes that are not associated; 0 without tracks.
        position_px: mean distance of the associated boxes' centres; 0 without any.
        breaks: changes of the track number per frame tracked, the return of a track included; 0 without any.
        longest: share of the targets' lifetimes during which the track that is on each longest is on it.
    """

    completeness: float
    ambiguity: float
    spuriousness: float
    position_px: float
    breaks: float
    longest: float


def siap(pairs: Pairs, cutoff_px: float = CUTOFF_PX) -> Siap:
    """SIAP measures of a sequence with true boxes; associations as `associate` makes them.

    Raises:
        ValueError: a cut-off of 0 or less.
    """
    check_metric(cutoff_px, order=1.0)
    associations = associate(pairs, cutoff_px)
    followed = associated = 0
    error = 0.0
    for frame in pairs.frames:
        now = [one for one in associations if one.start <= frame.index <= one.end]
        target_of = np.full(len(pairs.tracked_boxes), NOBODY, dtype=np.int64)
        target_of[[one.track for one in now]] = [one.true for one in now]
        on_it = target_of[frame.tracked][None, :] == frame.true[:, None]
        followed += int(on_it.any(axis=1).sum())
        associated += int(on_it.sum())  # a track has one target at most
        error += float(frame.distance[on_it].sum())
    true_boxes, tracked_boxes = int(pairs.true_boxes.sum()), int(pairs.tracked_boxes.sum())
    breaks, longest = _continuity(pairs, associations)
    return Siap(
        completeness=followed / true_boxes,
        ambiguity=associated / followed if followed else 1.0,
        spuriousness=(tracked_boxes - associated) / tracked_boxes if tracked_boxes else 0.0,
        position_px=error / associated if associated else 0.0,
        breaks=breaks,
        longest=longest,
    )


def _continuity(pairs: Pairs, associations: Sequence[Association]) -> tuple[float, float]:
    """Changes of the track per frame tracked, and share of the lifetimes that the longest tracks last.

    Times count from frame to frame, so that two frames in a row last 1.
    """
    frames: dict[int, list[int]] = defaultdict(list)
    for frame in pairs.frames:
        for true in frame.true.tolist():
            frames[true].append(frame.index)
    changes = tracked = longest = lifetimes = 0
    for true, present in frames.items():
        own = [one for one in associations if one.true == true]
        changes += max(_tracks_needed(present, own) - 1, 0)
        tracked += _length_of_union([(one.start, one.end) for one in own])
        longest += max(_times_of_tracks(own).values(), default=0)
        lifetimes += present[-1] - present[0]
    return changes / tracked if tracked else 0.0, longest / lifetimes if lifetimes else 0.0


def _tracks_needed(present: Sequence[int], own: Sequence[Association]) -> int:
    """The fewest associations that cover all frames of a target that are covered at all."""
    needed, covered = 0, -1
    for frame in present:
        ends = [one.end for one in own if one.start <= frame <= one.end]
        if frame > covered and ends:
            needed, covered = needed + 1, max(ends)
    return needed


def _times_of_tracks(own: Sequence[Association]) -> Mapping[int, int]:
    """How long each track is on the target, its associations together."""
    times: dict[int, int] = defaultdict(int)
    for one in own:
        times[one.track] += one.end - one.start
    return times


def _length_of_union(stretches: Iterable[tuple[int, int]]) -> int:
    length, reached = 0, -1
    for start, end in sorted(stretches):
        length += max(end - max(start, reached), 0)
        reached = max(reached, end)
    return length
