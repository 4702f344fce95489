"""What a frame with many targets costs: 1 to 50 targets of 200 hypotheses, 640x480, alone and joined.

    python benchmarks/many_targets.py [--frames 60]

Coloured squares of 24 px wander over a blurred background and turn at the borders; each has one agent, a
colour histogram that learns. Joined, an `occlusion` join ties those that come near each other. Frames are in
memory, everything runs on one thread. CPU time is the median over the frames: on a busy machine it says more
than the wall. Asked for: 20 frames a second with 50 targets, in time that grows as their number does.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from measuring import environment, on_one_thread, table

from bayesnet_track.engine.step import State, make_engine, start_target, step
from bayesnet_track.graph.text.load import load_graph, read_graph
from bayesnet_track.numerics.boxes import overlap
from bayesnet_track.observation.planes import Frame

COUNTS = (1, 5, 10, 25, 50)
WARM_UP = 10
WIDTH, HEIGHT, SIDE = 640, 480, 24

GRAPH = """
bayesnet: 1
name: many
targets:
  square:
    nodes:
      square:
        belief: {particles: {size: 200}}
        motion: {constant_velocity: {sd_velocity_px: 1}}
        ud_fields: [x, y]
        learn: {below: {ud_px2: 100}, rate_max: 0.05}
      color: {parent: square, agent: {color_histogram: {floor: 0.003}}}
"""
JOINS = """
joins:
  - occlusion: {stay: 0.95}
"""


class Squares:
    """Where the squares are, and the pictures of them."""

    def __init__(self, count: int) -> None:
        rng = np.random.default_rng(0)
        background = rng.integers(90, 160, (HEIGHT, WIDTH, 3), dtype=np.uint8)
        self.background = cv2.GaussianBlur(background, (0, 0), 3)
        self.first = rng.uniform([40, 40], [WIDTH - 40, HEIGHT - 40], (50, 2))[:count]
        self.velocities = rng.normal(0, 2, (50, 2))[:count]
        hues = np.array([[[hue, 220, 200] for hue in rng.integers(0, 180, 50)]], np.uint8)
        self.colours = cv2.cvtColor(hues, cv2.COLOR_HSV2BGR)[0][:count].tolist()

    def centres(self, index: int) -> np.ndarray:
        """(N, 2) px; between 20 px from one border and 20 px from the other, there and back."""
        room = np.array([WIDTH - 40, HEIGHT - 40])
        along = (self.first + self.velocities * index - 20) % (2 * room)
        return np.rint(np.minimum(along, 2 * room - along) + 20)

    def frame(self, index: int) -> Frame:
        """The picture."""
        image = self.background.copy()
        for (x, y), colour in zip(self.centres(index).astype(int).tolist(), self.colours, strict=True):
            cv2.rectangle(image, (x - SIDE // 2, y - SIDE // 2), (x + SIDE // 2, y + SIDE // 2), colour, -1)
        return Frame(index=index, time=float(index), time_s=index / 25, image=image)


@dataclass(frozen=True)
class Cost:
    """What so many targets cost.

    Attributes:
        count: number of targets.
        cpu_ms: median CPU time of a frame.
        wall_ms: median wall time of a frame.
        pairs: mean number of joined pairs.
        good: share of targets and frames with an overlap (IoU) above 0.5.
    """

    count: int
    cpu_ms: float
    wall_ms: float
    pairs: float
    good: float


def measured(count: int, joined: bool, frames: int) -> Cost:
    """The cost of `count` targets over so many frames, after the warm-up."""
    graph = load_graph(read_graph(GRAPH + JOINS if joined else GRAPH)[0])
    engine, squares = make_engine(graph, 0), Squares(count)
    state, first = State(), squares.frame(0)
    for k, (x, y) in enumerate(squares.centres(0)):
        state = start_target(engine, state, first, str(k + 1), "square", np.array([x, y, SIDE, SIDE])).state
    cpu, wall, pairs, good = [], [], [], []
    for index in range(1, WARM_UP + frames + 1):
        frame = squares.frame(index)
        started, started_wall = time.process_time(), time.perf_counter()
        outcome = step(engine, state, frame)
        spent, spent_wall = time.process_time() - started, time.perf_counter() - started_wall
        state = outcome.state
        if index <= WARM_UP:
            continue
        cpu.append(spent)
        wall.append(spent_wall)
        pairs.append(len(state.net.joins))
        truth = np.column_stack([squares.centres(index), np.full((count, 2), SIDE)])
        found = np.array([one.centre_box for one in outcome.metrics])
        good += [float(overlap(a, b)) > 0.5 for a, b in zip(found, truth, strict=True)]
    return Cost(
        count,
        1e3 * float(np.median(cpu)),
        1e3 * float(np.median(wall)),
        float(np.mean(pairs)),
        float(np.mean(good)),
    )


def line(costs: Sequence[Cost]) -> tuple[float, float]:
    """Slope in ms per target and the fixed ms of the straight line nearest to the CPU times."""
    slope, fixed = np.polyfit([cost.count for cost in costs], [cost.cpu_ms for cost in costs], 1)
    return float(slope), float(fixed)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--frames", type=int, default=60, help="frames measured of each setting")
    chosen = parser.parse_args()
    on_one_thread()
    print(environment())
    alone = [measured(count, False, chosen.frames) for count in COUNTS]
    joined = [measured(count, True, chosen.frames) for count in COUNTS]
    head = ["targets", "CPU ms per frame", "per target", "frames/s (wall)", "IoU > 0.5"] + [
        "joined: CPU ms per frame",
        "per target",
        "frames/s (wall)",
        "IoU > 0.5",
        "joined pairs",
    ]
    rows = [
        [
            str(a.count),
            *(_cells(a)),
            *(_cells(b)),
            f"{b.pairs:.1f}",
        ]
        for a, b in zip(alone, joined, strict=True)
    ]
    print(table(head, rows))
    for name, costs in (("alone", alone), ("joined", joined)):
        slope, fixed = line(costs)
        print(f"{name}: {fixed:.2f} ms + {slope:.3f} ms per target")


def _cells(cost: Cost) -> list[str]:
    each = cost.cpu_ms / cost.count
    return [f"{cost.cpu_ms:.1f}", f"{each:.2f}", f"{1e3 / cost.wall_ms:.0f}", f"{100 * cost.good:.0f} %"]


if __name__ == "__main__":
    main()
