"""Which frame of the video an image of another tool is: by its name, or else by the number in it."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from pathlib import PurePath

from bayesnet_track.runtime.annotation.formats.document import MismatchError
from bayesnet_track.runtime.annotation.formats.rows import NO_FRAME
from bayesnet_track.runtime.annotation.frame_store import Video

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
    others: Collection[str] = (),
) -> dict[str, int]:
    """Name -> frame from 0, which may be behind the last one; NO_FRAME for an image that is not in the video.

    `images` are the files that the frames come from, if there are such. If they have all the names, these
    say the frames. Otherwise numbers do: from 0 or from 1, as only one fits, or as the names of CVAT
    (`frame_000000`, from 0) and ultralytics (`clip_1`, from 1) are known to count. `others` are names of
    images without a row, which show where the numbers begin and end, too.

    Raises:
        MismatchError: a name has no number, two have the same, or both ways to count fit.
    """
    stems = {name: _stem(name) for name in names}
    alike = _alike(others, stems.values())
    known = {_plain(PurePath(image).stem): frame for frame, image in enumerate(images)}
    if len(known) < len(images):
        known = {}
    by_name = {name: known[_plain(stem)] for name, stem in stems.items() if _plain(stem) in known}
    if len(by_name) == len(stems) and all(_plain(stem) in known for stem in alike):
        return by_name
    numbers = {name: _LAST_NUMBER.search(stem) for name, stem in stems.items()}
    found = {name: int(match.group(1)) for name, match in numbers.items() if match}
    if len(found) < len(stems):
        if by_name:
            return {name: by_name.get(name, NO_FRAME) for name in stems}
        strange = next(name for name in stems if name not in found)
        raise MismatchError(f"{place}: no number in the name {strange!r}; it says which frame it is")
    _refuse_twice(found, place)
    first = first_of_numbers([*found.values(), *alike.values()], video.frames)
    if first is None and not by_name:
        first = _first_as_named(stems.values())
    if first is None and by_name:
        return {name: by_name.get(name, NO_FRAME) for name in stems}
    if first is None:
        raise MismatchError(
            f"{place}: the numbers {min(found.values())} to {max(found.values())} of the names fit two "
            f"readings: frames counted from 0, and from 1 (the video has {video.frames}); add the first one, "
            "even if it has no object"
        )
    return {name: value - first for name, value in found.items()}


def first_of_numbers(numbers: Sequence[int], frames: int) -> int | None:
    """0 or 1, as numbers of frames count; None where both fit.

    >>> first_of_numbers([0, 7], 10), first_of_numbers([1, 10], 10), first_of_numbers([1, 7], 10)
    (0, 1, None)
    """
    if min(numbers) <= 0:
        return 0
    return 1 if max(numbers) == frames else None


def _alike(others: Collection[str], stems: Collection[str]) -> dict[str, int]:
    """Stem and number of the others that are named as `stems` are, but for the number."""
    numbered = {_LAST_NUMBER.sub("", stem) for stem in stems}
    matches = ((stem, _LAST_NUMBER.search(stem)) for stem in map(_stem, others))
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


def _refuse_twice(found: dict[str, int], place: str) -> None:
    seen: dict[int, str] = {}
    for name, value in found.items():
        if value in seen:
            raise MismatchError(f"{place}: {seen[value]!r} and {name!r} have the same number")
        seen[value] = name
