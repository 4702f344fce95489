"""How things show themselves in a notebook: by name, for what draws lies above those who ask for it."""

from __future__ import annotations

from importlib import import_module
from typing import Any

_DRAWN_BY = "bayesnet_track.view.notebook"


def html_of(thing: Any, how: str) -> str:
    """HTML of a thing by the function `how` of the room that draws."""
    return str(getattr(import_module(_DRAWN_BY), how)(thing))
