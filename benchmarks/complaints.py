"""Identities in the situations that people who track complain of: a row each, a column for each graph.

    python benchmarks/complaints.py [--seeds 500-503] [--graphs kalman_detections,jpda,sort,bytetrack]

All detections are drawn, with errors of 3 % of the sides. Printed are the identity switches of all seeds,
and how many identities each target has on average; few identities in few frames are no success, so that the
share of detections with one is printed where it is below a half. `docs/benchmarks/crowds.md` has the table.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from types import SimpleNamespace

import numpy as np
from association_grid import NOISE, count_switches, detect_boxes, link_nearest
from measuring import environment, on_one_thread, table
from numpy.typing import NDArray

from bayesnet_track import DetectionsTracker
from bayesnet_track.numerics.boxes import corner_from_centre

Boxes = NDArray[np.float64]
GRAPHS = ("kalman_detections", "jpda", "sort", "bytetrack", "oc_sort")
NEAREST = "nearest centre"
SIZE = (1000, 600)
REACH_SIDES = 3.5


def fish(rng: np.random.Generator) -> Boxes:
    """Twenty fish that wander, cross and are missed in a tenth of the frames, (80, 20, 4)."""
    at, heading = rng.uniform(0.1, 0.9, (20, 2)) * SIZE, rng.uniform(0, 2 * np.pi, 20)
    boxes = np.empty((80, 20, 4))
    for row in boxes:
        row[:] = np.column_stack([at, np.tile([30.0, 18.0], (20, 1))])
        heading = heading + rng.normal(0, 0.35, 20)
        at = at + 7.0 * np.column_stack([np.cos(heading), np.sin(heading)])
        heading = np.where((at < 0).any(axis=1) | (at > SIZE).any(axis=1), heading + np.pi, heading)
        at = np.clip(at, 0, SIZE)
    boxes[rng.random(boxes.shape[:2]) < 0.1] = np.nan
    return boxes


def cells(rng: np.random.Generator) -> Boxes:
    """Fifty cells of 10 px that step at random by 2.5 px, (60, 50, 4)."""
    steps = rng.normal(0, 2.5, (60, 50, 2))
    at = rng.uniform(20, 480, (50, 2)) + np.cumsum(steps, axis=0)
    return np.concatenate([at, np.full((60, 50, 2), 10.0)], axis=2)


def cars(rng: np.random.Generator) -> Boxes:
    """Six cars in lanes of their own that move by 1 to 2.5 lengths a frame, (14, 6, 4)."""
    speed = rng.uniform(1.0, 2.5, 6) * 40 * np.where(np.arange(6) % 2, -1, 1)
    start = np.where(speed > 0, 20.0, SIZE[0] - 20.0)
    x = start + speed * np.arange(14)[:, None]
    y = np.broadcast_to(80.0 + 80 * np.arange(6), x.shape)
    boxes = np.stack([x, y, np.full(x.shape, 40.0), np.full(x.shape, 24.0)], axis=2)
    boxes[(x < 0) | (x > SIZE[0])] = np.nan
    return boxes


def u_turn(rng: np.random.Generator) -> Boxes:
    """A player who turns round at once, (50, 1, 4)."""
    turn, step = rng.integers(12, 35), rng.uniform(5, 15)
    frames = np.arange(50)
    x = 200 + step * np.minimum(frames, turn) - step * np.maximum(frames - turn, 0)
    return np.stack([x, np.full(50, 200.0), np.full(50, 30.0), np.full(50, 60.0)], axis=1)[:, None]


def stop(rng: np.random.Generator) -> Boxes:
    """A car that brakes behind a bus, is hidden for 19 frames, and drives on, (90, 1, 4)."""
    frames, step = np.arange(90), rng.uniform(4, 7)
    x = 50 + step * np.minimum(frames, 30) + step * np.maximum(frames - 60, 0)
    boxes = np.stack([x, np.full(90, 200.0), np.full(90, 60.0), np.full(90, 40.0)], axis=1)[:, None]
    boxes[36:55] = np.nan
    return boxes


def mice(rng: np.random.Generator) -> Boxes:
    """Two mice that meet, are one detection for six frames, and pass or turn back, (60, 2, 4)."""
    frames, passes = np.arange(60), rng.random() < 0.5
    way = np.abs(frames - 30.0) * 6.0
    signs = np.where(frames < 30, -1.0, 1.0 if passes else -1.0)
    x = np.stack([300 + signs * way, 300 - signs * way], axis=1) + rng.normal(0, 0.5, (60, 2))
    boxes = np.stack([x, np.full((60, 2), 200.0), np.full((60, 2), 34.0), np.full((60, 2), 22.0)], axis=2)
    boxes[27:33, 1] = np.nan
    boxes[27:33, 0, 0], boxes[27:33, 0, 2] = 300.0, 50.0
    return boxes


SITUATIONS: Mapping[str, Callable[[np.random.Generator], Boxes]] = {
    "fish that wander and cross": fish,
    "cells that step at random": cells,
    "cars at a low frame rate": cars,
    "a U-turn": u_turn,
    "a stop behind a bus": stop,
    "mice that touch": mice,
}


def identities(graph: str, boxes: Boxes) -> NDArray[np.int64]:
    """(frames, count) identity of each detection (frames, count, 4), NaN where there is none; -1: none."""
    is_there = ~np.isnan(boxes[..., 0])
    ids = np.full(boxes.shape[:2], -1)
    if graph == NEAREST:
        linked = link_nearest(np.nan_to_num(boxes, nan=-1e6), REACH_SIDES)
        return np.where(is_there, linked, -1)
    tracker = DetectionsTracker(graph, size=SIZE)
    for row, present, detected in zip(ids, is_there, boxes, strict=True):
        corners = corner_from_centre(detected[present])
        corners[:, 2:] += corners[:, :2]
        row[present] = tracker.update(
            SimpleNamespace(xyxy=corners, confidence=np.full(len(corners), 0.9))
        ).tracker_id
    return ids


def entry(graph: str, situation: Callable[[np.random.Generator], Boxes], seeds: range) -> str:
    """Switches, and identities for each target; the share of detections with one where it is below a half."""
    switches, numbers, shares = 0, [], []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        boxes = detect_boxes(situation(rng), NOISE, rng)
        ids = identities(graph, boxes)
        switches += count_switches(ids)
        numbers += [len(set(column[column > -1].tolist())) for column in ids.T]
        shares.append(float(np.mean(ids[~np.isnan(boxes[..., 0])] > -1)))
    share = f" (in {np.mean(shares):.0%} of frames)" if np.mean(shares) < 0.5 else ""
    return f"{switches}; {np.mean(numbers):.2f}{share}"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--seeds", default="500-503", help="first and last seed")
    parser.add_argument("--graphs", default=",".join(GRAPHS))
    chosen = parser.parse_args()
    on_one_thread()
    print(environment(), flush=True)
    low, high = (int(word) for word in chosen.seeds.split("-"))
    graphs = (NEAREST, *chosen.graphs.split(","))
    rows = [
        [name, *(entry(graph, situation, range(low, high + 1)) for graph in graphs)]
        for name, situation in SITUATIONS.items()
    ]
    print(table(["situation", *graphs], rows))


if __name__ == "__main__":
    main()
