"""True and tracked boxes of several targets: from files, and paired frame by frame."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.evaluate.truth import IGNORED, TruthForm
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.boxes import centre_from_corner, overlap
from bayesnet_track.sources.entrances.boxes import explain_lengths, refuse_shares
from bayesnet_track.sources.entrances.notices import notice
from bayesnet_track.sources.mot_lines import MotLines, parse_mot, read_text

EPSILON = float(np.finfo(np.float64).eps)
"""What an overlap may lack of a threshold: equal ones count as reaching it."""


@dataclass(frozen=True, eq=False)
class Tracks:
    """Boxes of several targets, in any order; no identity twice in a frame.

    Attributes:
        frames: (N,) indices of frames, from 0.
        ids: (N,) whole numbers; which target each box is of.
        boxes: (N, 4) corner boxes left, top, width, height in px.
        classes: (N,) names of classes, empty where there is none; None if no box has one.
    """

    frames: Ints
    ids: Ints
    boxes: Floats
    classes: NDArray[np.str_] | None = None

    def __len__(self) -> int:
        return len(self.frames)

    def only(self, keep: NDArray[np.bool_]) -> Tracks:
        """The boxes with `keep` (N,)."""
        classes = None if self.classes is None else self.classes[keep]
        return Tracks(self.frames[keep], self.ids[keep], self.boxes[keep], classes)


@dataclass(frozen=True, eq=False)
class FramePairs:
    """All pairs of a true and a tracked box in one frame.

    Attributes:
        index: number of the frame, from 0.
        true: (G,) numbers of the true targets, from 0 without gaps over the sequence.
        tracked: (K,) the same of the tracks.
        iou: (G, K) intersection over union.
        distance: (G, K) Euclidean distance of the box centres in px.
    """

    index: int
    true: Ints
    tracked: Ints
    iou: Floats
    distance: Floats


@dataclass(frozen=True, eq=False)
class Pairs:
    """All pairs of a sequence.

    Attributes:
        frames: of each frame with a box, in order.
        true_boxes: how many boxes each true target has.
        tracked_boxes: the same of each track.
    """

    frames: tuple[FramePairs, ...]
    true_boxes: Ints
    tracked_boxes: Ints

    @property
    def length(self) -> int:
        """Number of frames up to the last that has a box, those without boxes included."""
        return 1 + self.frames[-1].index if self.frames else 0


def pair(truth: Tracks, tracks: Tracks) -> Pairs:
    """Every true box beside every tracked box of its frame; of identities only equality matters."""
    (true, true_boxes), (tracked, tracked_boxes) = _number(truth.ids), _number(tracks.ids)
    centres, tracked_centres = centre_from_corner(truth.boxes), centre_from_corner(tracks.boxes)
    rows, tracked_rows = _rows_of_frames(truth.frames), _rows_of_frames(tracks.frames)
    nothing = np.empty(0, dtype=np.int64)
    frames = []
    for frame in sorted(rows.keys() | tracked_rows.keys()):
        i, j = rows.get(frame, nothing), tracked_rows.get(frame, nothing)
        a, b = centres[i][:, None], tracked_centres[j][None, :]
        distance = np.hypot(a[..., 0] - b[..., 0], a[..., 1] - b[..., 1])
        frames.append(FramePairs(frame, true[i], tracked[j], overlap(a, b), distance))
    return Pairs(tuple(frames), true_boxes, tracked_boxes)


def assign(gains: Floats) -> tuple[Ints, Ints]:
    """Rows and columns of the one-to-one assignment with the largest sum of gains (G, K)."""
    from scipy.optimize import linear_sum_assignment  # here, because it takes long to import

    rows, columns = linear_sum_assignment(gains, maximize=True)
    return np.asarray(rows, dtype=np.int64), np.asarray(columns, dtype=np.int64)


def _number(ids: Ints) -> tuple[Ints, Ints]:
    _, numbers, counts = np.unique(ids, return_inverse=True, return_counts=True)
    return numbers.astype(np.int64), counts.astype(np.int64)


def _rows_of_frames(frames: Ints) -> dict[int, Ints]:
    order = np.argsort(frames, kind="stable")
    present, starts = np.unique(frames[order], return_index=True)
    return dict(zip(present.tolist(), np.split(order, starts[1:]), strict=True)) if len(frames) else {}


def read_mot_truth(path: str | Path, form: TruthForm | None = None) -> Tracks:
    """The true boxes that are to be scored: all but those of confidence 0 (column 7), which are counted.

    Nothing else is left out, and visibility (column 9) is not looked at; tracks on boxes that are left out
    count as false. This is the protocol of MOT15. If the file has classes, identities are those of a class:
    number 1 of class 1 is another target than number 1 of class 3. With `form` "mot" the lines are MOT,
    whatever else they look like.

    Raises:
        OSError: the file cannot be read.
        ValueError: a malformed line, an identity twice in a frame (says file and line), or nothing to score.
    """
    lines = parse_mot(read_text(path), str(path), is_given=form is not None)
    scored = lines.only(lines.rest[:, 0] != IGNORED)
    if not len(scored):
        left_out = f"; {len(lines)} boxes have confidence 0" if len(lines) else ""
        raise ValueError(f"{path}: no true box to score{left_out}")
    if len(scored) < len(lines):
        notice(
            f"{path}: {len(lines) - len(scored)} of {len(lines)} boxes have confidence 0 and are not scored"
        )
    return _tracks(scored, by_class=True)


def read_mot_tracks(path: str | Path) -> Tracks:
    """The boxes of a tracks file, whatever their confidence; it may be empty.

    An identity may change its class, as a classifier may doubt. Only where it is in a frame twice, in two
    classes, identities are those of a class.

    Raises:
        OSError: the file cannot be read.
        ValueError: a malformed line, or an identity twice in a frame; says file and line.
    """
    lines = parse_mot(read_text(path), str(path))
    pairs = set(zip(lines.frames.tolist(), lines.ids.tolist(), strict=True))
    return _tracks(lines, by_class=len(pairs) < len(lines))


def read_pair(
    tracks_path: str | Path,
    truth_path: str | Path,
    frames: Collection[int] | None = None,
    ran: range | None = None,
    form: TruthForm | None = None,
) -> tuple[Tracks, Tracks]:
    """The true and the tracked boxes of two files; what shows that they do not go together is said.

    Args:
        tracks_path: the tracks.
        truth_path: the ground truth.
        frames: frames that alone count, which are numbered from 0 without gaps; all where None.
        ran: the frames that were tracked in, where that is known.
        form: what the lines of the ground truth hold; by what they look like where None.

    Raises:
        OSError: a file cannot be read.
        ValueError: a malformed file; says file and line.
    """
    truth, tracks = read_mot_truth(truth_path, form), read_mot_tracks(tracks_path)
    if frames is not None:
        return _renumbered(truth, frames), _renumbered(tracks, frames)
    for reason in explain_lengths(truth.frames, tracks.frames, ran):
        notice(f"{truth_path}: {reason}")
    return truth, tracks


def _renumbered(tracks: Tracks, frames: Collection[int]) -> Tracks:
    """Boxes of these frames, numbered from 0 without gaps."""
    places = np.array(sorted(frames), dtype=np.int64)
    scored = tracks.only(np.isin(tracks.frames, places))
    return Tracks(np.searchsorted(places, scored.frames), scored.ids, scored.boxes, scored.classes)


def _tracks(lines: MotLines, by_class: bool) -> Tracks:
    refuse_shares(lines.boxes, lines.name)
    ids, classes = lines.ids, lines.classes if (lines.classes != "").any() else None
    if by_class and classes is not None:
        _, kind = np.unique(classes, return_inverse=True)
        pairs, numbers = np.unique(np.stack([lines.ids, kind]), axis=1, return_inverse=True)
        if len(np.unique(pairs[0])) < pairs.shape[1]:
            ids = numbers.reshape(-1).astype(np.int64)
    first: dict[tuple[int, int], int] = {}
    for row, key in enumerate(zip(lines.frames.tolist(), ids.tolist(), strict=True)):
        if key in first:
            raise ValueError(
                f"{lines.place(row)}: identity {lines.ids[row]} is in frame {key[0] + 1} already, "
                f"in line {lines.numbers[first[key]]}"
            )
        first[key] = row
    return Tracks(lines.frames, ids, lines.boxes, classes)
