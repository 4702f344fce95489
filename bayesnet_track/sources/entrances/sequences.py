"""Which sequences the names of images form: numbers that come again in two of them may be two cameras."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Sequence
from pathlib import Path

from bayesnet_track.sources.entrances.notices import few, notice
from bayesnet_track.sources.paths import OTHER_IMAGES, SourceError, is_junk

LEAST_ALIKE, MOST_STRAYS = 3, 3
"""Names that make a usual form, and how many of them there are to a stray one at least."""
_LAST_NUMBER = re.compile(r"^(.*?)(\d+)(\D*)$")


def check_names(text: str, paths: Sequence[Path]) -> None:
    """Refuse images of a folder that are two sequences; say so of a pattern, which was chosen.

    Sequences of which the names differ in digits alone may be one, with the time in the names: a notice.

    Raises:
        SourceError: names both sequences, and patterns for them.
    """
    found = overlapping(paths)
    if not found:
        return
    words = ", ".join(f"{name} ({count} images)" for name, count in list(found.items())[:3])
    folder = Path(text) if Path(text).is_dir() else None
    is_like = len({re.sub(r"\d+", "0", name) for name in found}) == 1
    if folder is None or is_like:
        notice(f"{text}: {len(found)} sequences with the same numbers are read one after the other: {words}")
        return
    place = paths[0].parent
    patterns = " or ".join(f"'{place / name}'" for name in list(found)[:2])
    raise SourceError(
        text,
        f"{len(found)} sequences with the same numbers in one folder: {words}",
        "images of one camera in a folder",
        f"give one of them, {patterns}, or all in the order of their names, '{place / '*'}'",
    )


def overlapping(paths: Sequence[Path]) -> dict[str, int]:
    """Pattern -> images, of the sequences that share numbers with another one; empty where none do.

    >>> overlapping([Path("left_1.png"), Path("left_2.png"), Path("right_1.png"), Path("right_2.png")])
    {'left_*.png': 2, 'right_*.png': 2}
    >>> overlapping([Path("a_1.png"), Path("a_2.png"), Path("b_3.png"), Path("b_4.png")])
    {}
    """
    numbers: dict[tuple[str, str], list[int]] = defaultdict(list)
    for path in paths:
        named = _LAST_NUMBER.match(path.stem)
        if named is not None:
            numbers[f"{named[1]}*{named[3]}{path.suffix}", str(path.parent)].append(int(named[2]))
    several = {key: values for key, values in numbers.items() if len(values) > 1}
    counts: dict[int, int] = defaultdict(int)
    for values in several.values():
        for value in set(values):
            counts[value] += 1
    shared = {value for value, times in counts.items() if times > 1}
    # Numbers at the end of one part and the start of the next one may meet by chance.
    return {
        name: len(values)
        for (name, _), values in several.items()
        if 2 * len(shared.intersection(values)) > len(values)
    }


def say_strays(text: str, paths: Sequence[Path]) -> None:
    """Say which images are named otherwise than most are, as a cover or a copy `0003 (1).png`: frames, too.

    Names are of one form where they differ in digits alone.
    """
    forms = [re.sub(r"\d+", "0", path.stem) for path in paths]
    usual, count = Counter(forms).most_common(1)[0]
    strays = [path.name for path, form in zip(paths, forms, strict=True) if form != usual]
    if strays and "0" in usual and count >= LEAST_ALIKE and len(strays) <= count / MOST_STRAYS:
        like = next(path.name for path, form in zip(paths, forms, strict=True) if form == usual)
        notice(
            f"{text}: {len(strays)} of {len(paths)} images are named otherwise than {like} and the others, "
            f"and are frames in the order of names: {few(strays)}; move away what is no frame"
        )


def say_other_images(text: str, folder: Path) -> None:
    """Say which images of a folder are of a format that is not read."""
    others = sorted(
        path.name for path in folder.iterdir() if path.suffix.lower() in OTHER_IMAGES and not is_junk(path)
    )
    if others:
        notice(f"{text}: not read, as of a format that is not read in a folder of images: {few(others)}")
