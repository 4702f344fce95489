"""Milliseconds of the grid belief: 128 x 128 cells of position with a few of velocity.

Usage: python benchmarks/grid.py
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import numpy as np

from bayesnet_track.belief.contract import Evidence
from bayesnet_track.belief.grid.belief import GridFilter
from bayesnet_track.belief.grid.cells import GridBelief, Lattice
from bayesnet_track.belief.grid.motion import predict_grid
from bayesnet_track.belief.motion.bounds import Confined
from bayesnet_track.belief.motion.models import make_motion
from bayesnet_track.graph import spec
from bayesnet_track.numerics.streams import Streams
from bayesnet_track.observation.cue import Hypotheses

WIDTH, HEIGHT = 640, 480
PLACE = np.array([320.0, 240.0])


def wide_belief(velocities: int, side: int = 128) -> GridBelief:
    """A belief that fills side x side cells of 2 px, velocities^2 of 2 px per frame."""
    v = 2.0 * (np.arange(velocities) - velocities // 2)
    x = np.arange(side) - (side - 1) / 2
    across, speeds = np.exp(-0.5 * (x / (0.3 * side)) ** 2), np.exp(-0.5 * (v / 3.0) ** 2)
    mass = np.einsum("a,b,c,d->abcd", speeds, speeds, across, across)[None]
    lattice = Lattice((320.0, 240.0), 2.0, -side // 2, -side // 2, (40.0, 40.0), np.zeros(1), v)
    first = np.outer(speeds, speeds)
    return GridBelief(mass / mass.sum(), lattice, first / first.sum())


def milliseconds(work: Callable[[], object], times: int = 15) -> tuple[float, float]:
    """Best and median of `times` runs, after one to warm up."""
    work()
    taken: list[float] = []
    for _ in range(times):
        begin = time.perf_counter()
        work()
        taken.append(1e3 * (time.perf_counter() - begin))
    return min(taken), float(np.median(taken))


def near_the_place(hypotheses: Hypotheses, prior_log: np.ndarray) -> Evidence:
    """Evidence of a place with an sd of 20 px."""
    return Evidence(-0.5 * np.sum((hypotheses.boxes[:, :2] - PLACE) ** 2, axis=1) / 400.0)


def main() -> None:
    """Print the table."""
    noise = {"sd_px": {"x": 2, "y": 2}, "sd_velocity_px": 1}
    motion = Confined(make_motion(spec.Motion.model_validate({"constant_velocity": noise})), WIDTH, HEIGHT)
    streams = Streams(0)
    stream = partial(streams.of, "1", "root", 1)
    print("cells             propagation: best  median  steps/s   whole step: best  median ms")
    for velocities in (5, 7, 9):
        belief = wide_belief(velocities)
        step = GridFilter(spec.Grid(velocity_cells=velocities)).step
        best, median = milliseconds(partial(predict_grid, belief, motion, 1.0, 128))
        whole = milliseconds(partial(step, belief, motion, 1.0, near_the_place, stream))
        cells = f"128x128x{velocities}x{velocities}"
        print(
            f"{cells:<17}         {best:8.1f}{median:8.1f}{1e3 / median:9.0f}         "
            f"{whole[0]:8.1f}{whole[1]:8.1f}"
        )


if __name__ == "__main__":
    main()
