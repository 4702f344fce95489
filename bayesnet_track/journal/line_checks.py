"""What the values of a line must be besides their types: a run directory may come from anywhere."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from functools import cache
from typing import Any

from bayesnet_track.journal.encoder import JournalError, short
from bayesnet_track.journal.metrics import PartMetrics

MOST = 2**31 - 1
"""Largest frame, count or size in pixels: what the columns of a page hold."""


def check_line(event: Any) -> None:
    """Refuse a frame or count that is none, a box that is none, a size without pixels.

    Raises:
        JournalError: names the field, what it is and what it may be.
    """
    kind: Any = type(event)  # a class of events is hashable, whatever mypy says of Any
    for name, is_valid, what in _checks_of(kind):
        value = getattr(event, name)
        if not is_valid(value):
            raise JournalError(f"{name}: {short(repr(value))} is not {what}")


def _is_count(value: int | None) -> bool:
    return value is None or 0 <= value <= MOST


def _is_size(value: int) -> bool:
    return 1 <= value <= MOST


def _is_box(value: Sequence[float]) -> bool:
    return len(value) == 4


def _are_boxes(value: Sequence[Sequence[int]]) -> bool:
    return all(len(box) == 4 and min(box) >= -MOST and max(box) <= MOST for box in value)


def _are_parts(value: Mapping[str, PartMetrics]) -> bool:
    return all(_is_box(part.centre_box) and _is_box(part.sd) for part in value.values())


def _is_interval(value: float) -> bool:
    return math.isnan(value) or 0 <= value < math.inf


Check = tuple[str, Callable[[Any], bool], str]

_COUNT = (_is_count, f"an integer from 0 to {MOST}")
_SIZE = (_is_size, f"an integer from 1 to {MOST}")
_BOX = (_is_box, "four numbers")
_CHECKS: Mapping[str, tuple[Callable[[Any], bool], str]] = {
    **dict.fromkeys(("frame", "frames", "declared_frames", "particles", "first_frame"), _COUNT),
    **dict.fromkeys(("width", "height"), _SIZE),
    **dict.fromkeys(("box", "centre_box", "map", "sd", "region50", "region90"), _BOX),
    "cloud": (_are_boxes, f"lists of four integers from -{MOST} to {MOST}"),
    "parts": (_are_parts, "parts with boxes of four numbers"),
    "frame_interval_s": (_is_interval, "a number of seconds from 0 on"),
}
"""By the field's name: a field of the same name means the same in every event."""


@cache
def _checks_of(kind: Any) -> tuple[Check, ...]:
    return tuple((item.name, *_CHECKS[item.name]) for item in fields(kind) if item.name in _CHECKS)
