"""A run in other tools' formats: MOT, COCO, CSV, JSON Lines, places on the ground."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesnet_track.journal.blocks import NumberedBoxes, boxes_of
from bayesnet_track.journal.codec import JournalError, to_json
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.runtime.checkpoints.recipe import Recipe, RecipeError
from bayesnet_track.runtime.recording.tables import TRACK_COLUMNS, Row, track_rows
from bayesnet_track.runtime.recording.tracks import LEAST_LENGTH, LEAST_SCORE, MOT_LINE
from bayesnet_track.sources.entrances.notices import notice
from bayesnet_track.sources.paths import SourceError, image_names

if TYPE_CHECKING:
    from bayesnet_track.runtime.recording.run_reader import Run


def as_mot(run: Run, lost: bool = False) -> Iterator[str]:
    """MOT text: ``frame, id, left, top, width, height, score, -1, -1, -1``, frames and ids from 1.

    A long run is read and written some frames at a time.
    """
    return (_mot_text(boxes) for boxes in boxes_of(run.metrics, lost))


def _mot_text(boxes: NumberedBoxes) -> str:
    """Lines ``frame, id, left, top, width, height, score, -1, -1, -1``, frames from 1."""
    corners = np.where(np.abs(boxes.corners) < LEAST_LENGTH, 0.0, boxes.corners)
    scores = np.where(np.abs(boxes.scores) < LEAST_SCORE, 0.0, boxes.scores)
    rows = np.column_stack([boxes.frames + 1, boxes.ids, corners, scores])
    return f"{MOT_LINE}\n" * len(rows) % tuple(rows.ravel().tolist())


def as_csv(run: Run, lost: bool = True) -> str:
    """CSV with a header, the columns of `Run.columns`; an empty cell where there is no value."""
    text = io.StringIO()
    writer = csv.DictWriter(text, run.columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(_rows(run, lost))
    return text.getvalue()


def as_jsonl(run: Run, lost: bool = True) -> str:
    """JSON Lines: an object a row with the columns of `Run.columns`; `active` is a list."""
    lines = []
    for row in _rows(run, lost):
        shown: dict[str, Any] = {**row, "active": str(row["active"]).split()}
        lines.append(json.dumps({name: _finite(value) for name, value in shown.items()}, allow_nan=False))
    return "".join(f"{line}\n" for line in lines)


def as_coco(run: Run, lost: bool = False) -> str:
    """COCO JSON with tracks: images (one per frame), annotations with `track_id` and `score`, categories.

    Categories are the graph's plates, from 1; images are numbered by frame + 1 and named as the images of the
    source, or ``000000.jpg`` by frame where it has none. Boxes are in px from the top-left corner.
    """
    started = run.started
    numbers = _numbers(run)
    plates = {name: number for number, name in enumerate(run.spec.targets, 1)}
    strange = set(run.kinds.values()) - plates.keys()
    if strange:
        raise JournalError(f"{run.directory.journal}: no target type {min(strange)!r} in the run's graph")
    frames = sorted({line.frame for line in run.metrics} | run.seconds.keys())
    names = _image_names(run, frames)
    annotations = [
        {
            "id": number,
            "image_id": line.frame + 1,
            "category_id": plates[run.kinds[line.target]],
            "track_id": numbers[line.target],
            "bbox": [_round(float(value)) for value in line.xywh],
            "area": _round(float(line.xywh[2]) * float(line.xywh[3])),
            "iscrowd": 0,
            "score": _round(line.score, 6),
            "status": line.status,
        }
        for number, line in enumerate(_lines(run, lost), 1)
    ]
    content = {
        "info": {"description": f"tracks of {started.graph} on {started.source}", "version": "1"},
        "licenses": [],
        "videos": [{"id": 1, "name": started.source, "width": started.width, "height": started.height}],
        "images": [
            {
                "id": frame + 1,
                "file_name": names[frame] if names else f"{frame:06d}.jpg",
                "width": started.width,
                "height": started.height,
                "video_id": 1,
                "frame_id": frame,
            }
            for frame in frames
        ],
        "annotations": annotations,
        "categories": [
            {"id": number, "name": name, "supercategory": "target"} for name, number in plates.items()
        ],
    }
    return json.dumps(content, allow_nan=False) + "\n"


def as_frames(run: Run, lost: bool = True) -> str:
    """JSON Lines: all that was measured of a target in a frame, a line each: docs/journal/measurements.md."""
    return "".join(f"{to_json(line)}\n" for line in _lines(run, lost))


WORLD_COLUMNS = ("t", "id", "x", "y", "sd", "speed")


def as_world(run: Run, lost: bool = False) -> str:
    """CSV of places on the ground: ``t, id, x, y, sd, speed``, in s, m and m/s; as a ground truth has them.

    `sd` is that along the longest axis of the ellipse; `speed` is empty where the motion has no velocity.

    Raises:
        JournalError: no target of the run has a place on the ground.
    """
    if not any(plate.is_ground for plate in run.spec.targets.values()):
        raise JournalError(
            f"{run.directory.path}: its targets have places in the image only; world is of graphs with "
            "state: {ground: ..} (docs/metres.md)"
        )
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(WORLD_COLUMNS)
    for line in _lines(run, lost):
        state = line.state
        if "x_m" not in state:
            continue
        across, along = state["x_m_sd"] ** 2, state["y_m_sd"] ** 2
        both = state["xy_corr"] * math.sqrt(across * along)
        longest = (across + along) / 2.0 + math.hypot((across - along) / 2.0, both)
        speed = round(math.hypot(state["vx"], state["vy"]), 4) if "vx" in state else ""
        place = (round(state[name], 4) for name in ("x_m", "y_m"))
        writer.writerow([round(line.time_s, 6), line.target, *place, round(math.sqrt(longest), 4), speed])
    return text.getvalue()


FORMATS: Mapping[str, Callable[[Run, bool], str | Iterator[str]]] = {
    "mot": as_mot,
    "coco": as_coco,
    "csv": as_csv,
    "jsonl": as_jsonl,
    "frames": as_frames,
    "world": as_world,
}


def _image_names(run: Run, frames: Sequence[int]) -> tuple[str, ...]:
    """Names of the image files that the run read; none of another source, or where they are gone."""
    try:
        origin = Recipe.read(run.directory).origin
        part = origin.fingerprint.get("source")
        names = image_names(origin.places()[origin.text], part.files) if part and origin.parts() else ()
        if not names or not frames or len(names) <= frames[-1]:
            return ()
        changes = origin.changes()
    except (RecipeError, OSError, SourceError):
        return ()
    if changes:
        notice(f"{origin.text}: changed since the run; images are named by frame, not by their files")
    return () if changes else names


def _rows(run: Run, lost: bool) -> list[Row]:
    return track_rows(_lines(run, lost), run.kinds, run.columns[len(TRACK_COLUMNS) :])


def _lines(run: Run, lost: bool) -> list[FrameMetrics]:
    return [line for line in run.metrics if lost or not line.is_gone]


def _numbers(run: Run) -> dict[str, int]:
    """Target id -> number, from 1 in the order in which targets appear."""
    return {target: number for number, target in enumerate(run.targets, 1)}


def _round(value: float, digits: int = 3) -> float:
    return round(value, digits) + 0.0


def _finite(value: object) -> object:
    """JSON has no NaN and no infinity."""
    return None if isinstance(value, float) and not math.isfinite(value) else value
