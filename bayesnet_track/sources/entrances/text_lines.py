"""Lines of numbers, as programs and spreadsheets write them, and files of other formats in their place."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from bayesnet_track.observation.settings import setting

JSON_LINES = "JSON Lines of detections"
ROWS = "MOT lines (frame,id,left,top,width,height,confidence) or a header line of names"
IMPORT = "`annotate --import` reads it"
_MASK = re.compile(r"[mM]\d+,\d+,\d+,\d+(,\d+)*$", re.ASCII)
_STATE = re.compile(r"[0-3]$", re.ASCII)
_YOLO = re.compile(r"\d{1,5}( [01]?\.\d+(e-?\d+)?){4,5}( \d+)?$", re.ASCII)


def explain_foreign(text: str) -> str | None:
    """Format of a text that holds no lines of boxes, and what takes it; None where that is not known.

    >>> explain_foreign("<annotations><version>1.1</version></annotations>")
    "XML of CVAT's annotations; `annotate --import` reads it"
    """
    start = text.lstrip()[:1]
    if start == "<":
        return _explain_xml(text)
    if start in ("{", "["):
        return _explain_json_text(text)
    return _explain_lines([line.strip() for line in text[:4000].splitlines() if line.strip()][:20])


def _explain_json_text(text: str) -> str | None:
    for part in (text.lstrip().split("\n", 1)[0], text):
        try:
            content = json.loads(part)
        except (ValueError, RecursionError):
            continue
        if isinstance(content, Mapping) and {"frame", "detections"} & content.keys():
            return f"{JSON_LINES}; {setting('--detections', 'FILE')} reads it"
        description = explain_json(content)
        if (
            description is None
            and isinstance(content, list)
            and isinstance(next(iter(content), 0), (list, dict))
        ):
            return f"a JSON list; write its boxes as {ROWS}, or as an object a line with frame and detections"
        return description
    return None


def explain_json(content: Any) -> str | None:
    """The same as `explain_foreign`, of the content of a JSON file."""
    first = content[0] if isinstance(content, list) and content else content
    if not isinstance(first, Mapping):
        return None
    keys = first.keys()
    if {"images", "annotations"} <= keys:
        return f"COCO JSON (images and annotations); {IMPORT}"
    if "image_id" in keys and keys & {"bbox", "segmentation"}:
        masks = " with masks" if "bbox" not in keys else ""
        return (
            f"COCO results{masks} (a list of objects with image_id), which do not say which image is which "
            f"frame; write its boxes as {ROWS}, or as COCO JSON with its images for `annotate --import`"
        )
    if {"size", "counts"} <= keys or isinstance(first.get("segmentation"), Mapping):
        return (
            f"run-length encoded masks of COCO (size and counts); masks are read by `annotate --import` in "
            f"COCO JSON with its images. Otherwise write the upright boxes around them as {ROWS}"
        )
    if keys & {"annotations", "predictions", "data"} and not keys & {"frame", "categories"}:
        return f"a task of Label Studio (JSON); {IMPORT}"
    if {"shapes", "imagePath"} <= keys:
        return f"JSON of labelme, of one image; write the boxes of all frames as {ROWS}"
    if {"categories", "items"} <= keys or "dm_format_version" in keys:
        return (
            f"JSON of Datumaro; export COCO or CVAT from it, which `annotate --import` reads, or write {ROWS}"
        )
    return None


def _explain_xml(text: str) -> str | None:
    head = text[:4000]
    if "<annotations" in head:
        return f"XML of CVAT's annotations; {IMPORT}"
    if "<annotation" in head:
        return f"XML of Pascal VOC, of one image; write the boxes of all frames as {ROWS}"
    return f"XML; expected {ROWS}"


def _explain_lines(lines: list[str]) -> str | None:
    masks = [bool(_MASK.match(line)) for line in lines]
    if any(masks) and all(is_mask or _STATE.match(line) for is_mask, line in zip(masks, lines, strict=True)):
        return (
            "regions of VOT that are masks (m left,top,width,height,runs of pixels), which are not read; "
            "write the upright box around each, x,y,w,h, one line for each frame"
        )
    if lines and _STATE.match(lines[0]) and any("," in line for line in lines):
        return (
            "results of a VOT toolkit (lines 0 to 3 say where a tracker was started and failed), which are "
            "not ground truth; the sequence's groundtruth.txt is. For detections write " + ROWS
        )
    if lines and lines[0].startswith("scorer,") and any(line.startswith("bodyparts,") for line in lines[:4]):
        return (
            "a CSV of DeepLabCut (points of bodies, with likelihoods); write the column of each point as a "
            f"sensor, or the box around the points of each animal as {ROWS}"
        )
    if lines and {"TRACK_ID", "POSITION_X", "FRAME"} <= set(lines[0].split(",")):
        return (
            "spots of TrackMate (POSITION_X and POSITION_Y are centres, frames count from 0, three lines of "
            "names and units below the header); write them as frame_index,x_center,y_center,width,height"
        )
    spaced = [" ".join(line.split()) for line in lines]
    if spaced and all(_YOLO.match(line) for line in spaced) and not _count(spaced):
        return (
            "labels of YOLO of one image (class and parts of the image, from 0 to 1), which do not say the "
            f"frame; `annotate --import` reads a folder of them. Otherwise write px as {ROWS}"
        )
    return None


def _count(lines: list[str]) -> bool:
    """True if the first numbers grow from line to line, as frames do and classes do not."""
    first = [int(line.split(" ", 1)[0]) for line in lines]
    return len(first) > 2 and all(earlier < later for earlier, later in pairwise(first))


def refuse_foreign(text: str, name: str, is_taken: str = "") -> None:
    """Raise ValueError for a text that is known to be of another format than `is_taken`."""
    description = explain_foreign(text)
    if is_taken and description is not None and description.startswith(is_taken):
        return
    if description is not None:
        raise ValueError(f"{name}: it is {description}")


SHOWN = 40

Line = tuple[int, list[str]]
"""The number of a line, from 1, and its words."""


class NotTextError(ValueError):
    """A file that is not text; says which."""


@dataclass(frozen=True, eq=False)
class TextLines:
    """A text as lines of words.

    Attributes:
        name: of the file, for messages.
        header: the names in the first line, None where it holds a number; with the line's number.
        text: the lines that follow.
        first: the number of the first of them.
    """

    name: str
    header: Line | None
    text: list[str]
    first: int

    @property
    def is_plain(self) -> bool:
        """True if nothing here is a number for `float` alone, such as 1_0 or digits of other scripts."""
        return all(line.isascii() and "_" not in line for line in self.text)

    def __iter__(self) -> Iterator[Line]:
        """Each line that holds something."""
        for number, line in enumerate(self.text, start=self.first):
            words = split_words(line)
            if words:
                yield number, words


def split_lines(text: str, name: str) -> TextLines:
    """The lines of a text, whatever ends them; a first line without any number is a header.

    Raises ValueError for a text that is known to be of another format.

    >>> split_lines("frame;id\\r\\n1;7", "a.csv").header
    (1, ['frame', 'id'])
    """
    refuse_foreign(text, name)
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    for number, line in enumerate(lines, start=1):
        words = split_words(line.lstrip("#") if line.startswith("#") else line)
        if words:
            if all(map(_is_name, words)):
                return TextLines(name, (number, words), lines[number:], number + 1)
            break
    return TextLines(name, None, lines, 1)


def split_words(line: str) -> list[str]:
    """The words of a line, separated by semicolons, or else commas, or else tabs or spaces.

    Empty words at the end are left out, as spreadsheets fill up short lines.

    >>> split_words('1;"2";3;;')
    ['1', '2', '3']
    """
    separator = ";" if ";" in line else "," if "," in line else "\t" if '"' in line and "\t" in line else None
    if '"' in line and separator is not None:
        words = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    else:
        words = line.split(separator)
        if '"' in line:
            words = [word.strip('"') for word in words]
    while words and not words[-1].strip():
        words.pop()
    return words


def _is_name(word: str) -> bool:
    """True if a word can name a column: it has a letter, or is empty, and is no number such as nan."""
    return not is_number(word) and (not word.strip() or any(map(str.isalpha, word)))


def is_number(word: str) -> bool:
    """True for what `float` reads, but for underscores and digits that are not ASCII."""
    try:
        float(word)
    except ValueError:
        return False
    return word.isascii() and "_" not in word


def explain_word(words: list[str], place: str, expected: str) -> ValueError:
    """The error of the first word that is not a number."""
    wrong = next((word.strip() for word in words if not is_number(word)), "")
    excerpt = f"{place}: {wrong[:SHOWN]!r}"
    parts = wrong.replace(",", " ").split()
    if "," in wrong and all(map(is_number, parts)):
        return ValueError(
            f"{excerpt} has a comma between other separators: a decimal comma (write "
            f"{wrong.replace(',', '.')[:SHOWN]}), or two numbers (separate all by the same sign)"
        )
    if len(parts) > 1 and all(map(is_number, parts)):
        return ValueError(
            f"{excerpt} is separated by a space, and the line by commas: decimal commas (write points), or "
            "separators (separate all by the same sign)"
        )
    return ValueError(f"{excerpt} is not a number; expected {expected}")
