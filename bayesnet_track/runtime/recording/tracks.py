"""The track as text: MOT (10 columns) and CSV. Box values are the top-left corner's, as OpenCV has it."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.writer import LineFile

NO_IDS: Mapping[str, int] = MappingProxyType({})
CSV_COLUMNS = ("frame", "time_s", "target", "x", "y", "w", "h", "status", "score", "ud_px2", "active")


def mot_line(metrics: FrameMetrics, number: int) -> str:
    """``frame, id, left, top, width, height, score, -1, -1, -1`` of a target with that number."""
    box = ",".join(_corner(metrics))
    return f"{metrics.frame + 1},{number},{box},{_fix(metrics.score, 6)},-1,-1,-1"


class MotWriter(LineFile):
    """MOT text: ``frame, id, left, top, width, height, score, -1, -1, -1``.

    Frames count from 1, ids from 1 in the order in which targets appear. Pixels count from 0, as everywhere
    here; 3 decimals, the score 6. Without `lost`, a target has no line in frames in which it is lost: a box
    that nothing speaks for counts as false where several targets are scored. `CsvWriter` has them all. A file
    that is continued goes on with its `ids`.
    """

    def __init__(
        self, path: Path, lost: bool = True, after: int | None = None, ids: Mapping[str, int] = NO_IDS
    ) -> None:
        super().__init__(path, after)
        self.ids: dict[str, int] = dict(ids)
        self._lost = lost

    def write(self, metrics: FrameMetrics) -> None:
        """Add the line of one target in one frame to the next flush."""
        number = self.ids.setdefault(metrics.target, len(self.ids) + 1)
        if metrics.status == "lost" and not self._lost:
            return
        self.append(mot_line(metrics, number))


@dataclass(frozen=True)
class _Lines:
    """Where `csv` writes: whole lines."""

    write: Callable[[str], None]


class CsvWriter(LineFile):
    """CSV with the header `CSV_COLUMNS`.

    frame (from 0), time_s, target, x, y, w, h (top-left corner, width, height, px), status, score (0..1),
    ud_px2, active (agents that gave evidence, separated by spaces).
    """

    def __init__(self, path: Path, after: int | None = None) -> None:
        super().__init__(path, after)
        self._rows = csv.writer(_Lines(self.append), lineterminator="")
        if after is None:
            self.append(",".join(CSV_COLUMNS))
            self.flush()

    def write(self, metrics: FrameMetrics) -> None:
        """Add the line of one target in one frame to the next flush."""
        self._rows.writerow(
            (
                metrics.frame,
                _fix(metrics.time_s, 6),
                metrics.target,
                *_corner(metrics),
                metrics.status,
                _fix(metrics.score, 6),
                _fix(metrics.ud_px2, 3),
                " ".join(metrics.active),
            )
        )


def _corner(metrics: FrameMetrics) -> list[str]:
    x, y, w, h = metrics.centre_box
    return [_fix(value, 3) for value in (x - (w - 1.0) / 2.0, y - (h - 1.0) / 2.0, w, h)]


def _fix(value: float, digits: int) -> str:
    text = f"{value:.{digits}f}"
    return text[1:] if text[0] == "-" and float(text) == 0.0 else text
