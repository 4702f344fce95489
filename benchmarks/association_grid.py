"""Identities of boxes that move by a multiple of their own size a frame: alone, and among 20 others.

    python benchmarks/association_grid.py [--seeds 100-104] [--graphs kalman_detections,jpda]

A target is detected in every one of 20 frames, with errors of 3 % of its sides (`simulated/moving_boxes.py`).
Alone (3840x2160 px): how many identities it is given, in how many of the runs it is exactly one, and in what
share of the frames after the third it has one. Among 20 others that move alike (1500x840 px, five sides apart
on average): identity switches, beside those of linking the nearest centres within 3.5 sides.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np
from measuring import environment, on_one_thread, table
from numpy.typing import NDArray

from bayesnet_track import DetectionsTracker
from bayesnet_track.numerics.boxes import corner_from_centre
from simulated.moving_boxes import (
    MotionCell,
    count_switches,
    detect_boxes,
    link_nearest,
    move_boxes,
)

FRAMES, NOISE, REACH = 20, 0.03, 3.5
ALONE, CROWD, OTHERS = (3840, 2160), (1500, 840), 20
SHIFTS = {
    "straight": (0.0, 0.5, 1.0, 2.0, 3.0),
    "random walk": (0.25, 0.5, 0.75, 1.0),
    "u-turn": (0.25, 0.5, 0.75, 1.0),
}
GROWTHS = (-0.1, -0.05, 0.0, 0.05, 0.1)
CELLS = [
    MotionCell(kind, shift, growth)  # type: ignore[arg-type]
    for kind, shifts in SHIFTS.items()
    for shift in shifts
    for growth in GROWTHS
]
GRAPHS = ("kalman_detections", "people_detections", "jpda")


def identities(graph: str, boxes: NDArray[np.float64], size: tuple[int, int]) -> NDArray[np.int64]:
    """(frames, count) the identity that each detection (frames, count, 4) is given; -1: none."""
    tracker, image = DetectionsTracker(graph, size=size), np.zeros((size[1], size[0], 3), np.uint8)
    looks = graph == "people_detections"
    ids = np.empty(boxes.shape[:2], np.int64)
    for row, now in zip(ids, boxes, strict=True):
        corners = corner_from_centre(now)
        corners[:, 2:] += corners[:, :2]
        found = SimpleNamespace(xyxy=corners, confidence=np.full(len(now), 0.9))
        row[:] = (tracker.update(found, image) if looks else tracker.update(found)).tracker_id
    return ids


def scene(cell: MotionCell, count: int, size: tuple[int, int], seed: int) -> NDArray[np.float64]:
    """Detections of one run."""
    rng = np.random.default_rng([seed, count])
    return detect_boxes(move_boxes(cell, count, FRAMES, size, rng), NOISE, rng)


def alone(graph: str, cell: MotionCell, seeds: Sequence[int]) -> tuple[list[int], float]:
    """Identities of each run, and the share of frames after the third with one."""
    runs = [identities(graph, scene(cell, 1, ALONE, seed), ALONE) for seed in seeds]
    counts = [len(set(run[run > -1].tolist())) for run in runs]
    return counts, float(np.mean([run[3:] > -1 for run in runs]))


def among_others(graph: str, cell: MotionCell, seeds: Sequence[int]) -> tuple[int, int, float]:
    """Switches of a graph and of linking, and the share of detections from frame 3 on with an identity."""
    own, linked, held = 0, 0, []
    for seed in seeds:
        boxes = scene(cell, OTHERS + 1, CROWD, seed)
        ids = identities(graph, boxes, CROWD)
        own += count_switches(ids)
        linked += count_switches(link_nearest(boxes, REACH))
        held.append(ids[3:] > -1)
    return own, linked, float(np.mean(held))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--seeds", default="100-104", help="first and last seed")
    parser.add_argument("--graphs", default=",".join(GRAPHS))
    parser.add_argument("--crowds", default="0", help="growths among others, comma-separated; empty: none")
    chosen = parser.parse_args()
    on_one_thread()
    print(environment(), flush=True)
    low, high = (int(word) for word in chosen.seeds.split("-"))
    seeds = range(low, high + 1)
    graphs = chosen.graphs.split(",")
    rows = []
    for cell in CELLS:
        row = [cell.kind, f"{cell.shift:g}", f"{100 * cell.growth:+g} %"]
        for graph in graphs:
            counts, held = alone(graph, cell, seeds)
            row += [f"{sum(one == 1 for one in counts)}/{len(counts)}", f"{held:.2f}"]
        rows.append(row)
    head = [word for graph in graphs for word in (f"{graph}: one identity", "held")]
    print(table(["motion", "shift / side", "growth", *head], rows), flush=True)
    rows, growths = [], [float(word) for word in chosen.crowds.split(",") if word]
    for cell in (one for one in CELLS if one.growth in growths):
        row = [cell.kind, f"{cell.shift:g}", f"{100 * cell.growth:+g} %"]
        for k, graph in enumerate(graphs):
            own, linked, held = among_others(graph, cell, seeds)
            row += ([str(linked)] if k == 0 else []) + [str(own), f"{held:.2f}"]
        rows.append(row)
    head = [word for graph in graphs for word in (f"{graph}: switches", "held")]
    print(table(["motion", "shift / side", "growth", "nearest centre: switches", *head], rows))


if __name__ == "__main__":
    main()
