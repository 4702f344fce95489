"""Graphs on real sequences by halves: what is chosen on one half is reported on the other.

    python benchmarks/real_video_halves.py DATA_FOLDER --half A --graphs general,one.yaml --why WORDS
        [--seeds 2] [--first-seed 0] [--max-frames 150] [--peers-python PYTHON --models FOLDER]
        [--looks FILE] [--processes 2] [--anchors 4] [--stride 2] [--backwards]

The sequences are split by a coin that is tossed once and for all (`real_video_coin`), stratified by whether
settings of `general` had been chosen on them before. `--half` says which are run: A, B, or both. The first
graph is compared with each other one, paired by sequence, with bootstrap intervals; the new sequences are
reported apart, and the difference without the sequence that moves it most. With `--best` it only prints the
name of the graph with the largest mean of that half. Every call adds a line to the file of looks.
`--anchors` begins in several places of each sequence, `--stride` and `--backwards` take its frames in another
order; all passes of a sequence weigh as one sequence.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict
from datetime import UTC, datetime
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from measuring import environment, on_one_thread
from real_video import SWITCHES, Elsewhere, changed, digest
from real_video_anchors import add_arguments, anchors_of
from real_video_coin import HALVES
from real_video_frames import Frames, Pass, report
from sequences import Sequence, find_sequences

from bayesnet_track import Tracker
from bayesnet_track.evaluate.scores import score
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.numerics.boxes import centre_from_corner, overlap

SEEDLESS = ("CSRT", "KCF", "NanoTrack")


def read_graph(name: str) -> tuple[str, GraphSpec]:
    """A graph by its name or file; `NAME:always` is the same without rules of adaptation."""
    graph, _, how = name.partition(":")
    spec = load_graph(graph).spec
    return f"{Path(graph).stem}{':always' if how else ''}", changed(spec, without_rules=True) if how else spec


def run_graph(name: str, spec: GraphSpec, sequence: Sequence, seed: int) -> Pass:
    """One pass of the engine, with what it said of every frame."""
    tracker = Tracker(spec, seed, copy_frames=False)  # as OpenCV's, which copy none either
    start = tuple(float(value) for value in sequence.truth[0])
    held, every, found = [start], [start], Frames([], [], [], [])
    regions: tuple[list[tuple[float, ...]], list[tuple[float, ...]]] = ([(0.0,) * 4], [(0.0,) * 4])
    switched, asked = 0, 0
    for index, image in enumerate(sequence.images()):
        started = time.process_time()
        if index == 0:
            tracker.init(image, start)
            continue
        ok, box = tracker.update(image)
        found.cpu_s.append(time.process_time() - started)
        # As trackers are usually scored: while lost, the last box that was held counts.
        held.append(box if ok else held[-1])
        every.append(box)
        found.score.append(tracker.score)
        found.status.append(tracker.status)
        asked += len(tracker.metrics.kl)
        switched += sum(isinstance(event, SWITCHES) for event in tracker.events)
        regions[0].append(tracker.metrics.region50)
        regions[1].append(tracker.metrics.region90)
    found.iou.extend(_overlaps(every, sequence)[1:])
    lost = [False] * len(held)
    whole = score(held, lost, sequence.truth, region50=regions[0], region90=regions[1])
    count = len(found.iou)
    return Pass(
        name,
        digest(spec),
        sequence.name,
        seed,
        whole.auc,
        score(every, lost, sequence.truth).auc,
        100.0 * switched / count,
        asked / count,
        float(np.mean(whole.coverage50 or 0.0)),
        float(np.mean(whole.coverage90 or 0.0)),
        found,
    )


def _overlaps(boxes: list[tuple[float, ...]], sequence: Sequence) -> list[float]:
    truth = centre_from_corner(np.asarray(sequence.truth, dtype=np.float64))
    found = overlap(centre_from_corner(np.asarray(boxes, dtype=np.float64)), truth)
    return [float(value) for value in found]


def run_peer(elsewhere: Elsewhere, name: str, sequence: Sequence, seed: int) -> Pass:
    """One pass of a tracker of the other environment."""
    line, boxes, lost = elsewhere.run_with_boxes(name, sequence, seed)
    frames = len(boxes) - 1
    status = ["lost" if gone else "tracking" for gone in lost[1:]]
    seconds = [line.cpu_s / max(frames, 1)] * frames
    found = Frames(_overlaps(boxes, sequence)[1:], [0.0] * frames, status, seconds)
    return Pass(name, "", sequence.name, seed, line.auc, line.auc_every or 0.0, 0.0, 0.0, 0.0, 0.0, found)


def _run(job: tuple[str, GraphSpec, Sequence, int]) -> Pass:
    import cv2

    cv2.setNumThreads(1)
    return run_graph(*job)


def run_all(
    specs: list[tuple[str, GraphSpec]], sequences: list[Sequence], seeds: range, processes: int
) -> Iterator[Pass]:
    """Every pass of every graph: of a sequence and seed one after the other, so that times compare."""
    jobs = [(name, spec, one, seed) for one in sequences for seed in seeds for name, spec in specs]
    if processes == 1:
        yield from map(_run, jobs)
        return
    with get_context("spawn").Pool(processes) as pool:
        yield from pool.imap(_run, jobs, chunksize=len(specs))


def note(file: Path, **what: object) -> None:
    """Add a look to the record: when, at which code, which half, for what."""
    call = ["git", "rev-parse", "--short", "HEAD"]
    code = subprocess.run(call, capture_output=True, text=True, check=False).stdout.strip()
    line = {"at": datetime.now(UTC).strftime("%Y-%m-%d %H:%M"), "code": code, **what}
    with file.open("a", encoding="utf-8") as lines:
        lines.write(json.dumps(line) + "\n")


def main() -> None:
    """Run what was asked for, and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument("--half", choices=("A", "B", "both"), required=True)
    parser.add_argument("--graphs", default="general,general:always", help="names or files, with commas")
    parser.add_argument("--why", required=True, help="what the look is for; goes into the record")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--max-frames", type=int, default=150)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--peers", default="CSRT,NanoTrack,KCF")
    parser.add_argument("--peers-python", metavar="PYTHON", help="has OpenCV's contrib build")
    parser.add_argument("--models", metavar="FOLDER", help="NanoTrack's two model files")
    parser.add_argument("--looks", type=Path, default=Path(__file__).with_name("real_video_looks.jsonl"))
    parser.add_argument("--passes", type=Path, metavar="FILE", help="write every pass, a JSON object a line")
    parser.add_argument("--best", action="store_true", help="print only the graph with the best mean")
    add_arguments(parser)
    options = parser.parse_args()
    on_one_thread()
    halves = ["A", "B"] if options.half == "both" else [options.half]
    names = [name for half in halves for name in HALVES[half]]
    anchors = anchors_of(options)
    sequences = [piece for one in find_sequences(options.data, names, None) for piece in anchors.of(one)]
    specs = [read_graph(name) for name in options.graphs.split(",")]
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    shown = ", ".join(f"{name} {digest(spec)}" for name, spec in specs)
    look = {"half": options.half, "graphs": shown, "seeds": str(seeds), "frames": options.max_frames}
    look |= {"anchors": str(anchors)} if str(anchors) else {}
    note(options.looks, **look, why=options.why)

    passes = list(run_all(specs, sequences, seeds, options.processes))
    if options.peers_python:
        extra = [options.models] if options.models else []
        with Elsewhere(options.peers_python, extra) as elsewhere:
            for name in options.peers.split(","):
                if name in elsewhere.trackers:
                    passes += [run_peer(elsewhere, name, one, 0) for one in sequences]
    if options.passes:
        with options.passes.open("a", encoding="utf-8") as file:
            file.writelines(json.dumps(asdict(one)) + "\n" for one in passes)
    if options.best:
        print(max(specs, key=lambda s: np.mean([one.auc for one in passes if one.tracker == s[0]]))[0])
        return
    print(environment(), file=sys.stderr)
    print(report(passes))


if __name__ == "__main__":
    main()
