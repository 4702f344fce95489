"""Reliability of the reported probability that a target exists: ten bins, on drawn crowds with ground truth.

    python benchmarks/existence.py [--seeds 700-704] [--graph jpda] [--frames 300]
    python benchmarks/existence.py --detections FILE --truth FILE --images FOLDER

A reported target exists in a frame if it is a person's, one to one and the nearest first, whether the person
is detected there or not: within 25 px on the crowds, with an overlap of .3 or more in files (MOT). Of each
bin are printed the share of its targets that exist, their mean probability, and their number.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from crowd_association import CELLS, NEAR_PX, FileDetector, _advance
from measuring import environment, on_one_thread, table
from numpy.typing import NDArray

from bayesnet_track import load_graph
from bayesnet_track.engine.step import make_engine
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.numerics.boxes import overlap
from bayesnet_track.observation.detector import Detections
from bayesnet_track.observation.planes import Frame
from simulated.crowd_detector import DetectorSettings, detect_crowd
from simulated.walkers import CrowdSettings, make_crowd

BINS = 10
LEAST_OVERLAP = 0.3
Pairs = list[tuple[float, bool]]


def probabilities(
    graph: CheckedGraph, detector: FileDetector, frames: int, size: tuple[int, int]
) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Frame by frame, (T,) the probabilities that the targets exist, and (T, 4) their centre boxes."""
    engine = make_engine(graph, 0, detectors={"detections": detector})
    image, state = np.zeros((size[1], size[0], 3), np.uint8), None
    for index in range(frames):
        outcome = _advance(
            graph, engine, state, Frame(index=index, time=float(index), time_s=index / 25, image=image)
        )
        state = outcome.state
        lines = [line for line in outcome.metrics if line.existence is not None]
        yield (
            np.array([line.existence for line in lines], dtype=np.float64),
            np.array([line.centre_box for line in lines], dtype=np.float64).reshape(-1, 4),
        )


def pair_up(existence: NDArray[np.float64], cost: NDArray[np.float64], most: float) -> Pairs:
    """Each target's probability, and whether it is somebody's; costs (T, N) up to `most`, the least first."""
    is_real, is_free = np.zeros(len(existence), bool), np.ones(cost.shape[1], bool)
    for row, column in zip(*np.unravel_index(np.argsort(cost, axis=None), cost.shape), strict=True):
        if cost[row, column] > most:
            break
        if is_free[column] and not is_real[row]:
            is_real[row], is_free[column] = True, False
    return list(zip(existence.tolist(), is_real.tolist(), strict=True))


def of_crowd(graph: CheckedGraph, settings: DetectorSettings, seed: int, frames: int) -> Pairs:
    """A drawn crowd."""
    crowd = make_crowd(CrowdSettings(frames=frames), seed)
    detected = detect_crowd(crowd, settings, seed)
    detector = FileDetector({index: one.detections for index, one in enumerate(detected)})
    size, pairs = (crowd.settings.width, crowd.settings.height), Pairs()
    for people, (existence, boxes) in zip(
        crowd.boxes, probabilities(graph, detector, len(crowd.boxes), size), strict=True
    ):
        people = people[np.isfinite(people[:, 0])]
        pairs += pair_up(existence, np.linalg.norm(boxes[:, None, :2] - people[None, :, :2], axis=2), NEAR_PX)
    return pairs


def of_files(graph: CheckedGraph, detections: Path, truth: Path, images: Path) -> Pairs:
    """A sequence with files of detections and of ground truth, both MOT."""
    import cv2

    names = sorted(path for path in images.iterdir() if path.suffix in (".jpg", ".png"))
    height, width = cv2.imread(str(names[0])).shape[:2]

    def rows(path: Path) -> dict[int, NDArray[np.float64]]:
        lines = np.atleast_2d(np.loadtxt(path, delimiter=",", usecols=range(7)))
        lines[:, 2:4] += lines[:, 4:6] / 2
        return {int(k) - 1: lines[lines[:, 0] == k] for k in np.unique(lines[:, 0])}

    def as_detections(lines: NDArray[np.float64]) -> Detections:
        order = np.argsort(-lines[:, 6], kind="stable")
        return Detections(lines[order, 2:6], np.clip(lines[order, 6], 0.0, 1.0), ("person",) * len(order))

    people, pairs = rows(truth), Pairs()
    detector = FileDetector({index: as_detections(lines) for index, lines in rows(detections).items()})
    each = probabilities(graph, detector, len(names), (width, height))
    for index, (existence, boxes) in enumerate(each):
        true = people.get(index, np.empty((0, 7)))[:, 2:6]
        shared = np.array([overlap(true, box) for box in boxes]).reshape(len(boxes), len(true))
        pairs += pair_up(existence, -shared, -LEAST_OVERLAP)
    return pairs


def bins_of(pairs: Pairs) -> list[tuple[int, float, float]]:
    """Count, mean probability and share that exist of each bin; NaN where it is empty."""
    values = np.array(pairs, dtype=np.float64).reshape(-1, 2)
    which = np.minimum((values[:, 0] * BINS).astype(int), BINS - 1)
    bins = []
    for k in range(BINS):
        chosen = values[which == k]
        mean = chosen.mean(axis=0) if len(chosen) else np.full(2, np.nan)
        bins.append((len(chosen), float(mean[0]), float(mean[1])))
    return bins


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--seeds", default="700-704", help="first and last seed")
    parser.add_argument("--graph", default="jpda")
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--detections", type=Path)
    parser.add_argument("--truth", type=Path)
    parser.add_argument("--images", type=Path)
    chosen = parser.parse_args()
    on_one_thread()
    print(environment(), flush=True)
    graph = load_graph(chosen.graph)
    if chosen.detections is not None:
        by_name = {
            chosen.detections.name: bins_of(of_files(graph, chosen.detections, chosen.truth, chosen.images))
        }
    else:
        low, high = (int(word) for word in chosen.seeds.split("-"))
        by_name = {}
        for name, settings in CELLS.items():
            several = [
                of_crowd(graph, DetectorSettings(**settings), k, chosen.frames) for k in range(low, high + 1)
            ]
            by_name[name] = bins_of([pair for pairs in several for pair in pairs])
    head = ["crowd", *(f"{k / BINS:.1f}" for k in range(BINS)), "largest error"]
    rows = []
    for name, bins in by_name.items():
        cells = [f"{share:.2f} of {mean:.2f} ({count})" if count else "" for count, mean, share in bins]
        errors = [abs(share - mean) for count, mean, share in bins if count >= 100]
        rows.append([name, *cells, f"{max(errors):.2f}"])
    print(table(head, rows))


if __name__ == "__main__":
    main()
