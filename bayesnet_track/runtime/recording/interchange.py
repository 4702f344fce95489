"""Tracks in the shape that other tools take: corners, confidence, class, identity, and the rest by name.

A run as tables: columns with names and units that stay, ready for pandas, CSV and JSON Lines.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.numerics.boxes import corner_from_centre, xyxy_from_centre

Value = int | float | str | bool | None
Row = dict[str, Value]


def _corner(axis: int) -> Callable[[FrameMetrics], float]:
    return lambda line: float(corner_from_centre(line.centre_box)[axis])


def _field(name: str, index: int | None = None) -> Callable[[FrameMetrics], Value]:
    def get(line: FrameMetrics) -> Value:
        value = getattr(line, name)
        return value if index is None else value[index] if index < len(value) else None

    return get


TRACK_COLUMNS: Mapping[str, Callable[[FrameMetrics], Value]] = {
    "frame": _field("frame"),
    "time_s": _field("time_s"),
    "target": _field("target"),
    "kind": lambda line: None,
    "x": _corner(0),
    "y": _corner(1),
    "w": _field("centre_box", 2),
    "h": _field("centre_box", 3),
    "angle": _field("angle"),
    "status": _field("status"),
    "score": _field("score"),
    "ud_px2": _field("ud_px2"),
    "quiet_px2": _field("quiet_px2"),
    "sd_x": _field("sd", 0),
    "sd_y": _field("sd", 1),
    "sd_w": _field("sd", 2),
    "sd_h": _field("sd", 3),
    "log_evidence": _field("log_evidence"),
    "surprise": _field("surprise"),
    "ess": _field("ess"),
    "particles": _field("particles"),
    "learn_rate": _field("learn_rate"),
    "active": lambda line: " ".join(line.active),
}
"""Column -> its value. One row per live target and frame; x, y, w, h is the top-left corner box in px."""

AGENT_COLUMNS = ("frame", "time_s", "target", "agent", "silent", "kl", "contribution", "ud_px2", "strength")
"""One row per active agent: nats, but ud_px2. None where it was not measured."""


def track_rows(
    metrics: Iterable[FrameMetrics], kinds: Mapping[str, str], extra: Sequence[str] = ()
) -> list[Row]:
    """Rows of `TRACK_COLUMNS`, then of `extra` numbers by name: fields of the state, answers to queries.

    `kinds` is target id -> plate.
    """
    return [
        {name: get(line) for name, get in TRACK_COLUMNS.items()}
        | {"kind": kinds.get(line.target)}
        | {name: line.state.get(name, line.category.get(name, line.queries.get(name))) for name in extra}
        for line in metrics
    ]


def agent_rows(metrics: Iterable[FrameMetrics]) -> list[Row]:
    """Rows of `AGENT_COLUMNS`."""
    return [
        {
            "frame": line.frame,
            "time_s": line.time_s,
            "target": line.target,
            "agent": agent,
            "silent": agent in line.silent,
            "kl": line.kl.get(agent),
            "contribution": line.contribution.get(agent),
            "ud_px2": line.agent_ud_px2.get(agent),
            "strength": line.strength.get(agent),
        }
        for line in metrics
        for agent in line.active
    ]


def columns(rows: Iterable[Row], names: Iterable[str]) -> dict[str, list[Any]]:
    """Rows as columns, as `pandas.DataFrame` takes them; the columns are there without a row, too."""
    row_list = list(rows)
    return {name: [row[name] for row in row_list] for name in names}


@dataclass(frozen=True, eq=False, repr=False)
class Detections:
    """n boxes of targets, as arrays side by side; the fields are those of supervision's `Detections`.

    Attributes:
        xyxy: (n, 4) float64, left, top, right, bottom in px.
        confidence: (n,) float64, the score: a probability of being on target where the graph is calibrated.
        class_id: (n,) int64, number of the target's plate in the graph, from 0.
        tracker_id: (n,) int64, the target.
        data: name -> (n,) array: target (its id), class_name (its plate), status, ud_px2, frame, time_s.
    """

    xyxy: NDArray[np.float64]
    confidence: NDArray[np.float64]
    class_id: NDArray[np.int64]
    tracker_id: NDArray[np.int64]
    data: Mapping[str, NDArray[Any]] = field(default_factory=lambda: MappingProxyType({}))

    @classmethod
    def of(
        cls,
        metrics: Iterable[FrameMetrics],
        kinds: Mapping[str, str] | None = None,
        classes: Sequence[str] | None = None,
        lost: bool = False,
    ) -> Detections:
        """The boxes of measured targets, as `track` yields them or a run keeps them.

        Args:
            metrics: lines of any targets and frames.
            kinds: target id -> plate; `Result.kinds`, `Run.kinds`. All of one class when None.
            classes: plates in the order of their numbers; those of `kinds` as they come when None.
            lost: True for the boxes of lost targets, too.
        """
        lines = [line for line in metrics if lost or not line.is_gone]
        plates = ["" if kinds is None else kinds.get(line.target, "") for line in lines]
        class_names = list(dict.fromkeys((kinds or {}).values())) if classes is None else list(classes)
        numbers = {name: number for number, name in enumerate(class_names)}
        centres = np.array([line.centre_box for line in lines], dtype=np.float64).reshape(-1, 4)
        columns: Mapping[str, tuple[list[Any], Any]] = {
            "target": ([line.target for line in lines], np.str_),
            "class_name": (plates, np.str_),
            "status": ([line.status for line in lines], np.str_),
            "ud_px2": ([line.ud_px2 for line in lines], np.float64),
            "frame": ([line.frame for line in lines], np.int64),
            "time_s": ([line.time_s for line in lines], np.float64),
        }
        return cls(
            xyxy=xyxy_from_centre(centres),
            confidence=np.array([line.score for line in lines], dtype=np.float64),
            class_id=np.array([numbers.get(plate, 0) for plate in plates], dtype=np.int64),
            tracker_id=np.array([int(line.target) for line in lines], dtype=np.int64),
            data={name: np.array(column, dtype=kind) for name, (column, kind) in columns.items()},
        )

    def to_supervision(self) -> Any:
        """The same as `supervision.Detections`.

        Raises:
            ImportError: supervision is not installed.
        """
        try:
            import supervision
        except ImportError as error:
            raise ImportError("supervision is not installed; pip install supervision") from error
        return supervision.Detections(
            xyxy=self.xyxy,
            confidence=self.confidence,
            class_id=self.class_id,
            tracker_id=self.tracker_id,
            data=dict(self.data),
        )

    def __repr__(self) -> str:
        """Number of targets, and who they are."""
        return f"<Detections: {len(self)}, tracker_id {self.tracker_id.tolist()}>"

    def __len__(self) -> int:
        return len(self.xyxy)

    def __iter__(self) -> Iterator[tuple[NDArray[np.float64], float, int, int, dict[str, Any]]]:
        """Box by box: (4,) corners, confidence, class_id, tracker_id, data."""
        for k in range(len(self)):
            data = {name: column[k] for name, column in self.data.items()}
            yield (
                self.xyxy[k],
                float(self.confidence[k]),
                int(self.class_id[k]),
                int(self.tracker_id[k]),
                data,
            )
