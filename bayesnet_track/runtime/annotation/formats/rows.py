"""Rows of a file as answers: the frame of each image, what is left out, what is refused."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath

import numpy as np

from bayesnet_track.runtime.annotation.answers import Answer, Box
from bayesnet_track.runtime.annotation.formats.reading import MismatchError
from bayesnet_track.runtime.annotation.frame_store import Video
from bayesnet_track.sources.entrances.boxes import describe_unusable, usable
from bayesnet_track.sources.entrances.notices import few, notice

NO_FRAME = -1
"""The frame of a row whose image is none of the video."""


@dataclass(frozen=True)
class Row:
    """A box in a file, or where a target goes.

    Attributes:
        place: where in the file, for messages.
        frame: from 0; may be none of the video.
        key: the identity in the file.
        label: its class.
        box: x, y, width, height in px, as it stands there; None: the target is gone from this frame on.
        shape: what an upright box was made of, such as "rotated box"; empty of a box.
    """

    place: str
    frame: int
    key: Hashable
    label: str
    box: Box | None
    shape: str = ""


def answers_of(
    rows: Iterable[Row],
    video: Video,
    path: Path,
    names: Mapping[Hashable, str] | None = None,
    unnamed: str = "",
) -> list[Answer]:
    """The answers that rows give.

    `names` are those of identities in the file; others are named by label and number: "ball 1", "ball 2".
    `unnamed` says, of a format without identities, why two boxes of a label in a frame are refused. Warns of
    every row that is left out, and of every shape that is not an upright box.

    Raises:
        MismatchError: no row can be used, or a target has two boxes in a frame.
    """
    rows = list(rows)
    boxes = [row for row in rows if row.box is not None]
    usable_rows, sentences = _fitting(boxes, video)
    if boxes and not usable_rows:
        raise MismatchError(f"{path}: no box can be used: {'; '.join(sentences)}")
    shapes = Counter(row.shape for row in usable_rows if row.shape)
    sentences += [
        f"{_of(count, len(usable_rows))} the upright box around a {shape}" for shape, count in shapes.items()
    ]
    usable_rows, of_repeats = _once(usable_rows, path, unnamed)
    labels, of_classes = _labels(usable_rows)
    for sentence in [*sentences, *of_repeats, *of_classes]:
        notice(f"{path}: {sentence}")
    named = number_names(labels, names or {})
    gone = [row for row in rows if row.box is None and row.key in named and 0 <= row.frame < video.frames]
    return [
        Answer("gone" if row.box is None else "box", row.frame, named[row.key], row.box)
        for row in [*usable_rows, *gone]
    ]


def _fitting(boxes: list[Row], video: Video) -> tuple[list[Row], list[str]]:
    """The rows in the video and in its frames, and sentences about the others."""
    sentences = []
    corners = np.array([row.box for row in boxes], dtype=np.float64).reshape(-1, 4)
    good = usable(corners).tolist()
    bad = [row.place for row, fits in zip(boxes, good, strict=True) if not fits]
    if bad:
        sentences.append(describe_unusable(len(boxes), bad, "at"))
    boxes = [row for row, fits in zip(boxes, good, strict=True) if fits]
    strange = [row for row in boxes if row.frame == NO_FRAME]
    if strange:
        sentences.append(
            f"{_of(len(strange), len(boxes))} in images that the video does not have, and left out: "
            f"at {few([row.place for row in strange])}"
        )
    late = [row.frame for row in boxes if row.frame != NO_FRAME and not 0 <= row.frame < video.frames]
    if late:
        sentences.append(
            f"{_of(len(late), len(boxes))} in frames {min(late)} to {max(late)} (counted from 0), and left "
            f"out; the video has frames 0 to {video.frames - 1}: is it the file of this video, "
            "and of its frame rate?"
        )
    boxes = [row for row in boxes if 0 <= row.frame < video.frames]
    out_of_frame = [row for row in boxes if row.box is not None and _is_outside(row.box, video)]
    if out_of_frame:
        x, y, right, bottom = _extent(out_of_frame)
        sentences.append(
            f"{_of(len(out_of_frame), len(boxes))} outside of the frame of {video.width}x{video.height} px, "
            f"and left out (x {x:g} to {right:g}, y {y:g} to {bottom:g}): at "
            f"{few([row.place for row in out_of_frame])}"
        )
    left_out = {id(row) for row in out_of_frame}
    return [row for row in boxes if id(row) not in left_out], sentences


def _of(count: int, total: int) -> str:
    """The share of all boxes, in words.

    >>> _of(1, 1), _of(2, 9)
    ('1 of 1 box is', '2 of 9 boxes are')
    """
    return f"{count} of {total} box{'es' * (total != 1)} {'is' if count == 1 else 'are'}"


def _is_outside(box: Box, video: Video) -> bool:
    x, y, w, h = box
    return x >= video.width or y >= video.height or x + w <= 0 or y + h <= 0


def _extent(rows: Sequence[Row]) -> Box:
    boxes = np.array([row.box for row in rows])
    x, y = boxes[:, :2].min(axis=0)
    right, bottom = (boxes[:, :2] + boxes[:, 2:]).max(axis=0)
    return float(x), float(y), float(right), float(bottom)


def _once(rows: list[Row], path: Path, unnamed: str) -> tuple[list[Row], list[str]]:
    """Each target once in a frame; raises MismatchError where its boxes differ."""
    first: dict[tuple[Hashable, int], Row] = {}
    for row in rows:
        earlier = first.setdefault((row.key, row.frame), row)
        if earlier.box != row.box:
            why = (
                f"a second box of {row.label!r}, at {earlier.place} and at {row.place}; {unnamed}"
                if unnamed
                else f"two boxes of identity {row.key} ({row.label}), at {earlier.place} and at {row.place}; "
                "a target has one box in a frame"
            )
            raise MismatchError(f"{path}, frame {row.frame} (counted from 0): {why}")
    repeats = len(rows) - len(first)
    sentence = f"{_of(repeats, len(rows))} there twice, and taken once"
    return list(first.values()), [sentence] if repeats else []


def _labels(rows: Iterable[Row]) -> tuple[dict[Hashable, str], list[str]]:
    """Identity -> its most frequent label, and sentences about the identities that have several."""
    counts: dict[Hashable, Counter[str]] = {}
    for row in rows:
        counts.setdefault(row.key, Counter())[row.label] += 1
    sentences = [
        f"identity {key} has the classes {', '.join(of_identity)}; "
        f"it is taken as {of_identity.most_common(1)[0][0]}"
        for key, of_identity in counts.items()
        if len(of_identity) > 1
    ]
    labels = {key: of_identity.most_common(1)[0][0] for key, of_identity in counts.items()}
    return labels, [*sentences[:3], f"{len(sentences) - 3} more identities have several classes"] if len(
        sentences
    ) > 3 else sentences


def number_names(labels: Mapping[Hashable, str], names: Mapping[Hashable, str]) -> dict[Hashable, str]:
    """Identity -> name: that of the file, if no other has it, or else label and number.

    >>> number_names({7: "ball", 9: "ball", 4: "cup"}, {9: "ball 1"})
    {9: 'ball 1', 7: 'ball 2', 4: 'cup 1'}
    """
    counts = Counter(names.values())
    named = {key: names[key] for key in labels if key in names and counts[names[key]] == 1}
    used_names = set(named.values())
    numbers: Counter[str] = Counter()
    for key, label in labels.items():
        while key not in named:
            numbers[label] += 1
            name = f"{label} {numbers[label]}"
            if name not in used_names:
                named[key] = name
                used_names.add(name)
    return named


_HASH = re.compile(r"[_.](?:jpe?g|png|bmp)\.rf\.[0-9A-Za-z]+$")
"""What Roboflow puts behind a name."""
_LAST_NUMBER = re.compile(r"(?<!\d)(\d{1,18})\D*$", re.ASCII)
_ZEROS = re.compile(r"(?<!\d)0+(?=\d)", re.ASCII)
_CVAT = re.compile(r"frame_\d{6}$", re.ASCII)
_ULTRALYTICS = re.compile(r".+_(?:0|[1-9]\d*)$", re.ASCII)


def frames_of_names(
    names: Sequence[str],
    video: Video,
    images: Sequence[str],
    place: str,
    empty_names: Collection[str] = (),
) -> dict[str, int]:
    """Name -> frame from 0, which may be behind the last one; NO_FRAME for an image that is not in the video.

    `images` are the files that the frames come from, if there are such. If they have all the names, these
    say the frames. Otherwise numbers do: from 0 or from 1, as only one fits, or as the names of CVAT
    (`frame_000000`, from 0) and ultralytics (`clip_1`, from 1) are known to count. `empty_names` are names of
    images without a row, which show where the numbers begin and end, too.

    Raises:
        MismatchError: a name has no number, two have the same, or both ways to count fit.
    """
    stems = {name: _stem(name) for name in names}
    empty_numbers = _alike(empty_names, stems.values())
    frames = {_plain(PurePath(image).stem): frame for frame, image in enumerate(images)}
    if len(frames) < len(images):
        frames = {}
    by_name = {name: frames[_plain(stem)] for name, stem in stems.items() if _plain(stem) in frames}
    if len(by_name) == len(stems) and all(_plain(stem) in frames for stem in empty_numbers):
        return by_name
    numbers = {name: _LAST_NUMBER.search(stem) for name, stem in stems.items()}
    numbered = {name: int(match.group(1)) for name, match in numbers.items() if match}
    if len(numbered) < len(stems):
        if by_name:
            return {name: by_name.get(name, NO_FRAME) for name in stems}
        strange = next(name for name in stems if name not in numbered)
        raise MismatchError(f"{place}: no number in the name {strange!r}; it says which frame it is")
    _refuse_twice(numbered, place)
    first = first_of_numbers([*numbered.values(), *empty_numbers.values()], video.frames)
    if first is None and not by_name:
        first = _first_as_named(stems.values())
    if first is None and by_name:
        return {name: by_name.get(name, NO_FRAME) for name in stems}
    if first is None:
        raise MismatchError(
            f"{place}: the numbers {min(numbered.values())} to {max(numbered.values())} of the names fit two "
            f"readings: frames counted from 0, and from 1 (the video has {video.frames}); add the first one, "
            "even if it has no object"
        )
    return {name: value - first for name, value in numbered.items()}


def first_of_numbers(numbers: Sequence[int], frames: int) -> int | None:
    """0 or 1, as numbers of frames count; None where both fit.

    >>> first_of_numbers([0, 7], 10), first_of_numbers([1, 10], 10), first_of_numbers([1, 7], 10)
    (0, 1, None)
    """
    if min(numbers) <= 0:
        return 0
    return 1 if max(numbers) == frames else None


def _alike(empty_names: Collection[str], stems: Collection[str]) -> dict[str, int]:
    """Stem and number of the others that are named as `stems` are, but for the number."""
    numbered = {_LAST_NUMBER.sub("", stem) for stem in stems}
    matches = ((stem, _LAST_NUMBER.search(stem)) for stem in map(_stem, empty_names))
    return {stem: int(m.group(1)) for stem, m in matches if m and stem[: m.start()] in numbered}


def _first_as_named(stems: Collection[str]) -> int | None:
    if all(map(_CVAT.match, stems)):
        return 0
    return 1 if all(map(_ULTRALYTICS.match, stems)) else None


def _plain(stem: str) -> str:
    """A name in which numbers are written without zeros before them."""
    return _ZEROS.sub("", stem)


def _stem(name: str) -> str:
    return _HASH.sub("", PurePath(name.replace("\\", "/")).stem)


def _refuse_twice(numbers: dict[str, int], place: str) -> None:
    names: dict[int, str] = {}
    for name, value in numbers.items():
        if value in names:
            raise MismatchError(f"{place}: {names[value]!r} and {name!r} have the same number")
        names[value] = name
