"""Executors: how and where the agents of a frame are asked. None changes a result.

`serial` asks one after the other in the engine's process, `processes` in supervised worker processes.
"""

from __future__ import annotations

from bayesnet_track.runtime.executors.placing import (
    EXECUTORS,
    RETRIES,
    Executing,
    make_executor,
    parse_places,
)
from bayesnet_track.runtime.executors.workers import Limits, PlacingError

__all__ = ["EXECUTORS", "RETRIES", "Executing", "Limits", "PlacingError", "make_executor", "parse_places"]
