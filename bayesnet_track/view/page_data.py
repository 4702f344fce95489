"""Content of the run page, from the lines of a run: a header and columns of numbers."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayesnet_track.graph.checked import CheckedGraph, CheckedTarget
from bayesnet_track.graph.checks.cameras import AnyCalibration
from bayesnet_track.graph.settings.queries import Query
from bayesnet_track.journal.blocks import CLOUD, Block, Blocks, Course, courses
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.lives import Returned, TargetStarted
from bayesnet_track.journal.events.runs import RunEnded, RunStarted
from bayesnet_track.journal.frame_columns import is_absent
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.cameras import Camera
from bayesnet_track.view.overlay import FARTHEST_M
from bayesnet_track.view.page_tables import choose_rows, event_rows, plates, short_floats

VERSION = 1
STATUSES = ("tracking", "uncertain", "lost", "seen", "hidden", "unwatched")
"""Codes of the columns `status`, also those of parts."""
NUMBERS = ("ud_px2", "score", "log_evidence", "surprise", "ess", "particles", "learn_rate")
BOXES = ("box", "map", "sd", "region50", "region90")
PER_AGENT = ("kl", "contribution", "agent_ud_px2")
CLOUD_POINTS = 600_000
"""Hypotheses in all that a page holds; where a run has more, each frame shows fewer of them."""

READ = (
    *(*NUMBERS, *BOXES, "time_s", "angle", "quiet_px2", "status", "active", "silent", CLOUD, "cloud_count"),
    *("ud_nodes/", "kl/", "contribution/", "agent_ud_px2/", "strength/", "modes/", "features/", "parts/"),
    *("queries/", "identities"),
)
"""Columns of ``frames.npy.gz`` that a page shows."""

Columns = dict[str, NDArray[Any]]


def run_data(
    events: Sequence[Event],
    metrics: Sequence[FrameMetrics],
    timings: Sequence[Mapping[str, Any]] = (),
    graph: CheckedGraph | None = None,
    truth: ArrayLike | None = None,
    name: str = "",
) -> tuple[dict[str, Any], Columns]:
    """Header and columns of a run's page.

    Columns of target i are called `i/NAME` with a row per frame of that target; names are those of
    `export --format frames`, with `agents/NODE/...`, `nodes/NODE/...` and `parts/NODE/...` for what is
    measured of nodes, `modes/MODE` for the probability of a mode, `queries/NAME` for the numbers that answer
    a query, and `identities/NAME` for the probability that the target is NAME. Columns `run/...` have a row
    per line of the timings. Of a long run only some rows are shown, see `choose`.

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
    seen_by = {} if graph is None else graph.several_cameras
    blocks = Blocks(metrics, (*READ, "state/") if seen_by else READ)
    selection = choose_rows(blocks, events)
    templates = {e.target: e.template for e in events if isinstance(e, TargetStarted | Returned)}
    points = max(1, CLOUD_POINTS // max(1, len(selection.rows)))
    columns: Columns = {}
    targets = []
    ids = blocks.texts["target"].texts
    for number, target in enumerate(ids):
        rows = selection.rows.of_rows(np.flatnonzero(selection.rows.codes("target") == number))
        names = _names(rows, blocks)
        columns |= {
            f"{number}/{name}": column for name, column in _target(rows, names, blocks, points).items()
        }
        if graph is not None and seen_by and target in templates:
            on_ground = _on_ground(rows, graph.targets[templates[target]])
            columns |= {f"{number}/{name}": column for name, column in on_ground.items()}
        targets.append(
            {"id": target, "plate": templates.get(target, ""), **names, **selection.counted(target)}
        )
    columns |= {f"run/{name}": column for name, column in _clock(timings).items()}
    about_truth: str | None = None
    if truth is not None:
        about_truth = "1" if "1" in ids else next(iter(ids), None)
        columns["run/truth"] = short_floats(np.asarray(truth, dtype=np.float64).reshape(-1, 4))
    header = {
        "version": VERSION,
        "run": {**_description(start, events), "name": name},
        "plates": {} if graph is None else plates(graph, start.costs_ms),
        "queries": {} if graph is None else _queries(graph),
        "targets": targets,
        "events": event_rows(events),
        "truth_target": about_truth,
        "thinned": selection.about,
        "stages": sorted({name for line in timings for name in line["parts"]}),
    }
    if graph is not None and seen_by:
        header["cameras"] = [_camera(graph, name, (start.width, start.height)) for name in seen_by]
    return header, columns


def _on_ground(rows: Block, plate: CheckedTarget) -> Columns:
    """Columns of a target on the ground, which several cameras see.

    `ground` (n, 5): x, y, sd of x, sd of y, m, and their correlation. `cameras/NAME` (n, 4): its centre box
    in the image of a camera, px, with the mean of the camera's bias; nan where it cannot be seen.
    """
    if "state/x_m" not in rows.columns:
        return {}
    moments = ("x_m", "y_m", "x_m_sd", "y_m_sd", "xy_corr")
    columns = {"ground": short_floats(np.stack([rows.numbers(f"state/{name}") for name in moments], axis=1))}
    axes = ("x", "y", "w", "h", "z") if plate.spec.is_space else ("x", "y", "w", "h")
    states = np.stack([rows.numbers(f"state/{name}_m") for name in axes], axis=1)
    for node, view in plate.views.items():
        boxes = np.asarray(view.camera.boxes(states), dtype=np.float64)
        for column, axis in enumerate(("x", "y")):
            if f"state/{node}.{axis}" in rows.columns:
                boxes[:, column] += rows.numbers(f"state/{node}.{axis}")
        boxes[~np.isfinite(boxes).all(axis=1)] = np.nan
        if view.camera != AnyCalibration()[""].camera:
            columns[f"cameras/{view.name}"] = short_floats(boxes)
    return columns


def _camera(graph: CheckedGraph, name: str, first_size: tuple[int, int]) -> dict[str, Any]:
    """A camera as plain data: size of its image, px; where it stands, and what it sees of the ground, m.

    `at` is None where that is not known, and `field`, corners of a polygon, is empty.
    """
    camera = graph.calibrations[graph.spec.cameras[name].key].camera
    if camera == AnyCalibration()[""].camera:
        return {"name": name, "width": first_size[0], "height": first_size[1], "at": None, "field": []}
    width, height = camera.size or first_size
    place = camera.centre[:2].tolist() if isinstance(camera, Camera) else None
    # From the lowest to the highest pixel of each column of the image that shows the ground near by.
    columns, rows = np.meshgrid(np.linspace(0, width - 1, 25), np.linspace(height - 1, 0, 90), indexing="ij")
    ground = camera.ground_points(np.column_stack([columns.ravel(), rows.ravel()])).reshape(25, 90, 2)
    nearest = np.array(place) if place else np.nanmedian(ground[:, :10].reshape(-1, 2), axis=0)
    with np.errstate(invalid="ignore"):
        is_near = np.hypot(*np.moveaxis(ground - nearest, -1, 0)) < FARTHEST_M
    low = [column[k][0] for column, k in zip(ground, is_near, strict=True) if k.any()]
    high = [column[k][-1] for column, k in zip(ground, is_near, strict=True) if k.any()]
    field = [[round(float(x), 3), round(float(y), 3)] for x, y in (*low, *reversed(high))]
    return {"name": name, "width": width, "height": height, "at": place, "field": field}


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


def _queries(graph: CheckedGraph) -> dict[str, dict[str, Any]]:
    """Query -> its kind, what it asks, unit, level of its event, and corners [x, y] in px, as plain data."""
    return {
        name: {
            "kind": query.kind,
            "of": list(query.kinds),
            "asks": _question(query),
            "unit": query.unit or "",
            "interval": query.interval,
            "level": query.event_above,
            "corners": _corners(query),
        }
        for name, query in graph.spec.queries.items()
    }


def _question(query: Query) -> str:
    if query.crosses is not None:
        side = query.crosses.side
        return "crosses the line" + ("" if side == "either" else f" from the {side}")
    if query.count is not None:
        return query.count.condition or f"{query.count.point} is in the polygon"
    return query.probability or query.value or ""


def _corners(query: Query) -> list[list[float]]:
    if query.crosses is not None:
        return [list(point) for point in query.crosses.line]
    if query.count is not None and isinstance(query.count.polygon, tuple):
        return [list(point) for point in query.count.polygon]
    return []


def _names(rows: Block, blocks: Blocks) -> dict[str, Any]:
    """The nodes of which anything is measured, in the order in which they appear."""
    codes, first = np.unique(rows.codes("active"), return_index=True)
    groups = [blocks.texts["active"].texts[code].split() for code in codes[np.argsort(first)].tolist()]
    statuses = [name for name in rows.columns if name.startswith("parts/") and name.endswith("/status")]
    parts = [name[len("parts/") : -len("/status")] for name in statuses if _watched(rows, blocks, name).any()]
    return {
        "agents": list(dict.fromkeys(agent for group in groups for agent in group)),
        "nodes": _measured(rows, "ud_nodes"),
        "parts": parts,
        "modes": _bands(rows),
        "queries": _measured(rows, "queries"),
        "identities": list(dict.fromkeys(name for shares in _identities(rows, blocks) for name in shares)),
        "calibrated": bool(_measured(rows, "features")),
    }


def _bands(rows: Block) -> list[str]:
    """Names of bands that fill 0 to 1: the modes, else the values of the first category."""
    modes, values = _measured(rows, "modes"), _measured(rows, "category")
    first = values[0].partition("=")[0] if values else ""
    return modes or [value for value in values if value.startswith(f"{first}=")]


def _measured(rows: Block, field: str) -> list[str]:
    """The nodes for which a field has a value in any row."""
    names = [name for name in rows.columns if name.startswith(f"{field}/")]
    return [name[len(field) + 1 :] for name in names if not is_absent(rows.numbers(name)).all()]


def _identities(rows: Block, blocks: Blocks) -> list[dict[str, float]]:
    """Identities that the target may have, with probabilities, of each row; none where it is not doubtful."""
    if "identities" not in rows.columns:
        return []
    shares = [json.loads(text) if text else {} for text in blocks.texts["identities"].texts]
    return [shares[code] for code in rows.codes("identities").tolist()]


def _watched(rows: Block, blocks: Blocks, name: str) -> NDArray[np.bool_]:
    return np.array([bool(text) for text in blocks.texts[name].texts], dtype=bool)[rows.codes(name)]


def _target(rows: Block, names: Mapping[str, Any], blocks: Blocks, points: int) -> Columns:
    angle = rows.numbers("angle")
    columns: Columns = {
        "frame": rows.frame.astype(np.int32),
        "time_s": rows.numbers("time_s"),
        "status": _codes(rows, blocks, "status"),
        "quiet_px2": _number(rows, "quiet_px2"),
    }
    columns |= {name: _number(rows, name) for name in NUMBERS}
    columns["angle"] = short_floats(np.where(is_absent(angle), 0.0, angle))
    columns |= {name: short_floats(rows.numbers(name).T) for name in BOXES}
    for agent in names["agents"]:
        state = _holds(rows, blocks, "active", agent).astype(np.uint8) + _holds(rows, blocks, "silent", agent)
        columns[f"agents/{agent}/state"] = state
        columns |= {f"agents/{agent}/{key}": _number(rows, f"{key}/{agent}") for key in PER_AGENT}
    for node in names["nodes"]:
        columns[f"nodes/{node}/ud_px2"] = _number(rows, f"ud_nodes/{node}")
    for node in _measured(rows, "strength"):
        columns[f"nodes/{node}/strength"] = _number(rows, f"strength/{node}")
    for part in names["parts"]:
        is_watched = _watched(rows, blocks, f"parts/{part}/status")
        box = np.where(is_watched, rows.numbers(f"parts/{part}/box"), np.nan)
        columns[f"parts/{part}/box"] = short_floats(box.T)
        status = _codes(rows, blocks, f"parts/{part}/status")
        columns[f"parts/{part}/status"] = np.where(is_watched, status, STATUSES.index("unwatched")).astype(
            np.uint8
        )
    for name in names["modes"]:
        columns[f"modes/{name}"] = _number(rows, f"{'category' if '=' in name else 'modes'}/{name}")
    columns |= {f"queries/{name}": _number(rows, f"queries/{name}") for name in names["queries"]}
    shares = _identities(rows, blocks) if names["identities"] else []
    columns |= {
        f"identities/{name}": short_floats([row.get(name, np.nan) for row in shares])
        for name in names["identities"]
    }
    return columns | _clouds(rows, points)


def _clouds(rows: Block, points: int) -> Columns:
    """`cloud` (m, 4): all hypotheses below each other; `cloud_end` (n,): where those of a frame end."""
    counts = rows.columns.get("cloud_count", np.zeros(len(rows))).astype(np.int64)
    limited = np.minimum(counts, points)
    index_in_frame = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    flat = rows.columns.get(CLOUD, np.zeros((4, 0)))[:, index_in_frame < np.repeat(limited, counts)]
    cloud = np.clip(flat, -32768, 32767).astype(np.int16).T
    return {"cloud": np.ascontiguousarray(cloud), "cloud_end": np.cumsum(limited).astype(np.int32)}


def _clock(timings: Sequence[Mapping[str, Any]]) -> Columns:
    columns: Columns = {
        "frame": np.array([line["frame"] for line in timings], dtype=np.int32),
        "ms": short_floats([1e3 * line["seconds"] for line in timings]),
    }
    for stage in sorted({name for line in timings for name in line["parts"]}):
        columns[f"stages/{stage}"] = short_floats([1e3 * line["parts"].get(stage, 0.0) for line in timings])
    return columns


def _number(rows: Block, name: str) -> NDArray[np.float32]:
    values = rows.numbers(name)
    return short_floats(np.where(np.isnan(values), np.nan, values))


def _holds(rows: Block, blocks: Blocks, name: str, agent: str) -> NDArray[np.bool_]:
    """(N,) whether a column of names has this one."""
    texts = blocks.texts[name].texts
    return np.array([agent in text.split() for text in texts], dtype=bool)[rows.codes(name)]


def _codes(rows: Block, blocks: Blocks, name: str) -> NDArray[np.uint8]:
    texts = blocks.texts[name].texts
    codes = [STATUSES.index(text) if text in STATUSES else 0 for text in texts]
    return np.array(codes, dtype=np.uint8)[rows.codes(name)]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


COLUMNS = ("ud_px2", "quiet_px2", "status", "active")


@dataclass(frozen=True, eq=False)
class History:
    """One target's frames, in order.

    Attributes:
        frame: (N,) in which it lives.
        ud_px2: (N,) UD of its root.
        quiet_px2: (N,) the baseline of UD; NaN where there is none.
        is_lost: (N,) whether it counts as lost.
        actives: groups of agents that were active together.
        active: (N,) index of the frame's group.
    """

    frame: NDArray[np.int64]
    ud_px2: Floats
    quiet_px2: Floats
    is_lost: NDArray[np.bool_]
    actives: Sequence[tuple[str, ...]]
    active: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def agents(self) -> tuple[str, ...]:
        """The agents that are active in any frame, in the order of the first."""
        codes, first = np.unique(self.active, return_index=True)
        ordered = codes[np.argsort(first)].tolist()
        return tuple(dict.fromkeys(name for code in ordered for name in self.actives[code]))

    def is_active(self, agent: str) -> NDArray[np.bool_]:
        """(N,) whether an agent is active."""
        return np.array([agent in group for group in self.actives], dtype=bool)[self.active]

    def stretches(self, mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
        """Stretches of successive rows of a mask, as first and last frame."""
        edges = np.diff(mask.astype(np.int8), prepend=0, append=0)
        first, final = self.frame[edges[:-1] > 0], self.frame[edges[1:] < 0]
        return [*zip(first.tolist(), final.tolist(), strict=True)]


def histories(metrics: Sequence[FrameMetrics], targets: Iterable[str]) -> dict[str, History]:
    """The histories of some targets, read in one pass; empty ones of those without measurements."""
    return {name: _history(course) for name, course in courses(metrics, COLUMNS, targets).items()}


def _history(course: Course) -> History:
    return History(
        frame=course.frame,
        ud_px2=course.numbers("ud_px2"),
        quiet_px2=course.numbers("quiet_px2"),
        is_lost=course.is_gone,
        actives=[tuple(text.split()) for text in course.texts.get("active", ())],
        active=course.block.codes("active"),
    )
