"""A run in other tools' formats: MOT, COCO, CSV, JSON Lines, places on the ground.

A run that is over, judged as a whole: which of its frames its guarantee lets be called tracking.

A run's beliefs as draws: an xarray `Dataset`, and the netCDF file that ArviZ reads.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.gaussian.belief import GaussianPosterior
from bayesnet_track.belief.gaussian.modal import ModalPosterior
from bayesnet_track.engine.scoring.outcome import level_afterwards, means_of
from bayesnet_track.graph.spec import Guarantee, InferenceNode, Target
from bayesnet_track.journal.blocks import NumberedBoxes, boxes_of
from bayesnet_track.journal.codec import JournalError, to_json
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.writer import PART
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.gaussian import root
from bayesnet_track.numerics.resampling import systematic
from bayesnet_track.numerics.streams import Streams
from bayesnet_track.observation.settings import setting
from bayesnet_track.runtime.checkpoints.recipe import Recipe, RecipeError
from bayesnet_track.runtime.recording.beliefs import KeptPosterior
from bayesnet_track.runtime.recording.interchange import TRACK_COLUMNS, Row, track_rows
from bayesnet_track.runtime.recording.run_reader import Run
from bayesnet_track.runtime.recording.tracks import LEAST_LENGTH, LEAST_SCORE, MOT_LINE
from bayesnet_track.runtime.resizing import Resizing
from bayesnet_track.runtime.smoothing import kept_lifetimes
from bayesnet_track.sources.entrances.notices import notice
from bayesnet_track.sources.paths import SourceError, image_names

MAX_NUMBERS = 250_000_000
"""Largest number of values of the whole set, 1 GB as float32."""


class ArvizError(ValueError):
    """A run that cannot be written for ArviZ, with the cure."""


def write_arviz(run: Run, path: Path, draws: int = 500, seed: int = 0) -> None:
    """Write `beliefs_as_dataset` as the group `posterior` of a netCDF file, whole or not at all.

    Raises:
        ArvizError: xarray or h5netcdf is not installed, or there would be too many numbers.
        KeptBeliefsError: the run kept no beliefs, or has been smoothed.
        JournalError: beliefs.jsonl is damaged.
        OSError: the file cannot be written.

    ::

        write_arviz(open_run("runs/one"), Path("one.nc"))
        arviz.from_netcdf("one.nc").posterior
    """
    dataset, part = beliefs_as_dataset(run, draws, seed), path.with_name(path.name + PART)
    try:
        dataset.to_netcdf(part, group="posterior", engine="h5netcdf")
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def beliefs_as_dataset(run: Run, draws: int = 500, seed: int = 0) -> Any:
    """Draws of each frame's belief, and the agents' log-likelihoods of them; errors as `write_arviz`.

    Over chain, draw, target, frame: the fields of the state, in px of the source, and `log_likelihood_AGENT`.
    Over target, frame: `measured_AGENT_FIELD`. NaN where the target, the agent or its measurement is absent.
    """
    xarray = _xarray()
    frames = {
        frame: n for n, frame in enumerate(sorted({line.frame for line in run.metrics} | {*run.seconds}))
    }
    targets = {target: n for n, target in enumerate(run.targets)}
    shape, streams, resizing = (1, draws, len(targets), len(frames)), Streams(seed), Resizing.of(run.started)
    variables: dict[str, NDArray[np.float32]] = {}

    def put(name: str, target: str, frame: int, values: Floats) -> None:
        if name not in variables:
            if (len(variables) + 1) * int(np.prod(shape)) > MAX_NUMBERS:
                raise ArvizError(
                    f"{draws} draws of {len(targets)} targets in {len(frames)} frames are more than "
                    f"{MAX_NUMBERS:,} numbers; take fewer draws ({setting('--draws', 'N')})"
                )
            variables[name] = np.full(shape if values.ndim else shape[2:], np.nan, dtype=np.float32)
        variables[name][..., targets[target], frames[frame]] = values

    for belief in (belief for lifetime in kept_lifetimes(run) for belief in lifetime):
        key = belief.target, belief.frame
        states, picks = _draw(belief.posterior, draws, streams.of(*key[:1], "", belief.frame, "arviz"))
        for name, values in zip(belief.posterior.fields, states.T, strict=True):
            put(name, *key, resizing.field(name, values))
        for agent, likelihoods in belief.heard.log_likelihoods.items():
            put(f"log_likelihood_{agent}", *key, likelihoods[picks])
        for agent, measurement in belief.heard.measured.items():
            for name, value in zip(measurement.fields, measurement.mean, strict=True):
                put(f"measured_{agent}_{name}", *key, resizing.field(name, np.asarray(value)))
    times = {line.frame: line.time_s for line in run.metrics}
    return xarray.Dataset(
        {name: (("chain", "draw", "target", "frame")[4 - v.ndim :], v) for name, v in variables.items()},
        {
            "chain": [0],
            "draw": np.arange(draws),
            "target": list(targets),
            "frame": list(frames),
            "kind": ("target", [run.kinds[target] for target in targets]),
            "time_s": ("frame", [times.get(frame, np.nan) for frame in frames]),
        },
        {"inference_library": "bayesnet_track", "graph": run.started.graph, "source": run.started.source},
    )


def _draw(posterior: KeptPosterior, draws: int, rng: np.random.Generator) -> tuple[Floats, NDArray[np.intp]]:
    """(draws, D) states in any order, and (draws,) which particles they are."""
    if isinstance(posterior, ModalPosterior):
        shares = posterior.mode_probabilities
        counts = rng.multinomial(draws, shares / shares.sum()).tolist()
        samples = [_draw(part, count, rng)[0] for part, count in zip(posterior.parts, counts, strict=True)]
        return rng.permutation(np.concatenate(samples)), np.empty(0, dtype=np.intp)
    if isinstance(posterior, GaussianPosterior):
        lower = root(posterior.covariance)
        states = posterior.mean + rng.standard_normal((draws, lower.shape[1])) @ lower.T
        states[:, 2:4] = np.maximum(states[:, 2:4], 1.0)
        return states, np.empty(0, dtype=np.intp)
    picks = rng.permutation(systematic(posterior.weights.weights, draws, rng))
    return posterior.states[picks], picks


def _xarray() -> Any:
    try:
        import_module("h5netcdf")
        import_module("h5py")
        return import_module("xarray")
    except ImportError as error:
        raise ArvizError(
            f"{error.name} is not installed; pip install 'bayesnet-track[arviz]' (h5py, which writes the "
            "file, has wheels up to Python 3.14; ArviZ 1, which reads it, needs Python 3.12)"
        ) from error


@dataclass(frozen=True)
class DriftCheck:
    """Counts of a target's statuses before and after.

    Attributes:
        target: target id.
        level: the mean score above which its frames are called tracking.
        live: frames that were called tracking during the run.
        afterwards: frames that are called so now.
        frames: frames after its first.
    """

    target: str
    level: float
    live: int
    afterwards: int
    frames: int


def judge_afterwards(run: Run) -> tuple[Run, tuple[DriftCheck, ...]]:
    """The run with the statuses that the guarantees of its graph allow now that it is over.

    A frame is tracking where the mean of its last scores is above the level for the whole run, and the target
    is not lost; else it is at most uncertain. The first frame of a target, in which it was shown, stays as it
    is, and so do targets whose type has no levels for it. As in the calibration, the level is for all frames
    of the run after the first of the target, with a score of 0 where it has ended.
    """
    lines, checks = {(line.target, line.frame): line for line in run.metrics}, list[DriftCheck]()
    frames = sorted({line.frame for line in run.metrics} | run.seconds.keys())
    for target, kind in run.kinds.items():
        rule = _rule(run.spec.targets[kind])
        target_lines = [line for line in run.metrics if line.target == target]
        judged = target_lines[1:]
        if rule is None or not rule.afterwards or not judged:
            continue
        level, updated = _judge(rule, judged, [frame for frame in frames if frame > target_lines[0].frame])
        lines.update(((line.target, line.frame), line) for line in updated)
        checks.append(DriftCheck(target, level, _count(judged), _count(updated), len(judged)))
    return replace(run, metrics=tuple(lines.values())), tuple(checks)


def _rule(kind: Target) -> Guarantee | None:
    nodes = (node for node in kind.nodes.values() if isinstance(node, InferenceNode))
    return next((node.guarantee for node in nodes if node.guarantee is not None), None)


def _count(lines: Sequence[FrameMetrics]) -> int:
    return sum(line.status == "tracking" for line in lines)


def _judge(
    rule: Guarantee, judged: Sequence[FrameMetrics], frames: Sequence[int]
) -> tuple[float, list[FrameMetrics]]:
    """The level for a target's `frames` after its first, and its lines by it."""
    scores = dict.fromkeys(frames, 0.0) | {line.frame: line.score for line in judged}
    means = means_of(list(scores.values()), rule.frames)
    level = level_afterwards(rule.afterwards, means)
    assured = dict(zip(scores, (means > level).tolist(), strict=True))
    return level, [
        line if line.is_gone else replace(line, status="tracking" if assured[line.frame] else "uncertain")
        for line in judged
    ]


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
        cells: dict[str, Any] = {**row, "active": str(row["active"]).split()}
        lines.append(json.dumps({name: _finite(value) for name, value in cells.items()}, allow_nan=False))
    return "".join(f"{line}\n" for line in lines)


def as_coco(run: Run, lost: bool = False) -> str:
    """COCO JSON with tracks: images (one per frame), annotations with `track_id` and `score`, categories.

    Categories are the graph's plates, from 1; images are numbered by frame + 1 and named as the images of the
    source, or ``000000.jpg`` by frame where it has none. Boxes are in px from the top-left corner.
    """
    header = run.started
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
        "info": {"description": f"tracks of {header.graph} on {header.source}", "version": "1"},
        "licenses": [],
        "videos": [{"id": 1, "name": header.source, "width": header.width, "height": header.height}],
        "images": [
            {
                "id": frame + 1,
                "file_name": names[frame] if names else f"{frame:06d}.jpg",
                "width": header.width,
                "height": header.height,
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
        var_x, along = state["x_m_sd"] ** 2, state["y_m_sd"] ** 2
        covariance = state["xy_corr"] * math.sqrt(var_x * along)
        longest = (var_x + along) / 2.0 + math.hypot((var_x - along) / 2.0, covariance)
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
