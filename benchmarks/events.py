"""What happens to real targets, and whether a tracker notices: leaving, a patch, black frames, a look-alike.

    python benchmarks/events.py DATA_FOLDER --half A --why WORDS [--graphs general,FILE] [--seeds 1]
        [--count 10] [--kinds leaves,look-alike] [--peers-python PYTHON --models FOLDER] [--rows FILE]

Each kind of event is made from ten sequences of a half (`event_videos`), drawn by a seed. Printed are:

- leaves: in how many videos the target is lost within 15 frames after the last of it was seen.
- patch in front: the share of entirely hidden frames that are called tracking, and in how many videos the
  target is held again, and called tracking, 10 frames after it is uncovered.
- black frames: in how many videos the box is back (IoU above 0.5), and the status tracking within 3 frames.
- look-alike: in how many videos the box is on the target and not on the other one 10 frames after it, and the
  share of the frames on target, from when it appears to 30 frames after it, that are not called tracking.

CSRT is lost where its update fails. NanoTrack has a score and no level: here it is lost below the level that
2 % of its frames with IoU above 0.5 before the events do not reach, which is in its favour. Every call adds a
line to the file of looks.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from event_videos import AFTER, BEFORE, BLACK, CROSSING, MAKERS, SLIDE, EventVideo, make_videos
from measuring import environment, on_one_thread, table
from numpy.typing import NDArray
from real_video import LOOKS, Elsewhere, digest, note, read_graph
from sequences import HALVES, SEED, find_sequences

from bayesnet_track import Tracker
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.numerics.boxes import centre_from_corner, overlap

LOST_WITHIN = 15
BACK_WITHIN = 3
NANO_QUANTILE = 0.02


@dataclass(frozen=True, eq=False)
class Run:
    """What a tracker said of every frame of a video after the first.

    Attributes:
        video: the video.
        iou: (n,) overlap with the target, `other` with the look-alike (0 where there is none).
        status: tracking, uncertain or lost.
        score: the tracker's own.
    """

    video: EventVideo
    iou: NDArray[np.float64]
    other: NDArray[np.float64]
    status: Sequence[str]
    score: Sequence[float]


def made_run(video: EventVideo, boxes: object, status: Sequence[str], score: Sequence[float]) -> Run:
    """With the overlaps of the corner boxes of all frames but the first."""
    found = centre_from_corner(np.asarray(boxes, dtype=np.float64))
    iou = overlap(found, centre_from_corner(video.truth[1:]))
    there = np.isfinite(video.other[1:]).all(axis=1)
    other = np.zeros(len(iou))
    other[there] = overlap(found[there], centre_from_corner(video.other[1:][there]))
    return Run(video, iou, other, status, score)


def run_graph(spec: GraphSpec, video: EventVideo, seed: int) -> Run:
    """One pass of the engine."""
    tracker = Tracker(spec, seed)
    boxes, status, score = [], [], []
    for index, image in enumerate(video.images):
        if index == 0:
            tracker.init(image, tuple(float(value) for value in video.truth[0]))
            continue
        _, box = tracker.update(image)
        boxes.append(box)
        status.append(tracker.status)
        score.append(tracker.score or 0.0)
    return made_run(video, boxes, status, score)


def run_peer(elsewhere: Elsewhere, name: str, videos: list[EventVideo]) -> Iterator[Run]:
    """Passes of a tracker of the other environment."""
    for video in videos:
        with tempfile.TemporaryDirectory() as folder:
            files = [Path(folder) / f"{index:04}.bmp" for index in range(len(video.images))]
            for file, image in zip(files, video.images, strict=True):
                cv2.imwrite(str(file), image)
            found = elsewhere.find(name, files, video.truth[0].tolist())
        status = ["lost" if gone else "tracking" for gone in found["lost"][1:]]
        yield made_run(video, found["boxes"][1:], status, found["scores"][1:])


def by_level(runs: list[Run]) -> list[Run]:
    """The runs, lost where the score is below the level of most good frames before the events."""
    good = [
        score
        for run in runs
        for score, iou in zip(run.score[: BEFORE - 1], run.iou[: BEFORE - 1], strict=True)
        if iou > 0.5
    ]
    level = float(np.quantile(good, NANO_QUANTILE))
    return [
        Run(
            run.video,
            run.iou,
            run.other,
            ["tracking" if s >= level else "lost" for s in run.score],
            run.score,
        )
        for run in runs
    ]


def judge_leaving(run: Run) -> tuple[bool, str]:
    """Whether it is lost in time after the last of it was seen, and after how many frames."""
    gone = int(np.argmax(run.video.hidden)) - 1
    lost = [k for k, status in enumerate(run.status) if status == "lost" and k >= gone - SLIDE]
    after = lost[0] - gone + 1 if lost else None
    stayed = sum(status == "lost" for status in run.status[gone + LOST_WITHIN :])
    of = len(run.status) - gone - LOST_WITHIN
    shown = "never" if after is None else f"after {after}"
    return after is not None and after <= LOST_WITHIN, f"{shown}, then {stayed}/{of}"


def judge_patch(run: Run) -> tuple[bool, str]:
    """Whether it is held and called tracking again at the end; the share of hidden frames called tracking."""
    hidden = np.flatnonzero(run.video.hidden[1:])
    called = sum(run.status[k] == "tracking" for k in hidden)
    back = bool(run.iou[-1] > 0.5 and run.status[-1] == "tracking")
    return back, f"{called}/{len(hidden)}{', back' if back else ''}"


def judge_black(run: Run) -> tuple[bool, str]:
    """Whether the status is back in time once the box is, and after how many frames."""
    first = BEFORE + BLACK - 1
    back = [k for k in range(first, len(run.iou)) if run.iou[k] > 0.5]
    if not back:
        return False, "box not back"
    called = [k for k in range(back[0], len(run.iou)) if run.status[k] == "tracking"]
    after = called[0] - back[0] if called else None
    shown = "never" if after is None else f"after {after}"
    return after is not None and after <= BACK_WITHIN, f"box at {back[0] - first}, tracking {shown}"


def doubt_of(run: Run) -> float:
    """Share of the frames on target, from when the look-alike appears, that are not called tracking."""
    good = run.iou[BEFORE - 1 :] > 0.5
    return float((np.array(run.status[BEFORE - 1 :])[good] != "tracking").mean()) if good.any() else 0.0


def judge_crossing(run: Run) -> tuple[bool, str]:
    """Whether the box is on the target rather than on the other in the end."""
    end = BEFORE + CROSSING + AFTER - 1
    own, other = float(run.iou[end - 5 : end].mean()), float(run.other[end - 5 : end].mean())
    called = "".join(status[0] for status in run.status[end - 5 :])
    return own >= other and not (own == other == 0.0), f"{own:.2f} against {other:.2f} {called}"


JUDGES = {
    "leaves": judge_leaving,
    "patch in front": judge_patch,
    "black frames": judge_black,
    "look-alike": judge_crossing,
}


def rows_of(kind: str, runs: dict[str, list[Run]], count: int) -> tuple[list[str], list[list[str]]]:
    """A row for each tracker, and one for each video."""
    summary = []
    for own in runs.values():
        passed = sum(JUDGES[kind](run)[0] for run in own)
        share = count * passed / len(own)
        cell = f"{share:.3g} of {count}"
        if kind == "patch in front":
            called = [
                np.mean([status == "tracking" for status in np.array(run.status)[run.video.hidden[1:]]])
                for run in own
            ]
            cell = f"{np.mean(called):.2f} (back {cell})"
        if kind == "look-alike":
            cell += f" (doubt {np.mean([doubt_of(run) for run in own]):.2f})"
        summary.append(cell)
    lines = []
    for index in range(len(next(iter(runs.values())))):
        cells = []
        for own in runs.values():
            run = own[index]
            held = "" if run.iou[BEFORE - 2] > 0.5 else ", not held before"
            cells.append(JUDGES[kind](run)[1] + held)
        lines.append([next(iter(runs.values()))[index].video.sequence, *cells])
    return summary, lines


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument("--half", choices=("A", "B"), required=True)
    parser.add_argument("--graphs", default="general", help="names or files, with commas")
    parser.add_argument("--why", required=True, help="what the look is for; goes into the record")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--kinds", default=",".join(MAKERS))
    parser.add_argument("--peers-python", metavar="PYTHON", help="has OpenCV's contrib build")
    parser.add_argument("--models", metavar="FOLDER", help="NanoTrack's two model files")
    parser.add_argument("--looks", type=Path, default=LOOKS)
    parser.add_argument("--rows", type=Path, metavar="FILE", help="write every frame, a JSON object a run")
    options = parser.parse_args()
    on_one_thread()
    sequences = find_sequences(options.data, list(HALVES[options.half]), None)
    specs = [read_graph(name) for name in options.graphs.split(",")]
    shown = ", ".join(f"{name} {digest(spec)}" for name, spec in specs)
    what = f"events: {options.kinds}"
    note(
        options.looks,
        half=options.half,
        graphs=shown,
        seeds=f"{options.first_seed}",
        frames=what,
        why=options.why,
    )
    elsewhere = None
    if options.peers_python:
        elsewhere = Elsewhere(options.peers_python, options.models)
    print(environment() + "\n", flush=True)
    summaries, parts, counts = [], [], []
    names = [name for name, _ in specs]
    for kind in options.kinds.split(","):
        videos = make_videos(kind, sequences, options.count, SEED)
        counts.append(len(videos))
        runs = {
            name: [run_graph(spec, video, options.first_seed) for video in videos] for name, spec in specs
        }
        for peer in ("CSRT", "NanoTrack") if elsewhere is not None else ():
            found = list(run_peer(elsewhere, peer, videos)) if elsewhere is not None else []
            runs[peer] = by_level(found) if peer == "NanoTrack" else found
        names = list(runs)
        summary, lines = rows_of(kind, runs, len(videos))
        summaries.append(summary)
        parts.append(f"\n\n{kind}\n\n" + table(["", *names], lines))
        print(parts[-1], flush=True)
        if options.rows:
            write_rows(options.rows, kind, runs)
    rows = [[name, *(summary[k] for summary in summaries)] for k, name in enumerate(names)]
    print(f"\nhalf {options.half}\n\n" + table(["", *options.kinds.split(",")], rows))


def write_rows(file: Path, kind: str, runs: dict[str, list[Run]]) -> None:
    """Add every frame of every run to the file."""
    with file.open("a", encoding="utf-8") as lines:
        for name, own in runs.items():
            for run in own:
                line = {
                    "kind": kind,
                    "tracker": name,
                    "sequence": run.video.sequence,
                    "iou": np.round(run.iou, 3).tolist(),
                    "other": np.round(run.other, 3).tolist(),
                    "hidden": run.video.hidden[1:].tolist(),
                    "status": list(run.status),
                    "score": np.round(run.score, 4).tolist(),
                }
                lines.write(json.dumps(line) + "\n")


if __name__ == "__main__":
    main()
