"""Tracks and answers as text: MOT (10 columns) and CSV. Box values are those of the top-left corner.

What is written down of the targets of one frame: columns and boxes, of rows without a line per target.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.motion.modes import mode_key
from bayesnet_track.engine.lines import Lines
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.checks.plates import ground_fields, root_of
from bayesnet_track.graph.settings.queries import query_columns
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.journal.frame_columns import columns_of, narrowed, strings
from bayesnet_track.journal.frame_file import FrameFile
from bayesnet_track.journal.metrics import NOT_SHOWN, Answers, FrameMetrics, QueryAnswer, numbers_of
from bayesnet_track.journal.writer import LineFile
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.cameras import UNSEEN
from bayesnet_track.numerics.outlines import GroundView
from bayesnet_track.observation.planes import Frame
from bayesnet_track.observation.protocols import BOX


def has_only_points(graph: GraphSpec) -> bool:
    """True if targets are points: they have no box, so no line in MOT."""
    return all(plate.state == "point" for plate in graph.targets.values())


def has_csv(graph: GraphSpec) -> bool:
    """True if ``tracks.csv`` is written without being asked for: it holds what ``tracks.txt`` cannot."""
    return has_only_points(graph) or bool(number_columns(graph))


def number_columns(graph: GraphSpec) -> tuple[str, ...]:
    """The columns of ``tracks.csv`` besides `CSV_COLUMNS`: ground states, categories, queries, identities."""
    fields = dict.fromkeys(
        name for plate in graph.targets.values() if plate.is_ground for name in ground_fields(plate)
    )
    ground = (*fields, *(f"{name}_sd" for name in fields), *(("xy_corr",) if fields else ()))
    doubtful = any(plate.identity is not None for plate in graph.targets.values())
    identities = IDENTITY_COLUMNS if doubtful else ()
    return (*ground, *category_columns(graph), *query_columns(graph.queries), *identities)


def category_columns(graph: GraphSpec) -> tuple[str, ...]:
    """`team=red` of each value of each category of the targets."""
    roots = (root_of(target) for target in graph.targets.values())
    written = (root.category for root in roots if root is not None and root.category is not None)
    keys = (
        mode_key(name, value)
        for categories in written
        for name, category in categories.items()
        for value in category.values
    )
    return tuple(dict.fromkeys(keys))


IDENTITY_COLUMNS = ("identity", "identity_p", "other_identity", "other_identity_p")
"""The two most probable identities of a target; empty while it is not doubtful."""


def identity_cells(identities: Mapping[str, float]) -> dict[str, str | float]:
    """The cells of `IDENTITY_COLUMNS` of a target.

    >>> identity_cells({"4": 0.71, "9": 0.22, "new": 0.07})
    {'identity': '4', 'identity_p': 0.71, 'other_identity': '9', 'other_identity_p': 0.22}
    """
    ranked = sorted(identities.items(), key=lambda item: -item[1])[:2]
    cells = (cell for item in ranked for cell in item)
    return dict(zip(IDENTITY_COLUMNS, cells, strict=False))


NO_IDS: Mapping[str, int] = MappingProxyType({})
CSV_COLUMNS = ("frame", "time_s", "target", "x", "y", "w", "h", "status", "score", "ud_px2", "active")


@dataclass(frozen=True, eq=False)
class Tracked:
    """The boxes of one frame.

    Attributes:
        frame: number of the frame.
        time_s: its time.
        targets: T ids.
        boxes: (T, 4) centre boxes, px.
        statuses: of each target.
        scores: of each target, 0..1.
        uds: UD of each target, px^2.
        actives: agents that gave evidence of each target, separated by spaces.
        answers: of each target the answers to queries, fields of its state and what it is, by name.
    """

    frame: int
    time_s: float
    targets: Sequence[str]
    boxes: Floats
    statuses: Sequence[str]
    scores: Sequence[float]
    uds: Sequence[float]
    actives: Sequence[str]
    answers: Sequence[Mapping[str, str | float]] = ()

    @classmethod
    def of(cls, lines: Sequence[FrameMetrics]) -> Self:
        """The boxes of the lines of one frame, at least one."""
        return cls(
            lines[0].frame,
            lines[0].time_s,
            [line.target for line in lines],
            np.array([line.centre_box for line in lines]),
            [line.status for line in lines],
            [line.score for line in lines],
            [line.ud_px2 for line in lines],
            [" ".join(line.active) for line in lines],
            [
                {**line.state, **line.category, **line.queries, **identity_cells(line.identities)}
                for line in lines
            ],
        )

    @cached_property
    def corners(self) -> list[list[float]]:
        """Left, top, width, height of each box; what would be written as -0.000 is 0."""
        boxes = np.array(self.boxes, dtype=np.float64)
        boxes[:, :2] -= (boxes[:, 2:] - 1.0) / 2.0
        boxes[np.abs(boxes) < LEAST_LENGTH] = 0.0
        rows: list[list[float]] = boxes.tolist()
        return rows


class MotWriter(LineFile):
    """MOT text: ``frame, id, left, top, width, height, score, -1, -1, -1``.

    Frames count from 1, ids from 1 in the order in which targets appear. Pixels count from 0, as everywhere
    here; 3 decimals, the score 6. Without `lost`, a target has no line in frames in which it is lost: a box
    that nothing speaks for counts as false where several targets are scored. Nor has one that the first
    camera cannot see. `CsvWriter` has them all. A file that is continued goes on with its `ids`. Of `points`
    there is no line: they have no box.
    """

    def __init__(
        self,
        path: Path,
        lost: bool = True,
        after: int | None = None,
        ids: Mapping[str, int] = NO_IDS,
        points: bool = False,
    ) -> None:
        super().__init__(path, after)
        self._points = points
        self.ids: dict[str, int] = dict(ids)
        self._lost = lost

    def write(self, tracked: Tracked) -> None:
        """Add the lines of one frame to the next flush."""
        if self._points:
            return
        number = tracked.frame + 1
        cells: list[float] = []
        rows = zip(tracked.targets, tracked.statuses, tracked.corners, tracked.scores, strict=True)
        for target, status, corner, score in rows:
            identity = self.ids.setdefault(target, len(self.ids) + 1)
            if corner[0] > UNSEEN[0] and (self._lost or status not in NOT_SHOWN):
                cells += (number, identity, *corner, score if abs(score) >= LEAST_SCORE else 0.0)
        if cells:
            self.append("\n".join([MOT_LINE] * (len(cells) // 7)) % tuple(cells))


@dataclass(frozen=True)
class _Lines:
    """Buffer of whole lines that `csv` writes to."""

    write: Callable[[str], None]


class CsvWriter(LineFile):
    """CSV with the header `CSV_COLUMNS`, then a column for each of `number_columns` of a target.

    frame (from 0), time_s, target, x, y, w, h (top-left corner, width, height, px), status, score (0..1),
    ud_px2, active (agents that gave evidence, separated by spaces). Of `points` w and h are empty;
    of what the first camera cannot see x, y, w and h.
    """

    def __init__(
        self, path: Path, after: int | None = None, queries: Sequence[str] = (), points: bool = False
    ) -> None:
        super().__init__(path, after)
        self._queries, self._points = tuple(queries), points
        if after is None:
            self.append(",".join((*CSV_COLUMNS, *self._queries)))
            self.flush()

    def write(self, tracked: Tracked) -> None:
        """Add the lines of one frame to the next flush."""
        first = (tracked.frame, _fix(tracked.time_s, 6))
        cells: list[Any] = []
        lines: list[str] = []
        rows = zip(
            tracked.targets,
            tracked.corners,
            tracked.statuses,
            tracked.scores,
            tracked.uds,
            tracked.actives,
            self._ends(tracked),
            strict=True,
        )
        for target, corner, status, score, ud, active, end in rows:
            score, ud = score if abs(score) >= LEAST_SCORE else 0.0, ud if abs(ud) >= 0.0005 else 0.0
            is_seen = corner[0] > UNSEEN[0]
            place = () if not is_seen else corner[:2] if self._points else corner
            lines.append(_CSV_UNSEEN if not is_seen else _CSV_OF_POINTS if self._points else _CSV)
            cells += (*first, _cell(target), *place, _cell(status), score, ud, _cell(active) + end)
        self.append("\n".join(lines) % tuple(cells))

    def _ends(self, tracked: Tracked) -> list[str]:
        """The cells of queries of each line."""
        if not self._queries:
            return [""] * len(tracked.targets)
        rows = tracked.answers or [{}] * len(tracked.targets)
        return ["".join(f",{_number_cell(row.get(name))}" for name in self._queries) for row in rows]


MOT_LINE = "%d,%d,%.3f,%.3f,%.3f,%.3f,%.6f,-1,-1,-1"
_CSV = "%d,%s,%s,%.3f,%.3f,%.3f,%.3f,%s,%.6f,%.3f,%s"
_CSV_OF_POINTS = "%d,%s,%s,%.3f,%.3f,,,%s,%.6f,%.3f,%s"
_CSV_UNSEEN = "%d,%s,%s,,,,,%s,%.6f,%.3f,%s"
LEAST_LENGTH, LEAST_SCORE = 0.0005, 0.0000005
"""A length, or a score, below it is written as 0, without a sign."""


@lru_cache(maxsize=4096)
def _cell(text: str) -> str:
    """A text as a cell of CSV, in quotes where it needs them."""
    cells: list[str] = []
    csv.writer(_Lines(cells.append), lineterminator="").writerow((text, 0))
    return cells[0][: -len(",0")]


def _number_cell(value: str | float | None) -> str:
    """A number with six digits, without a sign where it is 0, or a text; empty for none."""
    if isinstance(value, str):
        return _cell(value)
    if value is None or math.isnan(value):
        return ""
    text = f"{value:.6g}"
    return text[1:] if text[0] == "-" and float(text) == 0.0 else text


def _fix(value: float, digits: int) -> str:
    text = f"{value:.{digits}f}"
    return text[1:] if text[0] == "-" and float(text) == 0.0 else text


CAMERA_COLUMNS = ("frame", "time_s", "camera", "camera_frame", "target", "x", "y", "w", "h", "status")

CameraViews = Mapping[str, Mapping[str, GroundView]]
"""Camera -> plate that it sees -> its calibration."""


def views_of_cameras(graph: CheckedGraph) -> CameraViews:
    """The views of a graph with several cameras; nothing of another one."""
    return {
        camera: {
            name: view.camera
            for name, plate in graph.targets.items()
            for view in plate.views.values()
            if view.name == camera
        }
        for camera in graph.several_cameras
    }


class CameraWriter(LineFile):
    """CSV with the header `CAMERA_COLUMNS`: boxes of targets on the ground in the image of each camera.

    A line for each target that the camera has in its image, in the steps in which it has a frame. frame: the
    number of the step, from 0; camera_frame: that of the frame in its own source; x, y, w, h: top-left
    corner, width and height, px, not cut by the border.
    """

    def __init__(self, path: Path, views: CameraViews, size: int | None = None) -> None:
        super().__init__(path, size)
        self._views = views
        if size is None:
            self.append(",".join(CAMERA_COLUMNS))
            self.flush()

    def write(self, frame: Frame, tracked: Tracked, kinds: Mapping[str, str]) -> None:
        """Add the lines of one step to the next flush; `kinds` maps targets to their plates."""
        places = [f"{name}_m" for name in (*BOX, "z")]  # z in space
        states = {
            target: np.array([numbers[name] for name in places if name in numbers])
            for target, numbers in zip(tracked.targets, tracked.answers, strict=True)
            if "x_m" in numbers
        }
        statuses = dict(zip(tracked.targets, tracked.statuses, strict=True))
        for camera, image in (frame.cameras or {}).items():
            first = f"{frame.index},{frame.time_s:.6f},{_cell(camera)},{image.index}"
            for target, state in states.items():
                view = self._views[camera].get(kinds[target])
                box = None if view is None else view.boxes(state[None])[0]
                if box is None or not _is_inside(box, image):
                    continue
                x, y, w, h = (_fix(value, 3) for value in (*(box[:2] - (box[2:] - 1.0) / 2.0), *box[2:]))
                self.append(f"{first},{_cell(target)},{x},{y},{w},{h},{statuses[target]}")


def _is_inside(box: Floats, frame: Frame) -> bool:
    """True if a centre box (4,) touches the frame."""
    middle = np.array([frame.width - 1, frame.height - 1])
    sides = np.array([frame.width, frame.height])
    return bool(np.isfinite(box).all() and (np.abs(2.0 * box[:2] - middle) < box[2:] + sides).all())


QUERY_COLUMNS = ("frame", "time_s", "query", "of", "probability", "mean", "sd", "low", "high", "unit")


class QueryWriter(LineFile):
    """CSV with the header `QUERY_COLUMNS`; a new file, or one that is continued.

    of: the target, both of a pair separated by a space, or ``all`` for the number of all targets together. A
    condition has a probability, a number all others; a cell is empty where no hypothesis has a value.
    """

    def __init__(self, path: Path, size: int | None = None) -> None:
        super().__init__(path, size)
        if size is None:
            self.append(",".join(QUERY_COLUMNS))
            self.flush()

    def write(self, frame: Frame, answers: Iterable[Answers]) -> None:
        """Add the answers of one frame to the next flush."""
        first = f"{frame.index},{frame.time_s:.6f}"
        for answered in answers:
            name = _cell(answered.query)
            for subject, answer in _lines_of(answered):
                self.append(f"{first},{name},{_cell(subject)},{_numbers(answer, _cell(answered.unit))}")


def _lines_of(answered: Answers) -> Iterator[tuple[str, QueryAnswer]]:
    for subject in answered.subjects:
        yield " ".join(subject), answered[subject]
    if answered.total is not None:
        yield "all", answered.total


def _numbers(answer: QueryAnswer, unit: str) -> str:
    if answer.sd is None:
        return f"{_number_cell(answer.mean)},,,,,"
    cells = (answer.mean, answer.sd, answer.low, answer.high)
    return f",{','.join(map(_number_cell, cells))},{unit}"


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
