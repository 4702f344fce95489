"""What is written down of the targets of one frame: columns and boxes, of rows without a line per target."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from bayesnet_track.engine.lines import Lines
from bayesnet_track.journal.frame_columns import columns_of, narrowed, strings
from bayesnet_track.journal.frame_file import FrameFile
from bayesnet_track.journal.metrics import FrameMetrics, numbers_of
from bayesnet_track.runtime.recording.tracks import Tracked, identity_cells

FEW = 8
"""Hypotheses are written by default in frames of so many targets at most."""
MOST_BOXES = 50_000
"""Boxes of a crowd that are kept as text, too: 1,000 frames of 50 targets."""


def crowd_boxes(frames: Path) -> int:
    """Boxes in those frames of a file that have more than `FEW` targets; raises OSError, JournalError."""
    return sum(place.targets for place in FrameFile(frames).places if place.targets > FEW)


def measured(
    targets: Sequence[FrameMetrics], hypotheses: bool = False
) -> tuple[dict[str, NDArray[Any]], Tracked]:
    """The columns of the targets of a frame, at least one, and their boxes.

    Args:
        targets: what was measured.
        hypotheses: whether to write those of all targets, and all digits, not only of `FEW` in a frame.
    """
    hypotheses |= len(targets) <= FEW
    lines = Lines.of(targets)
    if hypotheses:
        return columns_of(lines, hypotheses), Tracked.of(lines)
    columns = lines.columns()
    if columns is None:
        without = lines.without_hypotheses()
        return columns_of(without, hypotheses), Tracked.of(without)
    return narrowed(dict(columns), precise=False), Tracked(
        int(columns["frame"]),
        float(columns["time_s"]),
        lines.ids,
        lines.places.boxes,
        strings(columns["status"]),
        columns["score"].tolist(),
        columns["ud_px2"].tolist(),
        [name.decode() for name in columns["active"].tolist()],
        [
            {**numbers_of(lines.answers, target), **identity_cells(lines.identities.get(target, {}))}
            for target in lines.ids
        ]
        if lines.answers or lines.identities
        else (),
    )
