"""Planes in words, for those who read a plan."""

from __future__ import annotations

import re
from dataclasses import fields, is_dataclass

_CAPITAL = re.compile(r"(?<!^)(?=[A-Z])")
UNITS = {"px": " px", "px2": " px²", "m": " m", "deg": "°", "gray": " gray levels", "ms": " ms"}
"""Ends of a setting's name that say its unit, and how it is written behind the number."""


def plane_words(plane: object) -> str:
    """Name and settings of a plane, or its own words where it has any.

    >>> from bayesnet_track.vision.planes import Hue
    >>> plane_words(Hue(min_chroma=30, median_px=3))
    'hue (min chroma 30, median 3 px)'
    """
    if not is_dataclass(plane) or type(plane).__str__ is not object.__str__:
        return str(plane)
    name = _CAPITAL.sub(" ", type(plane).__name__).lower().removesuffix(" plane")
    settings = [_setting(one.name, getattr(plane, one.name)) for one in fields(plane) if one.repr]
    said = ", ".join(one for one in settings if one)
    return f"{name} ({said})" if said else name


def _setting(name: str, value: object) -> str:
    words = name.replace("_", " ")
    if isinstance(value, bool):
        return words if value else ""
    if is_dataclass(value):
        return plane_words(value)
    stem, _, unit = name.rpartition("_")
    if isinstance(value, int | float):
        return f"{stem.replace('_', ' ')} {value:g}{UNITS[unit]}" if unit in UNITS else f"{words} {value:g}"
    return f"{words} {value}"
