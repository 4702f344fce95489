"""What smoothing changes on real sequences: accuracy, coverage, lost stretches that are bridged, and time.

    python benchmarks/smoothing.py DATA_FOLDER [--graph general] [--frames 200] [--seeds 2] [--draws 50]

DATA_FOLDER holds NAME/img/*.jpg and NAME/groundtruth.txt (the layout of the OTB benchmark). One pass from the
first true box, beliefs kept, then `smooth`. AUC counts every box, also of lost frames. A lost stretch is five
frames or more of the filter with IoU below 0.1 between two frames with IoU above 0.5; it is bridged when the
smoothed boxes have a mean IoU above 0.5 in it. Times are CPU seconds, of the run with decoding and writing.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from measuring import environment, on_one_thread, table
from numpy.typing import NDArray
from sequences import Sequence, find_sequences

from bayesnet_track import open_run, track
from bayesnet_track.evaluate.scores import score
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.numerics.boxes import centre_from_corner, overlap
from bayesnet_track.runtime.smoothing import smooth
from bayesnet_track.sources.sources import open_source

Floats = NDArray[np.float64]
STRETCH = 5


@dataclass(frozen=True)
class Figures:
    """AUC and coverage before and after, stretches and those bridged, CPU seconds, kilobytes a frame."""

    auc: tuple[float, float]
    in50: tuple[float, float]
    in90: tuple[float, float]
    stretches: int
    bridged: int
    run_s: float
    smooth_s: float
    kilobytes: float


def measure(sequence: Sequence, graph: str, draws: int, seed: int) -> Figures:
    """One run, smoothed."""
    folder = sequence.files[0].parent
    x, y, w, h = (float(value) for value in sequence.truth[0])
    with tempfile.TemporaryDirectory() as out:
        with open_source(str(folder), end=len(sequence.files)) as source:
            results = track(graph, source, (x, y, w, h), out=f"{out}/run", seed=seed, keep_beliefs=True)
            began = time.process_time()
            for result in results:
                if result.frame.index == 0:  # with what is compiled and loaded
                    began = time.process_time()
            spent = time.process_time() - began
        run = open_run(f"{out}/run")
        kilobytes = run.directory.beliefs.stat().st_size / len(run.metrics) / 1024
        began = time.process_time()
        smoothed = smooth(run, draws, seed)
        took = time.process_time() - began
        truth = sequence.truth[: len(run.metrics)]
        before, after = boxes_of(run.metrics), boxes_of(smoothed.metrics)
        scores = [score_lines(lines, truth) for lines in (run.metrics, smoothed.metrics)]
    centres = centre_from_corner(truth)
    lost = lost_stretches(overlap(centre_from_corner(before), centres))
    held = overlap(centre_from_corner(after), centres)
    return Figures(
        auc=(scores[0][0], scores[1][0]),
        in50=(scores[0][1], scores[1][1]),
        in90=(scores[0][2], scores[1][2]),
        stretches=len(lost),
        bridged=sum(float(held[first:last].mean()) > 0.5 for first, last in lost),
        run_s=spent,
        smooth_s=took,
        kilobytes=kilobytes,
    )


def boxes_of(lines: tuple[FrameMetrics, ...]) -> Floats:
    """(N, 4) corner boxes."""
    return np.array([line.xywh for line in lines])


def score_lines(lines: tuple[FrameMetrics, ...], truth: Floats) -> tuple[float, float, float]:
    """AUC, and the share of true centres in the 50 and the 90 % region."""
    found = score(
        boxes_of(lines),
        [False] * len(lines),
        truth,
        region50=[line.region50 for line in lines],
        region90=[line.region90 for line in lines],
    )
    return found.auc, float(np.mean(found.coverage50 or 0.0)), float(np.mean(found.coverage90 or 0.0))


def lost_stretches(overlaps: Floats) -> list[tuple[int, int]]:
    """First frame and the frame after the last of each stretch off target between two frames on it."""
    found, first = [], None
    for n, value in enumerate(overlaps):
        if value < 0.1 and first is None:
            first = n
        elif value > 0.5:
            if first is not None and n - first >= STRETCH:
                found.append((first, n))
            first = None
    return found


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument("--graph", default="general")
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--names", nargs="*", default=[], help="only these sequences")
    parser.add_argument("--draws", type=int, default=50)
    options = parser.parse_args()
    on_one_thread()
    print(environment())
    rows, every = [], []
    for sequence in find_sequences(options.data, options.names, options.frames):
        found = [measure(sequence, options.graph, options.draws, seed) for seed in range(options.seeds)]
        every += found
        rows.append(row(sequence.name, found))
        print(rows[-1], flush=True)
    print(table(HEAD, [*rows, row("**all**", every)]))


HEAD = (
    "sequence",
    "AUC",
    "smoothed",
    "in 50 %",
    "smoothed",
    "in 90 %",
    "smoothed",
    "lost",
    "bridged",
    "s",
    "smooth s",
    "kB",
)


def row(name: str, found: list[Figures]) -> list[str]:
    """A row of the table: means over seeds."""
    means = [np.mean([getattr(one, field) for one in found], axis=0) for field in ("auc", "in50", "in90")]
    counts = [str(sum(getattr(one, field) for one in found)) for field in ("stretches", "bridged")]
    fields = ("run_s", "smooth_s", "kilobytes")
    costs = [np.mean([getattr(one, field) for one in found]) for field in fields]
    return [
        name,
        *[f"{value:.3f}" for pair in means for value in pair],
        *counts,
        *[f"{cost:.2f}" for cost in costs],
    ]


if __name__ == "__main__":
    main()
