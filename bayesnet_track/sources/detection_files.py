"""Detections as text, MOT or JSON Lines: lines of a frame, a file as a detector or as the frames.

`seqinfo.ini` beside the file, or in the folder above, says what they are, as in sequences of MOTChallenge.
Without it the size is the smallest that holds all boxes, and the rate is assumed; a notice says both.
"""

from __future__ import annotations

import configparser
import json
import math
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.boxes import centre_from_corner, corner_from_centre
from bayesnet_track.observation.detector import NOTHING, Detections, DetectorState
from bayesnet_track.observation.planes import Frame, FramePair
from bayesnet_track.sources.entrances.boxes import describe_unusable, refuse_shares, usable
from bayesnet_track.sources.entrances.notices import notice
from bayesnet_track.sources.entrances.text_lines import JSON_LINES, refuse_foreign
from bayesnet_track.sources.mot_blocks import NAMES, plain_name
from bayesnet_track.sources.mot_lines import parse_mot, read_text
from bayesnet_track.sources.timing import Picture

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
    words = {plain_name(word) for word in re.split("[,;\t]", read_text(path).partition("\n")[0])}
    named = {side for side in SIDES if words & {name for name in NAMES[side] if len(name) > 1}}
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
        detections = parse_detections(read_text(text), text)
        if not detections:
            raise ValueError(f"{text}: no box that can be used, so nothing says which frames there are")
        corners = corner_from_centre(
            np.concatenate([frame_detections.boxes for frame_detections in detections.values()])
        )
        sides = np.ceil((corners[:, :2] + corners[:, 2:]).max(axis=0))
        if not (sides <= MOST_PX).all():
            raise ValueError(
                f"{text}: a box ends at {sides.max():g} px; frames have up to {MOST_PX} px a side"
            )
        size = _described(Path(text))
        if size is None:
            width, height = of_camera or (max(int(side), 1) for side in sides)
            size = _Sequence(width, height, ASSUMED_RATE, max(detections) + 1)
            why = "which holds all boxes" if of_camera is None else "as the camera is calibrated"
            notice(
                f"{text}: no images; frames are taken as {width} x {height} px, {why}, and "
                f"{ASSUMED_RATE:g} a second; a {SEQINFO} beside it with imWidth, imHeight, frameRate and "
                "seqLength says what they are"
            )
        self._size = size
        self.frame_interval_s = 1.0 / size.rate
        self.declared_frames: int | None = max(size.frames, max(detections) + 1)

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


DIGITS, SCORE_DIGITS = 3, 6


def format_frame(frame: Frame, detections: Detections, as_json: bool) -> list[str]:
    """The lines of one frame.

    MOT: ``frame, -1, left, top, width, height, score, -1, -1, -1``, frames from 1, pixels from 0. JSON: one
    object with frame (from 0), time_s, and detections, each with box (the same four numbers), score, label.
    """
    if not as_json:
        return format_mot(frame.index, detections)
    corners = corner_from_centre(detections.boxes)
    entries = [
        {
            "box": [round(float(value), DIGITS) for value in box],
            "score": round(float(score), SCORE_DIGITS),
            "label": label,
        }
        for box, score, label in zip(corners, detections.scores, detections.labels, strict=True)
    ]
    return [json.dumps({"frame": frame.index, "time_s": round(frame.time_s, 6), "detections": entries})]


def format_mot(index: int, detections: Detections) -> list[str]:
    """The MOT lines of the frame with this index, from 0; see `format_frame`."""
    return [
        f"{index + 1},-1,{','.join(f'{value + 0.0:.{DIGITS}f}' for value in box)},"
        f"{score:.{SCORE_DIGITS}f},-1,-1,-1"
        for box, score in zip(corner_from_centre(detections.boxes), detections.scores, strict=True)
    ]


MISSING = -1.0
"""A confidence that says: none is known."""
PERCENT_FROM = 10.0
"""The best confidence of a file in percent is not below it; margins and logits hardly get there."""

Found = tuple[Floats, float, str]
"""A corner box (4,) in px, its score, its label."""


@dataclass(frozen=True, eq=False)
class FileDetector:
    """A detector that finds what a file says of the current frame.

    Attributes:
        found: index of a frame (from 0) -> its detections; other frames have none.
    """

    found: Mapping[int, Detections]

    def start(self) -> DetectorState:
        """Nothing is remembered."""
        return {}

    def detect(self, frames: FramePair, state: DetectorState) -> tuple[Detections, DetectorState]:
        """Detections of the current frame in the file, matched by its index."""
        return self.found.get(frames.current.index, NOTHING), state


def file_detector(path: str | Path) -> FileDetector:
    """The detector of a file of detections; see `parse_detections`.

    Raises:
        OSError: the file cannot be read.
        ValueError: a malformed line; says file and line.
    """
    return FileDetector(parse_detections(read_text(path), str(path)))


def parse_detections(text: str, name: str = "<detections>") -> dict[int, Detections]:
    """Index of each frame with detections -> those, the best first, ties as in the file.

    A text whose first character is a brace is JSON Lines, as `format_frame` writes them: an object a line
    with frame (from 0) and detections, each with box (left, top, width, height), score (0..1; 1 when left
    out) and label (empty when left out). Any other is what `parse_mot` reads: frame (from 1), id (not looked
    at), left, top, width, height, confidence, and a class, which becomes the label. A missing confidence is
    1, and so is -1, where all others are from 0 to 1, or percent: from 0 to 100, the highest from 10 on.
    Percent is divided by 100. Those of a file that go beyond 0..1 otherwise are on a scale of their own, and
    mapped linearly: the file's lowest to 0, its highest to 1 (all equal: all to 1). A notice says either.
    Boxes that are not finite or have no area are left out with a notice.

    Raises:
        ValueError: a malformed line; says file and line.

    >>> parse_detections("1,-1,10,20,41,31,0.5,-1,-1,-1")[0].boxes.tolist()
    [[30.0, 35.0, 41.0, 31.0]]
    """
    if text.lstrip().startswith("{"):
        return _by_frame(_of_json_lines(text, name))
    lines = parse_mot(text, name)
    rows = zip(
        lines.frames.tolist(),
        lines.boxes,
        _shares(lines.rest[:, 0], name).tolist(),
        lines.classes.tolist(),
        strict=True,
    )
    return _by_frame((frame, (box, score, label)) for frame, box, score, label in rows)


def _of_json_lines(text: str, name: str) -> Iterable[tuple[int, Found]]:
    try:
        rows = list(_json_lines(text, name))
    except ValueError:
        refuse_foreign(text, name, JSON_LINES)
        raise
    refuse_shares(np.array([box for _, _, (box, _, _) in rows]).reshape(-1, 4), name)
    return _usable(rows, name)


def _usable(rows: list[tuple[int, int, Found]], name: str) -> Iterable[tuple[int, Found]]:
    """The usable ones of (line, frame, detection); a notice names the others."""
    boxes = np.array([box for _, _, (box, _, _) in rows]).reshape(-1, 4)
    keep = usable(boxes).tolist()
    if not all(keep):
        lines = [line for (line, _, _), is_usable in zip(rows, keep, strict=True) if not is_usable]
        notice(f"{name}: {describe_unusable(len(rows), lines)}")
    return (
        (frame, detection) for (_, frame, detection), is_usable in zip(rows, keep, strict=True) if is_usable
    )


def _by_frame(detections: Iterable[tuple[int, Found]]) -> dict[int, Detections]:
    frames = defaultdict(list)
    for frame, detection in detections:
        frames[frame].append(detection)
    return {frame: _detections(of_frame) for frame, of_frame in frames.items()}


def _detections(of_frame: list[Found]) -> Detections:
    best_first = sorted(of_frame, key=lambda detection: -detection[1])
    boxes, scores, labels = zip(*best_first, strict=True)
    return Detections(centre_from_corner(np.array(boxes)), np.array(scores), labels)


def _shares(confidences: Floats, name: str) -> Floats:
    """Confidences (N,), NaN where missing, as scores 0..1; says how others are mapped."""
    has_confidence = ~np.isnan(confidences)
    scores = np.where(has_confidence, confidences, 1.0)
    is_missing = has_confidence & (confidences == MISSING)
    stated = confidences[has_confidence & ~is_missing]
    if ((stated >= 0) & (stated <= 1)).all():
        scores[is_missing] = 1.0
        if is_missing.any() and len(stated):
            notice(
                f"{name}: {is_missing.sum()} of {len(confidences)} confidences are -1, which says none: they "
                "are taken as 1"
            )
        return scores
    if PERCENT_FROM <= stated.max() <= 100 and stated.min() >= 0:
        scores = np.where(has_confidence & ~is_missing, confidences / 100, 1.0)
        notice(
            f"{name}: confidences from {stated.min():g} to {stated.max():g} are taken as percent: divided by "
            "100. Write confidences from 0 to 1 if they are none"
        )
        return scores
    values = confidences[has_confidence]
    low, high = values.min(), values.max()
    scores[has_confidence] = (values - low) / (high - low) if high > low else 1.0
    to = f"{low:g} becomes 0 and {high:g} becomes 1" if high > low else "all become 1"
    notice(
        f"{name}: confidences from {low:g} to {high:g} are no probabilities, and are mapped: {to}; a "
        "min_score of the graph is compared with the mapped ones. Write confidences from 0 to 1 to have them "
        "as they are"
    )
    return scores


def _json_lines(text: str, name: str) -> Iterable[tuple[int, int, Found]]:
    for number, line in enumerate(text.split("\n"), start=1):
        if line.strip():
            place = f"{name}:{number}"
            frame, entries = _object(line, place)
            for k, entry in enumerate(entries):
                yield number, frame, _detection(entry, f"{place}: detection {k + 1}")


def _object(line: str, place: str) -> tuple[int, list[Any]]:
    try:
        entry = json.loads(line)
        frame, detections = entry["frame"], entry["detections"]
    except (ValueError, KeyError, TypeError, RecursionError):
        raise ValueError(f"{place}: expected an object with frame and detections") from None
    if not _is_whole(frame) or frame < 0:
        raise ValueError(f"{place}: frame {_excerpt(frame)}; expected a whole number from 0 on")
    if not isinstance(detections, list):
        raise ValueError(f"{place}: detections {_excerpt(detections)}; expected a list")
    return frame, detections


def _detection(entry: Any, place: str) -> Found:
    if not isinstance(entry, dict) or "box" not in entry:
        raise ValueError(f"{place}: {_excerpt(entry)}; expected an object with box, score, label")
    box, score, label = entry["box"], entry.get("score", 1.0), entry.get("label", "")
    if not isinstance(box, list) or len(box) != 4 or not all(map(_is_number, box)):
        raise ValueError(f"{place}: box {_excerpt(box)}; expected [left, top, width, height]")
    if not _is_finite(score) or not 0 <= score <= 1:
        raise ValueError(f"{place}: score {_excerpt(score)}; expected a number from 0 to 1")
    if not isinstance(label, str):
        raise ValueError(f"{place}: label {_excerpt(label)}; expected a text")
    return np.array([_as_float(value) for value in box]), float(score), label


def _is_number(value: Any) -> bool:
    return value is None or (isinstance(value, int | float) and not isinstance(value, bool))


def _as_float(value: int | float | None) -> float:
    """NaN for null, as JSON writes what is no number; an infinity for whole numbers beyond any float."""
    try:
        return float("nan") if value is None else float(value)
    except OverflowError:
        return float("inf")


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_finite(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300


def _excerpt(value: Any) -> str:
    return json.dumps(value)[:60]
