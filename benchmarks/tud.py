"""Many people in a real sequence: MOTA, IDF1 and HOTA of graphs by detections, noisy true ones and real ones.

    python benchmarks/tud.py DATA/mot_TUD-Campus [--seeds 10] [--only noisy|files|background|motion|hostile]

Noisy detections are drawn from the truth: 15 % are missed, place and size are off by 5 % of the size, and one
box a frame is somewhere else. Files are the folder's `detections_*.txt`. The detectors see the pictures only.
Tracks are scored as `tracks.txt` would hold them: without lines of lost targets.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.engine.step import make_engine
from bayesnet_track.evaluate.mot import score_mot
from bayesnet_track.evaluate.truth import Tracks, read_mot_truth
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.checks.run import check_graph
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.graph.text.write import as_plain
from bayesnet_track.numerics.boxes import centre_from_corner, corner_from_centre
from bayesnet_track.observation.detector import Detections, Detector
from bayesnet_track.runtime.results import FrameSource
from bayesnet_track.runtime.run import run
from bayesnet_track.sources.detection_files import FileDetector, file_detector
from bayesnet_track.sources.frames import SourceItem
from bayesnet_track.sources.sources import open_source

Floats = NDArray[np.float64]

MISSED, JITTER, CLUTTER = 0.15, 0.05, 1


GRAPHS = ("kalman_detections", "people_detections")
OF_FILES = ("jpda", "kalman_detections", "people_detections", "sort", "bytetrack", "oc_sort")
VARIANTS = ("as it is", "place alone", "no return")

DETECTORS: dict[str, dict[str, Any]] = {
    "background": {"min_area_px": 1500, "min_score": 0.1},
    "motion": {"min_area_px": 1500, "min_score": 0.1},
}
"""Settings for people of 60 to 140 px across: smaller finds are arms, legs and windows."""


@dataclass(frozen=True, eq=False)
class Remembered:
    """A source read once: its frames again and again."""

    source: FrameSource
    frames: tuple[SourceItem, ...]

    def __getattr__(self, name: str) -> Any:
        return getattr(self.source, name)

    def __iter__(self) -> Iterator[SourceItem]:
        return iter(self.frames)


def noisy(truth: Tracks, seed: int, width: int, height: int) -> dict[int, Detections]:
    """Frame -> detections: true boxes, some missed, all jittered, and clutter of true boxes' sizes."""
    rng = np.random.default_rng(seed)
    found = {}
    for frame in range(int(truth.frames.max()) + 1):
        boxes = truth.boxes[truth.frames == frame]
        seen = boxes[rng.random(len(boxes)) >= MISSED]
        sides = np.tile(seen[:, 2:], 2)
        seen = seen + JITTER * sides * rng.standard_normal(seen.shape)
        size = truth.boxes[rng.integers(len(truth.boxes), size=CLUTTER), 2:]
        corner = rng.uniform(0, 1, (CLUTTER, 2)) * np.maximum([width, height] - size, 1.0)
        corners = np.concatenate([seen, np.hstack([corner, size])])
        order = rng.permutation(len(corners))
        found[frame] = Detections(centre_from_corner(corners[order]), np.ones(len(order)), ("",) * len(order))
    return found


def graph_of(name: str, variant: str, detector: Mapping[str, Any] | None = None) -> CheckedGraph:
    """The graph with another detector, with detections shared out by place alone, or without returns."""
    plain = as_plain(load_graph(name).spec)
    (kind,) = plain["targets"].values()
    if detector is not None:
        kind["birth"]["detector"] = dict(detector)
    if variant == "place alone":
        kind["nodes"]["seen"]["agent"] = "detection"
    if variant in ("no return", "place alone"):
        kind["reidentify"] = {"lost": False, "min_probability": 1}
    return check_graph(plain)


def tracked(
    graph: CheckedGraph, source: FrameSource, detector: Detector | None, seed: int
) -> tuple[Tracks, float, list[int]]:
    """The tracks of a run, frames per second of tracking, and how many nets were live in each frame."""
    engine = make_engine(graph, seed, detectors={} if detector is None else {"detections": detector})
    rows: list[tuple[float, ...]] = []
    nets: list[int] = []
    numbers: dict[str, int] = {}
    seconds = 0.0
    for result in run(graph, source, [], seed=seed, engine=engine):
        seconds += result.total_seconds
        nets.append(len(result.targets))
        for one in result.targets:
            number = numbers.setdefault(one.target, len(numbers))
            if one.status != "lost":
                rows.append((one.frame, number, *corner_from_centre(np.array(one.centre_box))))
    table = np.array(rows, dtype=np.float64).reshape(-1, 6)
    frames, ids = (table[:, k].astype(np.int64) for k in (0, 1))
    return Tracks(frames, ids, table[:, 2:]), len(nets) / seconds, nets


def row(truth: Tracks, runs: Sequence[tuple[Tracks, float, list[int]]]) -> str:
    """Means over runs, as cells of a table."""
    scores = [score_mot(truth, tracks) for tracks, _, _ in runs]
    figures = {name: np.mean([getattr(one, name) for one in scores]) for name in ("mota", "idf1", "hota")}
    counts = {
        name: np.mean([getattr(one, name) for one in scores]) for name in ("fp", "fn", "idsw", "track_ids")
    }
    fps = np.mean([speed for _, speed, _ in runs])
    nets = [count for _, _, live in runs for count in live]
    cells = [f"{value:.3f}" for value in figures.values()] + [f"{value:.1f}" for value in counts.values()]
    return " | ".join([*cells, f"{fps:.0f}", f"{np.mean(nets):.1f} / {max(nets)}"])


def compare(truth: Tracks, source: FrameSource, kind: str, seeds: int) -> None:
    """Print one line for each graph on detections of a kind."""
    given = DETECTORS.get(kind)
    for name in GRAPHS:
        for variant in VARIANTS if name == "people_detections" else VARIANTS[:1]:
            graph = graph_of(name, variant, None if given is None else {kind: given})
            runs = []
            for seed in range(seeds if given is None else 1):
                found = noisy(truth, seed, source.width, source.height)
                runs.append(tracked(graph, source, FileDetector(found) if given is None else None, seed))
            print(f"| {kind} | {name}, {variant} | {row(truth, runs)} |", flush=True)


def compare_files(data: Path, truth: Tracks, source: FrameSource) -> None:
    """Print one line for each graph on each file of detections in a folder."""
    for path in sorted(data.glob("detections_*.txt")):
        for name in OF_FILES:
            runs = [tracked(load_graph(name), source, file_detector(path), 0)]
            print(f"| {path.name} | {name} | {row(truth, runs)} |", flush=True)


def hostile(source: FrameSource) -> None:
    """Print live nets and frames per second under detections that are of no use."""
    rng = np.random.default_rng(0)

    def boxes(count: int) -> Floats:
        sides = np.full((count, 2), [60.0, 150.0])
        return np.hstack([rng.uniform([0, 0], [source.width, source.height], (count, 2)), sides])

    def says(found: Callable[[int], Floats]) -> FileDetector:
        boxes_of = {frame: found(frame) for frame in range(71)}
        return FileDetector({k: Detections(b, np.ones(len(b)), ("",) * len(b)) for k, b in boxes_of.items()})

    walker = np.array([100.0, 250, 60, 150])
    cases = {
        "1000 boxes a frame": says(lambda frame: boxes(1000)),
        "none": says(lambda frame: np.empty((0, 4))),
        "one object twice": says(
            lambda frame: walker + [[5.0 * frame, 0, 0, 0], [5.0 * frame + 3, 2, 1, -2]]
        ),
    }
    for name in GRAPHS:
        for case, detector in cases.items():
            _, fps, nets = tracked(load_graph(name), source, detector, 0)
            print(f"| {case} | {name} | {max(nets)} | {fps:.1f} |", flush=True)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--only", choices=["noisy", "files", *DETECTORS, "hostile"])
    options = parser.parse_args()
    truth = read_mot_truth(options.data / "gt" / "gt.txt")
    with open_source(str(options.data / "img1")) as opened:
        source = Remembered(opened, tuple(opened))
    if options.only != "hostile":
        print("| detections | graph | MOTA | IDF1 | HOTA | FP | FN | switches | tracks | frames/s | nets |")
        print("|---|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|")
        for kind in ("noisy", *DETECTORS):
            if options.only in (None, kind):
                compare(truth, source, kind, options.seeds)
        if options.only in (None, "files"):
            compare_files(options.data, truth, source)
    if options.only in (None, "hostile"):
        print("\n| detections | graph | nets at most | frames/s |\n|---|---|---:|---:|")
        hostile(source)


if __name__ == "__main__":
    main()
