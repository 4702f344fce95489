"""Frames without images for a file of boxes: their number, their size and their rate.

`seqinfo.ini` beside the file, or in the folder above, says what they are, as in sequences of MOTChallenge.
Without it the size is the smallest that holds all boxes, and the rate is assumed; a notice says both.
"""

from __future__ import annotations

import configparser
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bayesnet_track.numerics.boxes import corner_from_centre
from bayesnet_track.sources.detection_files import parse_detections
from bayesnet_track.sources.entrances.columns import NAMES, plain
from bayesnet_track.sources.entrances.notices import notice
from bayesnet_track.sources.frames import Picture
from bayesnet_track.sources.mot_lines import read_text

ASSUMED_RATE = 25.0
"""Frames a second where nothing says the rate."""

SEQINFO = "seqinfo.ini"
SIDES = ("left", "top", "width", "height", "right", "bottom")
MOST_PX = 1 << 15
"""Sides of frames beyond it are in another unit than pixels."""


@dataclass(frozen=True)
class _Sequence:
    width: int
    height: int
    rate: float
    frames: int


def names_boxes(path: str | Path) -> bool:
    """True of a CSV file without a header, or with one that names boxes in full, not by `x`, `y`, `w`, `h`:
    those can be what a sensor measures."""
    words = {plain(word) for word in re.split("[,;\t]", read_text(path).partition("\n")[0])}
    named = {what for what in SIDES if words & {name for name in NAMES[what] if len(name) > 1}}
    is_header = any(word[:1].isalpha() for word in words)
    return named >= set(SIDES[:4]) or named >= {*SIDES[:2], *SIDES[4:]} or not is_header


class BoxReader:
    """Black frames of a file of boxes, from frame 0 to the last one that has a box.

    Where nothing else says their width and height, px, they are those `of_camera`.

    Raises:
        OSError: the file cannot be read.
        ValueError: a malformed line, or no box that can be used; says file and line.
    """

    gap_from = math.inf
    is_live = False

    def __init__(self, text: str, of_camera: tuple[int, int] | None = None) -> None:
        found = parse_detections(read_text(text), text)
        if not found:
            raise ValueError(f"{text}: no box that can be used, so nothing says which frames there are")
        corners = corner_from_centre(np.concatenate([one.boxes for one in found.values()]))
        sides = np.ceil((corners[:, :2] + corners[:, 2:]).max(axis=0))
        if not (sides <= MOST_PX).all():
            raise ValueError(
                f"{text}: a box ends at {sides.max():g} px; frames have up to {MOST_PX} px a side"
            )
        size = _described(Path(text))
        if size is None:
            width, height = of_camera or (max(int(side), 1) for side in sides)
            size = _Sequence(width, height, ASSUMED_RATE, max(found) + 1)
            why = "which holds all boxes" if of_camera is None else "as the camera is calibrated"
            notice(
                f"{text}: no images; frames are taken as {width} x {height} px, {why}, and "
                f"{ASSUMED_RATE:g} a second; a {SEQINFO} beside it with imWidth, imHeight, frameRate and "
                "seqLength says what they are"
            )
        self._size = size
        self.frame_interval_s = 1.0 / size.rate
        self.declared_frames: int | None = max(size.frames, max(found) + 1)

    def __iter__(self) -> Iterator[Picture]:
        image = np.zeros((self._size.height, self._size.width, 3), np.uint8)
        for index in range(self.declared_frames or 0):
            yield Picture(index, float(index), index * self.frame_interval_s, lambda: (image, True))

    def close(self) -> None:
        """Nothing stays open."""


def _described(boxes: Path) -> _Sequence | None:
    """The sequence that a `seqinfo.ini` near a file of boxes describes; None without a usable one."""
    places = [folder / SEQINFO for folder in (boxes.parent, boxes.parent.parent)]
    path = next((place for place in places if place.is_file()), None)
    if path is None:
        return None
    parser = configparser.ConfigParser()
    try:
        parser.read_string(read_text(path))
        section = parser["Sequence"]
        width, height, frames = (int(section[key]) for key in ("imWidth", "imHeight", "seqLength"))
        described = _Sequence(width, height, float(section["frameRate"]), frames)
        if not (0 < width <= MOST_PX and 0 < height <= MOST_PX and frames > 0):
            raise ValueError(f"imWidth {width}, imHeight {height}, seqLength {frames}")
        if not (math.isfinite(described.rate) and described.rate > 0):
            raise ValueError(f"frameRate {described.rate:g}")
    except (configparser.Error, KeyError, ValueError) as error:
        notice(
            f"{path}: not used: {' '.join(str(error).split())}; [Sequence] with imWidth, imHeight, "
            "frameRate and seqLength is needed"
        )
        return None
    return described
