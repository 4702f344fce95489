"""What is written down of the targets of one frame: columns and boxes, of rows without a line per target."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from numpy.typing import NDArray

from bayesnet_track.engine.rows.row_metrics import RowMetrics
from bayesnet_track.journal.frame_columns import columns_of, narrowed, strings
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.runtime.recording.tracks import Tracked

FEW = 8
"""Hypotheses are written by default in frames of so many targets at most."""


def measured(
    targets: Sequence[FrameMetrics], hypotheses: bool = False
) -> tuple[dict[str, NDArray[Any]], Tracked]:
    """The columns of the targets of a frame, at least one, and their boxes.

    Args:
        targets: what was measured.
        hypotheses: whether to write those of all targets, not only of `FEW` in a frame.
    """
    hypotheses |= len(targets) <= FEW
    if isinstance(targets, RowMetrics) and not hypotheses:
        if targets.born:
            lines = targets.without_clouds()
            return columns_of(lines, False), Tracked.of(lines)
        columns = targets.columns()
        return narrowed(columns), Tracked(
            int(columns["frame"]),
            float(columns["time_s"]),
            targets.rows.ids,
            targets.boxes,
            strings(columns["status"]),
            columns["score"].tolist(),
            columns["ud_px2"].tolist(),
            [targets.rows.rule.agent] * len(targets),
        )
    return columns_of(targets, hypotheses), Tracked.of(targets)
