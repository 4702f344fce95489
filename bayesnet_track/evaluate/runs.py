"""Score a run directory against a ground-truth file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from bayesnet_track.evaluate.scores import Score, score
from bayesnet_track.evaluate.truth import read_truth
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.reader import read_metrics
from bayesnet_track.journal.timings import read_seconds
from bayesnet_track.numerics.boxes import corner_from_centre


def score_run(run_directory: str | Path, truth_path: str | Path, target: str | None = None) -> Score:
    """Scores of one target of a run; row i of the truth belongs to the frame with index i.

    Reads ``frames.jsonl`` and, where there is one, ``timings.jsonl``. Frames beyond the end of the truth are
    not scored. `target` may be left out when the run has only one.

    Raises:
        OSError: a file cannot be read.
        ValueError: a malformed file (says file and line), no frame with a true box, or an unclear target.
    """
    folder = Path(run_directory)
    truth = read_truth(truth_path)
    metrics = _of_target(list(read_metrics(folder / "frames.jsonl")), target, folder)
    metrics = [line for line in metrics if line.frame < len(truth)]
    if not metrics:
        raise ValueError(f"{truth_path}: {len(truth)} boxes, none of them for a frame of {folder}")
    frames = [line.frame for line in metrics]
    found = score(
        corner_from_centre([line.centre_box for line in metrics]),
        [line.status == "lost" for line in metrics],
        truth[frames],
        seconds=_seconds(folder / "timings.jsonl", frames),
        active=[len(line.active) for line in metrics],
        region50=[line.region50 for line in metrics],
        region90=[line.region90 for line in metrics],
        confidence=[line.score for line in metrics],
    )
    return found if found.first_lost is None else replace(found, first_lost=frames[found.first_lost])


def _of_target(lines: list[FrameMetrics], target: str | None, folder: Path) -> list[FrameMetrics]:
    present = list(dict.fromkeys(line.target for line in lines))
    if target is None and len(present) > 1:
        raise ValueError(f"{folder}: several targets ({', '.join(present)}); name one")
    wanted = target if target is not None else next(iter(present), "")
    if wanted not in present:
        raise ValueError(f"{folder}: no target {wanted!r}; there are {', '.join(present) or 'none'}")
    return [line for line in lines if line.target == wanted]


def _seconds(path: Path, frames: list[int]) -> list[float] | None:
    if not path.exists():
        return None
    taken = dict(read_seconds(path))
    missing = [frame for frame in frames if frame not in taken]
    if missing:
        raise ValueError(f"{path}: no time for frame {missing[0]}")
    return [taken[frame] for frame in frames]
