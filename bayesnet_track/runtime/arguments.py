"""Single values given to `track`: the same ranges as on the command line, in types that a recipe can hold."""

from __future__ import annotations

import operator
from typing import Literal, SupportsIndex

from bayesnet_track.runtime.resizing import LEAST_MAX_SIDE

MOST_MS = 1e7
"""`budget_ms` is below it."""


def whole(name: str, value: SupportsIndex, least: int) -> int:
    """A whole number from `least` on, of any integer type.

    >>> whole("stride", 3, 1)
    3

    Raises:
        ValueError: it is another value.
    """
    try:
        number = least - 1 if isinstance(value, bool) else operator.index(value)
    except TypeError:
        number = least - 1
    if number < least:
        raise ValueError(f"{name}={value!r}: a whole number from {least} on is needed")
    return number


def longest_side(value: SupportsIndex | None) -> int | None:
    """`max_side`; raises ValueError where it is no number of pixels that can be tracked in."""
    return None if value is None else whole("max_side", value, LEAST_MAX_SIDE)


def milliseconds(value: float | None) -> float | None:
    """`budget_ms`; raises ValueError where it is no time that a frame can take."""
    if value is None:
        return None
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = 0.0
    if not 0.0 < number < MOST_MS:
        raise ValueError(
            f"budget_ms={value!r}: milliseconds above 0 and below {MOST_MS:g} are needed; None for no budget"
        )
    return number


def check_video(value: bool | Literal["mkv", "mp4"]) -> None:
    """Refuse what `video` does not know; raises ValueError."""
    if value not in (False, True, "mkv", "mp4"):
        raise ValueError(f"video={value!r}: False, True, 'mkv' or 'mp4' is needed; True is 'mkv'")
