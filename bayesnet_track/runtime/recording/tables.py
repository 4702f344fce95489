"""A run as tables: columns with names and units that stay, ready for pandas, CSV and JSON Lines."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.numerics.boxes import corner_from_centre

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
    metrics: Iterable[FrameMetrics], kinds: Mapping[str, str], further: Sequence[str] = ()
) -> list[Row]:
    """Rows of `TRACK_COLUMNS`, then of `further` numbers by name: fields of the state, answers to queries.

    `kinds` is target id -> plate.
    """
    return [
        {name: get(line) for name, get in TRACK_COLUMNS.items()}
        | {"kind": kinds.get(line.target)}
        | {name: line.state.get(name, line.category.get(name, line.queries.get(name))) for name in further}
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
    kept = list(rows)
    return {name: [row[name] for row in kept] for name in names}
