"""MOT ground truth and MOT tracks from files."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import numpy as np

from bayesnet_track.evaluate.mot_pairs import Tracks
from bayesnet_track.evaluate.truth import IGNORED, TruthForm
from bayesnet_track.sources.entrances.boxes import explain_lengths, refuse_shares
from bayesnet_track.sources.entrances.notices import notice
from bayesnet_track.sources.mot_lines import MotLines, parse_mot, read_text


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
    """What is in these frames, numbered from 0 without gaps."""
    places = np.array(sorted(frames), dtype=np.int64)
    kept = tracks.only(np.isin(tracks.frames, places))
    return Tracks(np.searchsorted(places, kept.frames), kept.ids, kept.boxes, kept.classes)


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
