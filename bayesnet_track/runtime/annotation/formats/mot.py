"""MOT: `frame, id, left, top, width, height, confidence, -1, -1, -1`, frames and ids from 1."""

from __future__ import annotations

from pathlib import Path

from bayesnet_track.runtime.annotation.answers import Answer
from bayesnet_track.runtime.annotation.formats.document import Document, MismatchError, given_box
from bayesnet_track.runtime.annotation.frame_store import Video
from bayesnet_track.sources.mot_lines import parse_mot, read_text


def as_mot(document: Document) -> bytes:
    """Text; the confidence is the probability, 1 where given. Names and what is gone have no place in it."""
    rows = sorted((mark.frame, number, mark, box) for number, _, mark, box in document.boxes())
    text = ""
    for frame, number, mark, box in rows:
        corner = ",".join(f"{value + 0.0:.3f}" for value in box)
        text += f"{frame + 1},{number},{corner},{mark.probability:.6f},-1,-1,-1\n"
    return text.encode()


def read_mot(path: Path, video: Video) -> list[Answer]:
    """Every box as given: target N is the file's identity N. Frames without a box say nothing.

    Raises:
        MismatchError: it does not fit the video, or is no MOT.
        OSError: it cannot be read.
    """
    try:
        lines = parse_mot(read_text(path), str(path))
    except ValueError as error:
        raise MismatchError(str(error)) from error
    return [
        given_box(int(frame), f"target {int(number)}", box, video, lines.place(row))
        for row, (frame, number, box) in enumerate(
            zip(lines.frames, lines.ids, lines.boxes.tolist(), strict=True)
        )
    ]
