"""Score a run directory against a ground-truth file."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from math import gcd
from pathlib import Path
from typing import TypeVar

import numpy as np

from bayesnet_track.evaluate.mot import MotScore, score_mot
from bayesnet_track.evaluate.scores import TrackScore, score_pass
from bayesnet_track.evaluate.truth import Tracks, TruthForm, read_pair, read_truth
from bayesnet_track.graph.text.load import read_graph
from bayesnet_track.journal.blocks import boxes_of
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.runs import RunEnded, RunStarted
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.reader import Measurements, read_events, read_metrics, read_seconds
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.boxes import centre_from_corner, corner_from_centre, overlap
from bayesnet_track.observation.settings import setting
from bayesnet_track.sources.entrances.boxes import explain_places
from bayesnet_track.sources.entrances.notices import notice

E = TypeVar("E", bound=Event)

_NOTHING = (math.nan,) * 4
"""The row of a frame in which the target has ended."""
SAME_IOU = 0.5
"""Overlap of the true box and the run's in its first frame, below which the file is asked about."""


def score_run(
    run_directory: str | Path,
    truth_path: str | Path,
    target: str | None = None,
    form: TruthForm | None = None,
) -> TrackScore:
    """Scores of one target of a run; row i of the truth belongs to the frame with index i.

    Reads what was measured and, where there is one, ``timings.jsonl``. Frames beyond the end of the truth are
    not scored, nor are those before the target's first line. After that, a frame of the run without a line of
    the target, which has ended, counts as lost with an IoU of 0. `target` may be left out when the run has
    only one. `form` is that of `read_truth`. A notice says where ground truth and run do not go together.

    Raises:
        OSError: a file cannot be read.
        ValueError: a malformed file (says file and line), no frame with a true box, or an unclear target.
    """
    folder = Path(run_directory)
    truth = read_truth(truth_path, form)
    say_misplaced(folder, truth_path, truth[np.isfinite(truth).all(axis=1)])
    say_lengths(folder, truth_path, len(truth))
    all_metrics = list(read_metrics(folder / "frames.npy.gz"))
    seconds = dict(read_seconds(folder / "timings.jsonl"))
    lines = {line.frame: line for line in _of_target(all_metrics, target, folder)}
    ran = {line.frame for line in all_metrics} | _timed(folder, seconds)
    frames = sorted(frame for frame in ran if min(lines) <= frame < len(truth))
    if not any(frame in lines for frame in frames):
        raise ValueError(f"{truth_path}: {len(truth)} boxes, none of them for a frame of {folder}")
    metrics = [lines.get(frame) for frame in frames]
    first = min(lines)
    if frames[0] == first and np.isfinite(truth[first]).all():
        _say_start(truth_path, first, truth[first], corner_from_centre(lines[first].centre_box))
    run_score = score_pass(
        np.array([_NOTHING if line is None else corner_from_centre(line.centre_box) for line in metrics]),
        [line is None or line.is_gone for line in metrics],
        truth[frames],
        seconds=_seconds(folder / "timings.jsonl", frames, seconds),
        active=[0 if line is None else len(line.active) for line in metrics],
        region50=[_NOTHING if line is None else line.region50 for line in metrics],
        region90=[_NOTHING if line is None else line.region90 for line in metrics],
        confidence=[0.0 if line is None else line.score for line in metrics],
        statuses=["ended" if line is None else line.status for line in metrics],
    )
    return (
        run_score
        if run_score.first_lost is None
        else replace(run_score, first_lost=frames[run_score.first_lost])
    )


def say_misplaced(run_directory: Path, truth_path: str | Path, boxes: Floats) -> None:
    """A notice for each sign that true boxes (N, 4) are not of the images of a run."""
    start = next(iter(_events(run_directory, RunStarted)), None)
    if start is not None:
        for reason in explain_places(boxes, (start.width, start.height), "true boxes"):
            notice(f"{truth_path}: {reason}")


def _say_start(truth_path: str | Path, frame: int, true: Floats, reported: Floats) -> None:
    """A notice where two corner boxes (4,) of the first frame lie apart, and how the true one would fit."""
    x, y, w, h = true.tolist()
    scale = math.sqrt(reported[2] * reported[3] / (w * h))
    readings: dict[str, list[float]] = {
        f"centre x, centre y, w, h: say {setting('--truth-format', 'centers')}": [x - w / 2, y - h / 2, w, h],
        f"left, top, right, bottom: say {setting('--truth-format', 'corners')}": [x, y, w - x, h - y],
        f"those of a video of another size: multiply all by {scale:.3g}": (scale * true).tolist(),
    }
    start = centre_from_corner(reported)
    overlaps = {
        reading: float(overlap(centre_from_corner(box), start)) if min(box[2:]) > 0 else 0.0
        for reading, box in readings.items()
    }
    as_written = float(overlap(centre_from_corner(true), start))
    reading = max(overlaps, key=overlaps.__getitem__)
    if as_written < SAME_IOU:
        is_explained = overlaps[reading] >= SAME_IOU
        mend = f"its numbers fit as {reading}" if is_explained else "is it of this target?"
        corners = " and ".join(",".join(f"{value:.4g}" for value in box) for box in (true, reported))
        notice(
            f"{truth_path}: in frame {frame}, the first of the run, the true box and the run's ({corners}) "
            f"overlap by {as_written:.2f}: {mend}"
        )


def tracks_of_run(folder: Path) -> Path | Tracks:
    """The boxes of a run: its ``tracks.txt``, or of a run without it those in its columns, as it has them."""
    mot, frames = folder / "tracks.txt", folder / "frames.npy.gz"
    if mot.exists() or not frames.is_file():
        return mot
    has_births = any(plate.birth for plate in read_graph(folder / "graph.yaml")[0].targets.values())
    parts = [
        (boxes.frames.astype(np.int32), boxes.ids, np.round(boxes.corners, 3).astype(np.float32))
        for boxes in boxes_of(Measurements(frames, notice), lost=not has_births)
    ]
    if not parts:
        return Tracks(np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros((0, 4)))
    return Tracks(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def score_several(folder: Path, truth: Path, form: TruthForm | None = None) -> MotScore:
    """Scores of all targets of a run; raises OSError, ValueError as `read_pair`."""
    return score_mot(*read_pair(tracks_of_run(folder), truth, *frames_of_run(folder), form))


def frames_of_run(run_directory: Path) -> tuple[set[int] | None, range | None]:
    """The frames of a run that read every few of its source, else None; the range of all if it is whole."""
    frames = {frame for frame, _ in read_seconds(run_directory / "timings.jsonl")}
    ended = _events(run_directory, RunEnded)
    if not frames or not ended:
        return None, None
    step = gcd(*(frame - min(frames) for frame in frames)) or 1
    frame_range = range(min(frames), max(frames) + 1, step) if ended[-1].complete else None
    return (frames if step > 1 else None), frame_range


def say_lengths(folder: Path, truth_path: str | Path, rows: int) -> None:
    """A notice where the ground truth has fewer rows than the run has frames, or more."""
    _, ran = frames_of_run(folder)
    if ran is None or ran.stop <= rows < ran.stop + ran.step:
        return
    unmatched = f"frames {rows} to {ran.stop - 1}" if rows < ran.stop else f"rows {ran.stop} to {rows - 1}"
    is_longer = rows > ran.stop and _has_end(folder)
    question = f"as {setting('--end')} says." if is_longer else "is it of this video?"
    notice(
        f"{truth_path} has {rows} rows, the run {len(ran)} frames: {question} Not scored: {unmatched}, "
        "counted from 0"
    )


def _has_end(folder: Path) -> bool:
    """True if a run was asked to end before its source does, or nothing is known of that."""
    try:
        origin = json.loads((folder / "run.json").read_text(encoding="utf-8"))["origin"]
        return origin.get("end") is not None
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return False


def _events(folder: Path, kind: type[E]) -> list[E]:
    journal = folder / "journal.jsonl"
    return [event for event in read_events(journal) if isinstance(event, kind)] if journal.is_file() else []


def _timed(folder: Path, seconds: Mapping[int, float]) -> set[int]:
    """The frames that have a time and are whole: a killed run can have timed one that it did not measure."""
    is_ended = bool(_events(folder, RunEnded))
    return set(seconds) if is_ended or not seconds else set(seconds) - {max(seconds)}


def _of_target(lines: list[FrameMetrics], target: str | None, folder: Path) -> list[FrameMetrics]:
    present = list(dict.fromkeys(line.target for line in lines))
    if target is None and len(present) > 1:
        raise ValueError(f"{folder}: several targets ({', '.join(present)}); name one")
    target_name = target if target is not None else next(iter(present), "")
    if target_name not in present:
        raise ValueError(f"{folder}: no target {target_name!r}; there are {', '.join(present) or 'none'}")
    return [line for line in lines if line.target == target_name]


def _seconds(path: Path, frames: list[int], seconds_of: Mapping[int, float]) -> list[float] | None:
    if not path.exists():
        return None
    missing = [frame for frame in frames if frame not in seconds_of]
    if missing:
        raise ValueError(f"{path}: no time for frame {missing[0]}")
    return [seconds_of[frame] for frame in frames]
