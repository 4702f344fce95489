"""Ground-truth files, and the true and tracked boxes of several targets paired frame by frame."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.evaluate.paired_boxes import BoxPairs, assign_gains, pair_boxes
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.boxes import CornerBox
from bayesnet_track.observation.settings import setting, to_caller
from bayesnet_track.sources.entrances.boxes import (
    count_up,
    explain_lengths,
    is_mot_of_8,
    refuse_corners,
    refuse_scores,
    refuse_shares,
)
from bayesnet_track.sources.entrances.notices import few, notice
from bayesnet_track.sources.entrances.text_lines import TextLines, explain_word, is_number, split_lines
from bayesnet_track.sources.mot_blocks import (
    CORNERS,
    is_kitti,
    layout_of,
    plain_name,
    read_plain_boxes,
    starts_plain,
)
from bayesnet_track.sources.mot_lines import LARGEST_FRAME, MotLines, parse_mot, read_text

TruthForm = Literal["mot", "boxes", "corners", "centers", "polygons"]
"""What a line holds: MOT, x,y,w,h, left,top,right,bottom, the centre,w,h, or the corners of a polygon."""

FORMS: tuple[TruthForm, ...] = get_args(TruthForm)
EXPECTED = "expected 4 (x,y,w,h) or 8 (a polygon), 5 (frame,x,y,w,h), or MOT lines"
IGNORED = 0.0
"""The confidence of a true box that says: not to be scored."""


def read_truth(path: str | Path, form: TruthForm | None = None) -> Floats:
    """(n, 4) corner boxes x, y, w, h in px, row i for frame i; values are taken as they stand in the file.

    Numbers are separated by commas, semicolons, tabs or spaces. Lines of 8 numbers are polygons (x1, y1, ..
    x4, y4), reduced to their axis-aligned bounding box, or MOT: what they hold decides, or `form`. MOT of
    one target, `frame,x,y,w,h`, and a header line that names the columns are read, too. A row is all NaN
    where the target is absent: a value that is not finite, a width or height of 0 or less, no line in a file
    with frames, or a confidence of 0 in MOT.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is not text, a line is not of these forms, the lines can be read in two ways, or the
            file holds no line, or several targets; says file and line.
    """
    return parse_truth(read_text(path), str(path), form)


def parse_truth(text: str, name: str = "<truth>", form: TruthForm | None = None) -> Floats:
    """`read_truth` of a text; `name` stands in error messages.

    >>> parse_truth("1,2,3,4\\nNaN,NaN,NaN,NaN").tolist()
    [[1.0, 2.0, 3.0, 4.0], [nan, nan, nan, nan]]
    """
    lines = split_lines(text, name)
    if form == "mot" or (form is None and has_frames_and_ids(lines)):
        return _of_one_target(parse_mot(text, name, is_given=form is not None))
    if lines.header is not None:
        form = _form_of_header(lines)
        if form is None:
            return _of_one_target(parse_mot(text, name))
    rows = _rows(lines)
    if not rows:
        raise ValueError(f"{name}: no boxes; expected one x,y,w,h per line")
    boxes = _framed(rows, lines, form) if len(rows[0]) == 5 else np.array([_box(row, form) for row in rows])
    if form is None:
        _refuse_other_readings(boxes, rows, name)
    absent = ~np.isfinite(boxes).all(axis=1) | (boxes[:, 2:] <= 0).any(axis=1)
    boxes[absent] = np.nan
    return boxes


def start_box(path: str | Path, frame: int, form: TruthForm | None = None) -> CornerBox:
    """The corner box that a ground-truth file has for a frame, by its index from 0.

    Raises:
        OSError, ValueError: as `read_truth`, or there is no box for this frame.
    """
    boxes = read_truth(path, form)
    if frame >= len(boxes):
        raise ValueError(f"{path}: no box for frame {frame}; it has boxes for frames 0 to {len(boxes) - 1}")
    x, y, w, h = (float(value) for value in boxes[frame])
    if math.isnan(x):
        another = to_caller("choose another --start", "choose another frame")
        raise ValueError(f"{path}: the target is absent in frame {frame}; {another}")
    return x, y, w, h


def is_mot(path: str | Path, form: TruthForm | None = None) -> bool:
    """True for a file with frames and identities: MOT lines or a header that names both; `form` decides.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is not text, or can be MOT as well as something else.
    """
    if form is not None:
        return form == "mot"
    return starts_plain(path) or has_frames_and_ids(split_lines(read_text(path), str(path)))


def has_frames_and_ids(lines: TextLines) -> bool:
    """True if lines are those of several targets; by the first one, or by all if they have 8 numbers.

    Raises:
        ValueError: they can be MOT as well as polygons.
    """
    if lines.header is not None:
        names = {plain_name(word) for word in lines.header[1]}
        if names >= set(CORNERS):
            return False
        columns = layout_of(lines.header, lines.name).columns
        return "id" in columns and bool(columns.keys() & {"frame", "index"})
    number, first = next(iter(lines), (0, []))
    if len(first) != 8:
        return len(first) in (6, 7, 9, 10) or is_kitti(first)
    if any(len(words) != 8 for _, words in lines):
        return any(len(words) in (6, 7, 9, 10) for _, words in lines)
    return is_mot_of_8(np.array(_rows(lines, number)), lines.name)


def _form_of_header(lines: TextLines) -> TruthForm | None:
    """Form of the lines under a header of boxes; None where it names frames."""
    assert lines.header is not None
    number, words = lines.header
    names = tuple(plain_name(word) for word in words)
    if names == CORNERS:
        return "polygons"
    layout = layout_of(lines.header, lines.name)
    columns = layout.columns
    if columns.keys() & {"frame", "index"}:
        return None
    sides = ("right", "bottom") if layout.has_corners else ("width", "height")
    places = ("center_x", "center_y") if layout.has_centers else ("left", "top")
    if [columns.get(name) for name in (*places, *sides)] != [0, 1, 2, 3] or len(words) != 4:
        raise ValueError(
            f"{lines.name}:{number}: a header line of boxes without frames; expected x,y,w,h, x1,y1,x2,y2, "
            f"x_center,y_center,w,h, {','.join(CORNERS)}, or the names of MOT columns"
        )
    return "corners" if layout.has_corners else "centers" if layout.has_centers else "boxes"


def _rows(lines: TextLines, first: int | None = None) -> list[list[float]]:
    """The numbers of every line, 4, 5 or 8; an empty line between others is refused."""
    rows: list[list[float]] = []
    following, is_plain = (lines.first if first is None else first), lines.is_plain
    for number, words in lines:
        if number != following and first is None:
            raise ValueError(f"{lines.name}:{following}: 0 numbers; {EXPECTED}")
        following = number + 1
        try:
            row = [float(word) for word in words]
        except ValueError:
            raise explain_word(words, f"{lines.name}:{number}", "x,y,w,h") from None
        if not is_plain and not all(map(is_number, words)):
            raise explain_word(words, f"{lines.name}:{number}", "x,y,w,h")
        if len(row) not in (4, 5, 8) or (rows and (len(row) == 5) != (len(rows[0]) == 5)):
            raise ValueError(f"{lines.name}:{number}: {len(row)} numbers; {EXPECTED}")
        rows.append(row)
    return rows


def _box(row: list[float], form: TruthForm | None) -> list[float]:
    if len(row) == 8:
        if not all(map(math.isfinite, row)):
            return [math.nan] * 4  # `min` and `max` would pass over a NaN that is not the first
        xs, ys = row[0::2], row[1::2]
        return [min(xs), min(ys), max(xs) - min(xs), max(ys) - min(ys)]
    if form == "corners":
        return [row[0], row[1], row[2] - row[0], row[3] - row[1]]
    if form == "centers":
        return [row[0] - row[2] / 2, row[1] - row[3] / 2, row[2], row[3]]
    return row


def _framed(rows: list[list[float]], lines: TextLines, form: TruthForm | None) -> Floats:
    """Boxes at the places that the first of their 5 numbers gives, from 1."""
    frames = np.array([row[0] for row in rows])
    for number, frame, previous in zip(
        range(lines.first, lines.first + len(rows)), frames, [0.0, *frames[:-1]], strict=True
    ):
        if not (frame % 1 == 0 and previous < frame <= LARGEST_FRAME):
            raise ValueError(
                f"{lines.name}:{number}: 5 numbers, the first {frame:g}; expected frame,x,y,w,h with frames "
                "from 1 that grow, or 4 numbers (x,y,w,h); another order needs a header line of names"
            )
    boxes = np.full((int(frames[-1]), 4), np.nan)
    boxes[frames.astype(np.int64) - 1] = [_box(row[1:], form) for row in rows]
    return boxes


def _refuse_other_readings(boxes: Floats, rows: list[list[float]], name: str) -> None:
    refuse_shares(boxes, name)
    if len(rows[0]) == 5:
        refuse_scores(boxes, name)
    if all(len(row) == 8 for row in rows):
        return
    first = np.array([row[:2] for row in rows])
    if len(rows[0]) == 4 and count_up(first[:, 0]) and (first[:, 1] % 1 == 0).all():
        raise ValueError(
            f"{name}: lines of 4 numbers of which the first counts up: boxes x,y,w,h of a target that moves "
            f"1 px a frame, or frame numbers; say which: {setting('--truth-format', 'boxes')}, or a header "
            "line x,y,w,h or frame,x,y,w,h"
        )
    refuse_corners(
        boxes,
        name,
        f"{setting('--truth-format', 'boxes or corners')}, or a header line x,y,w,h or x1,y1,x2,y2",
    )


def _of_one_target(lines: MotLines) -> Floats:
    """(n, 4) the boxes of the only target by frame."""
    scored = lines.only(lines.rest[:, 0] != IGNORED)
    if len(scored) < len(lines):
        notice(f"{lines.name}: {len(lines) - len(scored)} of {len(lines)} boxes have confidence 0: not used")
    if not len(scored):
        raise ValueError(f"{lines.name}: no boxes; expected one a line")
    targets = sorted(set(zip(scored.classes.tolist(), scored.ids.tolist(), strict=True)))
    if len(targets) > 1:
        names = [f"{number} of class {kind}" if kind else f"{number}" for kind, number in targets]
        raise ValueError(
            f"{lines.name}: boxes of {len(targets)} targets ({few(names)}); expected those of one"
        )
    last_frame = int(scored.frames.max())
    if last_frame > LARGEST_FRAME:
        raise ValueError(f"{lines.name}: frame {last_frame + 1}; expected one up to {LARGEST_FRAME}")
    frames_present, counts = np.unique(scored.frames, return_counts=True)
    if (counts > 1).any():
        row = int(np.flatnonzero(scored.frames == frames_present[counts > 1][0])[1])
        raise ValueError(f"{scored.place(row)}: a second box in frame {int(scored.frames[row]) + 1}")
    boxes = np.full((last_frame + 1, 4), np.nan)
    boxes[scored.frames] = scored.boxes
    return boxes


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


def class_names(tracks: Tracks) -> list[str]:
    """The classes of boxes, numbers in their order, then names; none where boxes have none."""
    if tracks.classes is None:
        return []
    names = [str(name) for name in np.unique(tracks.classes) if name]
    return sorted(names, key=lambda name: (not name.isdigit(), int(name) if name.isdigit() else 0, name))


def pair(truth: Tracks, tracks: Tracks) -> BoxPairs:
    """Every true box beside every tracked box of its frame; of identities only equality matters."""
    true, tracked = ((side.frames, side.ids, side.boxes) for side in (truth, tracks))
    return pair_boxes(true, tracked)


def assign_rows(gains: Floats) -> tuple[Ints, Ints]:
    """Rows and columns of the one-to-one assignment with the largest sum of gains (G, K), none below 0.

    Pairs without a gain are left out.
    """
    rows, columns = np.nonzero(gains)
    places = assign_gains(rows, columns, gains[rows, columns])
    return rows[places], columns[places]


MATCHED_IOU = 0.5
"""Overlap from which on a tracked box is on the true one of another class."""


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
        class_text = f"it has {', '.join(present)}" if present else "its boxes have no class"
        raise ValueError(f"class {missing[0] if missing else ''!r} is not in the ground truth; {class_text}")
    mine = np.isin(truth.classes, list(classes))
    if tracks.classes is not None and set(class_names(tracks)) & set(present):
        return truth.only(mine), tracks.only(np.isin(tracks.classes, list(classes)))
    return truth.only(mine), tracks.only(~_on_others(truth, mine, tracks))


def _on_others(truth: Tracks, mine: np.ndarray, tracks: Tracks) -> np.ndarray:
    """(N,) whether tracked boxes match true ones without `mine`."""
    on_other = np.zeros(len(tracks), dtype=np.bool_)
    true, tracked = (
        (side.frames, np.arange(len(side)), side.boxes) for side in (truth, tracks)
    )  # each box by itself
    for block in pair_boxes(true, tracked).blocks:
        rows, columns, iou = block.overlapping
        reached = iou >= MATCHED_IOU - EPSILON
        i, j = rows[reached], columns[reached]
        places = assign_gains(i, j, iou[reached])
        on_other[block.tracked[j[places]]] = ~mine[block.true[i[places]]]
    return on_other


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
    plain = read_plain_boxes(path)
    if plain is not None and not (plain.confidences == IGNORED).any():
        return Tracks(plain.frames, plain.ids, plain.boxes)
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
    plain = read_plain_boxes(path)
    if plain is not None:
        return Tracks(plain.frames, plain.ids, plain.boxes)
    lines = parse_mot(read_text(path), str(path))
    pairs = set(zip(lines.frames.tolist(), lines.ids.tolist(), strict=True))
    return _tracks(lines, by_class=len(pairs) < len(lines))


def read_pair(
    tracks: str | Path | Tracks,
    truth_path: str | Path,
    frames: Collection[int] | None = None,
    ran: range | None = None,
    form: TruthForm | None = None,
) -> tuple[Tracks, Tracks]:
    """The true and the tracked boxes of two files; what shows that they do not go together is said.

    Args:
        tracks: the file of the tracks, or what it would hold.
        truth_path: the ground truth.
        frames: frames that alone count, which are numbered from 0 without gaps; all where None.
        ran: the frames that were tracked in, where that is known.
        form: what the lines of the ground truth hold; by what they look like where None.

    Raises:
        OSError: a file cannot be read.
        ValueError: a malformed file; says file and line.
    """
    truth = read_mot_truth(truth_path, form)
    if not isinstance(tracks, Tracks):
        tracks = read_mot_tracks(tracks)
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
