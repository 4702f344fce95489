"""Identities of boxes that move by a multiple of their own size a frame: alone, and among 20 others.

    python benchmarks/association_grid.py [--seeds 100-104] [--graphs kalman_detections,jpda]

A target is detected in every one of 20 frames, with errors of 3 % of its sides.
Alone (3840x2160 px): how many identities it is given, in how many of the runs it is exactly one, and in what
share of the frames after the third it has one. Among 20 others that move alike (1500x840 px, five sides apart
on average): identity switches, beside those of linking the nearest centres within 3.5 sides.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Literal

import numpy as np
from measuring import environment, on_one_thread, table
from numpy.typing import NDArray

from bayesnet_track import DetectionsTracker
from bayesnet_track.numerics.boxes import corner_from_centre

Kind = Literal["straight", "random walk", "u-turn"]

WIDTH_TO_HEIGHT = 2 / 3
START_SIDES_PX = {-1: 98.0, 0: 49.0, 1: 14.7}
"""Geometric mean of the sides in the first frame, of boxes that shrink, stay, grow."""


FRAMES, NOISE, REACH = 20, 0.03, 3.5
ALONE, CROWD, OTHERS = (3840, 2160), (1500, 840), 20


@dataclass(frozen=True)
class MotionCell:
    """One cell of the grid.

    Attributes:
        kind: how the boxes move.
        shift: root mean square of the shift in a frame, over the geometric mean of the sides.
        growth: change of the sides in a frame, as a share of them.
    """

    kind: Kind
    shift: float
    growth: float = 0.0


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


def move_boxes(
    cell: MotionCell, count: int, frames: int, size: tuple[int, int], rng: np.random.Generator
) -> NDArray[np.float64]:
    """(frames, count, 4) centre boxes in an image (width, height), at whose borders centres turn back.

    A box alone starts so that a straight way leads through the middle of the image.
    """
    extent = np.array(size, float)
    angle = rng.uniform(0.0, 2.0 * np.pi, count) if count > 1 else np.zeros(1)
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    side = START_SIDES_PX[int(np.sign(cell.growth))] * (1.0 + cell.growth) ** np.arange(frames)
    at = rng.uniform(0.1, 0.9, (count, 2)) * extent
    if count == 1:
        at[0] = [0.1 * extent[0] if cell.kind == "straight" else 0.5 * extent[0], extent[1] / 2]
    boxes = np.empty((frames, count, 4))
    for frame in range(frames):
        w = side[frame] * WIDTH_TO_HEIGHT**0.5
        boxes[frame] = np.concatenate([at, np.tile([w, w / WIDTH_TO_HEIGHT], (count, 1))], axis=1)
        step = cell.shift * side[frame]
        if cell.kind == "random walk":
            at = at + rng.normal(0.0, step / 2**0.5, (count, 2))
        else:
            if cell.kind == "u-turn" and frame == frames // 2:
                direction = -direction
            at = at + step * direction
        outside = (at < 0) | (at > extent - 1)
        direction = np.where(outside, -direction, direction)
        at = np.abs(at)
        at = np.where(at > extent - 1, 2 * (extent - 1) - at, at)
    return boxes


def detect_boxes(boxes: NDArray[np.float64], noise: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """(frames, count, 4) the boxes with errors of sd `noise` times their sides."""
    return np.asarray(boxes + rng.normal(0.0, 1.0, boxes.shape) * noise * boxes[..., [2, 3, 2, 3]])


def link_nearest(boxes: NDArray[np.float64], reach: float) -> NDArray[np.int64]:
    """(frames, count) identities of nearest-centre linking: the nearest pairs first, within `reach` sides."""
    frames, count = boxes.shape[:2]
    ids = np.empty((frames, count), np.int64)
    ids[0], last = np.arange(count), count
    for frame in range(1, frames):
        before, now = boxes[frame - 1], boxes[frame]
        apart = np.linalg.norm(now[:, None, :2] - before[None, :, :2], axis=2)
        apart /= np.sqrt(now[:, 2] * now[:, 3])[:, None]
        ids[frame] = -1
        for row, column in zip(*np.unravel_index(np.argsort(apart, axis=None), apart.shape), strict=True):
            if apart[row, column] > reach:
                break
            if ids[frame, row] < 0 and ids[frame - 1, column] not in ids[frame]:
                ids[frame, row] = ids[frame - 1, column]
        new = ids[frame] < 0
        ids[frame, new] = last + np.arange(int(new.sum()))
        last += int(new.sum())
    return ids


def count_switches(ids: NDArray[np.int64]) -> int:
    """How often the identity of a column changes in (frames, count); below 0 there is none."""
    switches = 0
    for column in ids.T:
        known = column[column > -1]
        switches += int(np.count_nonzero(known[1:] != known[:-1]))
    return switches


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
