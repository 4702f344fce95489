"""Files of known formats where another is expected: what they are, and what takes them."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

from bayesnet_track.observation.settings import setting

PACKED = {
    b"PK\x03\x04": "a zip, or arrays of NumPy (.npz)",
    b"\x93NUMPY": "an array of NumPy (.npy)",
    b"\x1f\x8b": "packed by gzip",
    b"\x89PNG": "a PNG image",
    b"\xff\xd8\xff": "a JPEG image",
    b"\x80\x03": "a pickle of Python",
    b"\x80\x04": "a pickle of Python",
    b"\x80\x05": "a pickle of Python",
    b"\x89HDF": "HDF5",
    b"MATLAB": "a MAT file of MATLAB",
    b"SQLite": "a database of SQLite",
    b"%PDF": "a PDF",
}
"""How a file begins -> what it is."""

JSON_LINES = "JSON Lines of detections"
ROWS = "MOT lines (frame,id,left,top,width,height,confidence) or a header line of names"
IMPORT = "`annotate --import` reads it"
_MASK = re.compile(r"[mM]\d+,\d+,\d+,\d+(,\d+)*$", re.ASCII)
_STATE = re.compile(r"[0-3]$", re.ASCII)
_YOLO = re.compile(r"\d{1,5}( [01]?\.\d+(e-?\d+)?){4,5}( \d+)?$", re.ASCII)


def name_bytes(data: bytes) -> str:
    """What a file that is no text is, in parentheses, by its first bytes; empty where that is not known."""
    return next((f" ({what})" for start, what in PACKED.items() if data.startswith(start)), "")


def explain_foreign(text: str) -> str | None:
    """What a text is that holds no lines of boxes, and what takes it; None where that is not known.

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
        return explain_json(content)
    return None


def explain_json(content: Any) -> str | None:
    """As `explain_foreign`, of the content of a JSON file."""
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
    spaced = [" ".join(line.split()) for line in lines]
    if spaced and all(_YOLO.match(line) for line in spaced) and not _count(spaced):
        return (
            "labels of YOLO of one image (class and parts of the image, from 0 to 1), which do not say the "
            f"frame; `annotate --import` reads a folder of them. Otherwise write px as {ROWS}"
        )
    return None


def _count(lines: list[str]) -> bool:
    """Whether the first numbers grow from line to line, as frames do and classes do not."""
    first = [int(line.split(" ", 1)[0]) for line in lines]
    return len(first) > 2 and all(one < other for one, other in pairwise(first))


def refuse_foreign(text: str, name: str, is_taken: str = "") -> None:
    """Raise ValueError for a text that is known to be of another format than `is_taken`."""
    known = explain_foreign(text)
    if is_taken and known is not None and known.startswith(is_taken):
        return
    if known is not None:
        raise ValueError(f"{name}: it is {known}")
