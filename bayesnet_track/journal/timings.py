"""Reading ``timings.jsonl``: how long each frame took, by a clock."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path

from bayesnet_track.journal.encoder import JournalError
from bayesnet_track.journal.reader import MOST


def read_seconds(path: Path) -> Iterator[tuple[int, float]]:
    """Frame and seconds of each line; nothing where there is no such file.

    Raises:
        JournalError: a line is malformed; says file and line.
        OSError: it cannot be read.
    """
    if not path.is_file():
        return
    # What follows the last newline is what a killed process leaves of a line.
    for number, line in enumerate(path.read_bytes().split(b"\n")[:-1], start=1):
        try:
            entry = json.loads(line)
            frame, seconds = int(entry["frame"]), float(entry["seconds"])
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
            frame, seconds = -1, math.nan
        if not (0 <= frame <= MOST and 0 <= seconds < math.inf):
            raise JournalError(f"{path}:{number}: expected an object with frame and seconds")
        yield frame, seconds
