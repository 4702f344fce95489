"""MOT ground truth and MOT tracks from files."""

from __future__ import annotations

from pathlib import Path

from bayesnet_track.evaluate.mot_pairs import Tracks
from bayesnet_track.sources.mot_lines import MotLines, parse_mot, read_text

IGNORED = 0.0
"""The confidence of a true box that says: not to be scored."""


def read_mot_truth(path: str | Path) -> Tracks:
    """The true boxes that are to be scored: all but those of confidence 0 (column 7).

    Nothing else is left out: neither classes (column 8) nor visibility (column 9) are looked at, and tracks
    on boxes that are left out count as false. This is the protocol of MOT15.

    Raises:
        OSError: the file cannot be read.
        ValueError: a malformed line, an identity twice in a frame (says file and line), or nothing to score.
    """
    lines = parse_mot(read_text(path), str(path))
    scored = lines.only(lines.rest[:, 0] != IGNORED)
    if not len(scored):
        left_out = f"; {len(lines)} boxes have confidence 0" if len(lines) else ""
        raise ValueError(f"{path}: no true box to score{left_out}")
    return _tracks(scored)


def read_mot_tracks(path: str | Path) -> Tracks:
    """The boxes of a tracks file, whatever their confidence; it may be empty.

    Raises:
        OSError: the file cannot be read.
        ValueError: a malformed line, or an identity twice in a frame; says file and line.
    """
    return _tracks(parse_mot(read_text(path), str(path)))


def _tracks(lines: MotLines) -> Tracks:
    first: dict[tuple[int, int], int] = {}
    for row, key in enumerate(zip(lines.frames.tolist(), lines.ids.tolist(), strict=True)):
        if key in first:
            raise ValueError(
                f"{lines.place(row)}: identity {key[1]} is in frame {key[0] + 1} already, "
                f"in line {lines.numbers[first[key]]}"
            )
        first[key] = row
    return Tracks(lines.frames, lines.ids, lines.boxes)
