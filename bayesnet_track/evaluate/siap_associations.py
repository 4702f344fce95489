"""Which target each track is on, and how long: the associations that SIAP measures count."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from bayesnet_track.evaluate.mot_pairs import Pairs

CONFIRM_FRAMES = 3
END_FRAMES = 2
NOBODY = -1


@dataclass(frozen=True)
class Association:
    """A track on a target over a stretch of frames.

    Attributes:
        true: number of the target.
        track: number of the track.
        start: first frame in which the target is the nearest one.
        end: last such frame, included.
    """

    true: int
    track: int
    start: int
    end: int


def associate(pairs: Pairs, cutoff_px: float) -> list[Association]:
    """Associations of a sequence: those of a track do not overlap, a target may have several at once.

    A track is on the target that is nearest to it, nearer than the cut-off, for `CONFIRM_FRAMES` of its boxes
    in a row, from the first of them on. It stays there until another target, or none, has been the nearest
    for `END_FRAMES` of its boxes in a row; the association ends with the last box before these.
    """
    nearest: list[list[tuple[int, int]]] = [[] for _ in pairs.tracked_boxes]
    for frame in pairs.frames:
        if not len(frame.true):
            for track in frame.tracked.tolist():
                nearest[track].append((frame.index, NOBODY))
            continue
        closest, least = frame.distance.argmin(axis=0), frame.distance.min(axis=0)
        for track, row, distance in zip(frame.tracked.tolist(), closest, least, strict=True):
            nearest[track].append((frame.index, int(frame.true[row]) if distance < cutoff_px else NOBODY))
    return [
        Association(true, track, start, end)
        for track, boxes in enumerate(nearest)
        for true, start, end in _stretches(boxes)
    ]


def _stretches(boxes: Sequence[tuple[int, int]]) -> Iterator[tuple[int, int, int]]:
    """Target, first and last frame of each association, from the frames and nearest targets of a track."""
    current = candidate = NOBODY
    start = end = since = in_a_row = missed = 0
    for frame, near in boxes:
        if current != NOBODY and near == current:
            end, missed, candidate = frame, 0, NOBODY
            continue
        if near != candidate:
            candidate, since, in_a_row = near, frame, 0
        in_a_row += 1
        missed += 1
        if current != NOBODY and missed >= END_FRAMES:
            yield current, start, end
            current = NOBODY
        if current == NOBODY and candidate != NOBODY and in_a_row >= CONFIRM_FRAMES:
            current, start, end, missed, candidate = candidate, since, frame, 0, NOBODY
    if current != NOBODY:
        yield current, start, end
