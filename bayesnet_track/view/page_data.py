"""What the run page shows of a run, from the lines of its files: a header and columns of numbers."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.lives import Returned, TargetStarted
from bayesnet_track.journal.events.runs import RunEnded, RunStarted
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.view.page_tables import event_rows, plates, short_floats

VERSION = 1
STATUSES = ("tracking", "uncertain", "lost", "seen", "hidden", "unwatched")
"""Codes of the columns `status`, also those of parts."""
NUMBERS = ("ud_px2", "score", "log_evidence", "surprise", "ess", "particles", "learn_rate", "angle")
BOXES = {"box": "centre_box", "map": "map", "sd": "sd", "region50": "region50", "region90": "region90"}
"""Column -> field."""
PER_AGENT = ("kl", "contribution", "agent_ud_px2")
CLOUD_POINTS = 600_000
"""Hypotheses in all that a page holds; where a run has more, each frame shows fewer of them."""

Columns = dict[str, NDArray[Any]]


def run_data(
    events: Sequence[Event],
    metrics: Iterable[FrameMetrics],
    timings: Sequence[Mapping[str, Any]] = (),
    graph: CheckedGraph | None = None,
    truth: ArrayLike | None = None,
    name: str = "",
) -> tuple[dict[str, Any], Columns]:
    """Header and columns of a run's page.

    Columns of target i are called `i/NAME` with a row per frame of that target; names are those of
    `export --format frames`, with `agents/NODE/...`, `nodes/NODE/...` and `parts/NODE/...` for what is
    measured of nodes, and `modes/MODE` for the probability of a mode. Columns `run/...` have a row per line
    of the timings.

    Args:
        events: the journal.
        metrics: what was measured, a line per target and frame.
        timings: the lines of ``timings.jsonl``.
        graph: the run's graph; without it the page draws no net and no levels.
        truth: (n, 4) corner boxes of target 1, row i for frame i, NaN where it is absent.
        name: of the run; its graph's stands in for it where it has none.

    Raises:
        ValueError: the journal does not begin with a `run_started`.
    """
    start = events[0] if events else None
    if not isinstance(start, RunStarted):
        raise ValueError("the journal does not begin with run_started")
    by_target: dict[str, list[FrameMetrics]] = {}
    for line in metrics:
        by_target.setdefault(line.target, []).append(line)
    templates = {e.target: e.template for e in events if isinstance(e, TargetStarted | Returned)}
    points = max(1, CLOUD_POINTS // max(1, sum(map(len, by_target.values()))))
    columns: Columns = {}
    targets = []
    for number, (target, lines) in enumerate(by_target.items()):
        columns |= {f"{number}/{name}": column for name, column in _target(lines, points).items()}
        targets.append({"id": target, "plate": templates.get(target, ""), **_names(lines)})
    columns |= {f"run/{name}": column for name, column in _clock(timings).items()}
    about_truth: str | None = None
    if truth is not None:
        about_truth = "1" if "1" in by_target else next(iter(by_target), None)
        columns["run/truth"] = short_floats(np.asarray(truth, dtype=np.float64).reshape(-1, 4))
    header = {
        "version": VERSION,
        "run": {**_description(start, events), "name": name},
        "plates": {} if graph is None else plates(graph, start.costs_ms),
        "targets": targets,
        "events": event_rows(events),
        "truth_target": about_truth,
        "stages": sorted({name for line in timings for name in line["parts"]}),
    }
    return header, columns


def read_timings(path: Path) -> list[dict[str, Any]]:
    """The lines of ``timings.jsonl``; a torn or damaged line and all behind it are left out."""
    rows: list[dict[str, Any]] = []
    if not path.is_file():
        return rows
    with path.open(encoding="utf-8", errors="replace") as file:
        for text in file:
            try:
                line = json.loads(text)
                line = {
                    "frame": np.int32(line["frame"]).item(),
                    "seconds": float(line["seconds"]),
                    "parts": {str(name): float(value) for name, value in line["parts"].items()},
                }
            except (ValueError, TypeError, KeyError, AttributeError, ArithmeticError, RecursionError):
                break
            rows.append(line)
    return rows


def _description(start: RunStarted, events: Sequence[Event]) -> dict[str, Any]:
    ended = events[-1] if isinstance(events[-1], RunEnded) else None
    return {
        "graph": start.graph,
        "graph_sha256": start.graph_sha256,
        "source": start.source,
        "seed": start.seed,
        "width": start.width,
        "height": start.height,
        "declared_frames": start.declared_frames,
        "frame_interval_s": _finite(start.frame_interval_s),
        "versions": dict(start.versions),
        "smoothed": start.smoothed,
        "ended": None if ended is None else {"complete": ended.complete, "reason": ended.reason},
    }


def _names(lines: Sequence[FrameMetrics]) -> dict[str, Any]:
    """The nodes of which anything is measured, in the order in which they appear."""
    agents = dict.fromkeys(name for line in lines for name in line.active)
    nodes = dict.fromkeys(name for line in lines for name in line.ud_nodes)
    parts = dict.fromkeys(name for line in lines for name in line.parts)
    return {
        "agents": list(agents),
        "nodes": list(nodes),
        "parts": list(parts),
        "modes": list(dict.fromkeys(name for line in lines for name in line.modes)),
        "calibrated": any(line.features for line in lines),
    }


def _target(lines: Sequence[FrameMetrics], points: int) -> Columns:
    names = _names(lines)
    columns: Columns = {
        "frame": np.array([line.frame for line in lines], dtype=np.int32),
        "time_s": np.array([line.time_s for line in lines], dtype=np.float64),
        "status": _codes(line.status for line in lines),
        "quiet_px2": short_floats([math.nan if v.quiet_px2 is None else v.quiet_px2 for v in lines]),
    }
    columns |= {name: short_floats([getattr(line, name) for line in lines]) for name in NUMBERS}
    columns |= {name: short_floats([getattr(line, field) for line in lines]) for name, field in BOXES.items()}
    for agent in names["agents"]:
        state = [(agent in line.active) + (agent in line.silent) for line in lines]
        columns[f"agents/{agent}/state"] = np.array(state, dtype=np.uint8)
        columns |= {f"agents/{agent}/{key}": _of_node(lines, key, agent) for key in PER_AGENT}
    for node in names["nodes"]:
        columns[f"nodes/{node}/ud_px2"] = _of_node(lines, "ud_nodes", node)
    for node in dict.fromkeys(name for line in lines for name in line.strength):
        columns[f"nodes/{node}/strength"] = _of_node(lines, "strength", node)
    for part in names["parts"]:
        parts = [line.parts.get(part) for line in lines]
        nothing = (math.nan,) * 4
        columns[f"parts/{part}/box"] = short_floats([nothing if p is None else p.centre_box for p in parts])
        columns[f"parts/{part}/status"] = _codes("unwatched" if p is None else p.status for p in parts)
    columns |= {f"modes/{mode}": _of_node(lines, "modes", mode) for mode in names["modes"]}
    return columns | _clouds(lines, points)


def _clouds(lines: Sequence[FrameMetrics], points: int) -> Columns:
    """`cloud` (m, 4): all hypotheses below each other; `cloud_end` (n,): where those of a frame end."""
    clouds = [[box[:4] for box in line.cloud[:points]] for line in lines]
    flat = np.array([box for cloud in clouds for box in cloud], dtype=np.float64).reshape(-1, 4)
    ends = np.cumsum([len(cloud) for cloud in clouds], dtype=np.int64).astype(np.int32)
    return {"cloud": np.clip(flat, -32768, 32767).astype(np.int16), "cloud_end": ends}


def _clock(timings: Sequence[Mapping[str, Any]]) -> Columns:
    columns: Columns = {
        "frame": np.array([line["frame"] for line in timings], dtype=np.int32),
        "ms": short_floats([1e3 * line["seconds"] for line in timings]),
    }
    for stage in sorted({name for line in timings for name in line["parts"]}):
        columns[f"stages/{stage}"] = short_floats([1e3 * line["parts"].get(stage, 0.0) for line in timings])
    return columns


def _of_node(lines: Sequence[FrameMetrics], key: str, node: str) -> NDArray[np.float32]:
    return short_floats([getattr(line, key).get(node, math.nan) for line in lines])


def _codes(statuses: Iterable[str]) -> NDArray[np.uint8]:
    return np.array([STATUSES.index(s) if s in STATUSES else 0 for s in statuses], dtype=np.uint8)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
