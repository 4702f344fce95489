"""A detector that looks at some frames only: every k-th one against as many at random, by MOTA.

    python benchmarks/looks.py [--seeds 200-209] [--tud DATA/mot_TUD-Campus] [--graphs jpda] [--crowds dense]

The crowds are those of `simulate_crowd.py`, 300 frames: a dense one (ten people who wander, four crossings,
two pairs side by side, 10 % missed, one false box a frame) and a sparse one (one person, later one more in
67 frames on average, .2 false boxes a frame). In the other frames the detector answers None, and targets are
carried by their motion. With `--tud` its Faster R-CNN detections, too. Intervals are 95 % of the mean over
seeds, of differences paired by seed.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from crowd_association import tracked, truth_of
from measuring import environment, on_one_thread, table
from numpy.typing import NDArray

from bayesnet_track.evaluate.mot import score_mot
from bayesnet_track.evaluate.truth import Tracks, read_mot_truth
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.observation.detector import NOTHING, Detections, DetectorState
from bayesnet_track.observation.planes import FramePair
from bayesnet_track.sources.detection_files import file_detector
from simulated.crowd_detector import DetectorSettings, detect_crowd
from simulated.walkers import CrowdSettings, make_crowd

CROWDS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "dense": ({}, {"missed": 0.1, "clutter": 1.0}),
    "sparse": (
        {"alone": 1, "births": 0.015, "life": 80.0, "crossings": 0, "beside": 0},
        {"missed": 0.1, "clutter": 0.2},
    ),
}
"""What people and detectors differ in from the defaults."""

SHARES = (1.0, 0.5, 0.4, 1 / 3, 0.25)
"""Shares of the frames that are looked at."""

TUD = 640, 480
"""Size of the frames of TUD-Campus, px."""

Looks = NDArray[np.bool_]


def in_turn(frames: int, share: float) -> Looks:
    """Frames at equal distances, the first included."""
    numbers = np.floor(np.arange(frames) * share + 1e-9)
    return np.append(True, np.diff(numbers) > 0)


def at_random(frames: int, share: float, seed: int) -> Looks:
    """As many frames drawn at random, the first included."""
    count = int(in_turn(frames, share).sum())
    looks = np.zeros(frames, np.bool_)
    looks[np.append(0, 1 + np.random.default_rng(seed).permutation(frames - 1)[: count - 1])] = True
    return looks


@dataclass(frozen=True, eq=False)
class Sometimes:
    """A detector that looks at some frames.

    Attributes:
        seen: what it finds in each frame.
        looks: whether it looks at it.
    """

    seen: Sequence[Detections]
    looks: Looks

    def start(self) -> DetectorState:
        """Nothing is remembered."""
        return {}

    def detect(self, frames: FramePair, state: DetectorState) -> tuple[Detections | None, DetectorState]:
        """What it finds; None where it does not look."""
        index = frames.current.index
        return self.seen[index] if self.looks[index] else None, state


def mota(truth: Tracks, name: str, seen: Sequence[Detections], looks: Looks, size: tuple[int, int]) -> float:
    """MOTA of what a graph makes of the detections of the frames that are looked at."""
    return score_mot(truth, tracked(graph_of(name), Sometimes(seen, looks), len(seen), size)).mota


def graph_of(name: str) -> CheckedGraph:
    """The graph, with all detections that are given."""
    written = load_graph(name).spec.model_dump(exclude_unset=True)
    (plate,) = written["targets"].values()
    plate["birth"]["detector"] = {"detections": {"max_count": 200, "max_overlap": 1.0}}
    return load_graph(written)


def simulated(kind: str, seed: int) -> tuple[Tracks, list[Detections], tuple[int, int]]:
    """Ground truth, detections and the size of the frames of a crowd."""
    people, errors = CROWDS[kind]
    crowd = make_crowd(CrowdSettings(**people), seed)
    seen = [one.detections for one in detect_crowd(crowd, DetectorSettings(**errors), seed)]
    return truth_of(crowd), seen, (crowd.settings.width, crowd.settings.height)


def interval(values: NDArray[np.float64]) -> str:
    """Mean and half of a 95 % interval of it."""
    half = 1.96 * values.std(ddof=1) / len(values) ** 0.5
    return f"{values.mean():.3f} ± {half:.3f}"


def compare(kind: str, name: str, seeds: Sequence[int]) -> list[list[str]]:
    """A line of the table for each share of the frames."""
    crowds, lines = [simulated(kind, seed) for seed in seeds], []
    for share in SHARES:
        turn, drawn = [], []
        for seed, (truth, seen, size) in zip(seeds, crowds, strict=True):
            turn.append(mota(truth, name, seen, in_turn(len(seen), share), size))
            if share < 1.0:
                drawn.append(mota(truth, name, seen, at_random(len(seen), share, seed), size))
        more = interval(np.subtract(turn, drawn)) if drawn else ""
        lines.append([kind, name, f"{share:.2f}", f"{np.mean(turn):.3f}", more])
    return lines


def real(folder: Path, name: str) -> list[list[str]]:
    """The same of the Faster R-CNN detections of TUD-Campus, which are one sequence; five draws."""
    truth = read_mot_truth(folder / "gt" / "gt.txt")
    given = file_detector(str(folder / "detections_frcnn.txt")).found
    seen = [given.get(index, NOTHING) for index in range(int(truth.frames.max()) + 1)]
    lines = []
    for share in SHARES:
        turn = mota(truth, name, seen, in_turn(len(seen), share), TUD)
        drawn = [mota(truth, name, seen, at_random(len(seen), share, seed), TUD) for seed in range(5)]
        lines.append(["TUD-Campus", name, f"{share:.2f}", f"{turn:.3f}", f"{turn - np.mean(drawn):.3f}"])
    return lines


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--seeds", default="200-209", help="first and last seed")
    parser.add_argument("--graphs", default="kalman_detections,jpda")
    parser.add_argument("--crowds", default=",".join(CROWDS), help="kinds of crowds; default all")
    parser.add_argument("--tud", type=Path, help="folder of TUD-Campus")
    chosen = parser.parse_args()
    on_one_thread()
    print(f"{environment()}; load {os.getloadavg()[0]:.1f}", flush=True)
    low, high = (int(word) for word in chosen.seeds.split("-"))
    names = chosen.graphs.split(",")
    lines = [
        line
        for kind in chosen.crowds.split(",")
        for name in names
        for line in compare(kind, name, range(low, high + 1))
    ]
    if chosen.tud:
        lines += [line for name in names for line in real(chosen.tud, name)]
    print(table(["crowd", "graph", "frames looked at", "MOTA", "more than at random"], lines))


if __name__ == "__main__":
    main()
