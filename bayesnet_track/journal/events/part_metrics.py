"""What stands in ``frames.jsonl`` about a part of a target."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PartMetrics:
    """What was measured for one part of a target in one frame.

    Attributes:
        box: estimate, the mean of the part's belief given all that was seen, centre box x, y, w, h in px.
        sd: posterior sd of x, y, w, h in px.
        ud_px2: uncertainty deviation about the estimate; the same as in `ud_nodes`.
        status: seen; hidden (its agents look, and see nothing like it) or unwatched (none of them is active),
            and then told from the rest of the target.
    """

    box: tuple[float, ...]
    sd: tuple[float, ...]
    ud_px2: float
    status: str
