"""How far frames lie from the one before in real sequences, and how far frames of different sequences.

    python benchmarks/scene_cuts.py DATA_FOLDER [--half A] [--level 0.3] [--pairs 20]

Printed are the largest distance of two frames in a row (`vision/scenes.py`), the quantiles of that between
frames of different sequences (`--pairs` random ones of each two), how many of either a level gets wrong, how
often a single brighter frame would be taken for a cut, and the time of a frame.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from measuring import Image, environment, on_one_thread, table
from real_video_coin import HALVES
from sequences import find_sequences

from bayesnet_track.vision.scenes import Scene, compare_scenes, describe_scene

FLASHES = (1.5, 2.0, 3.0)
"""Factors by which a frame is brighter than the others."""
EVERY = 20
"""Frames from one flash to the next."""


def distances(pairs: Iterable[tuple[Scene | None, Scene | None]]) -> list[float]:
    """Of the pairs in which both frames show a scene."""
    return [compare_scenes(a, b).distance for a, b in pairs if a is not None and b is not None]


def time_of(image: Image) -> float:
    """Median milliseconds of a frame."""
    before, spent = describe_scene(image), []
    for _ in range(500):
        started = time.perf_counter()
        scene = describe_scene(image)
        if before is not None and scene is not None:
            compare_scenes(before, scene)
        spent.append(time.perf_counter() - started)
    return 1000.0 * float(np.median(spent))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path)
    parser.add_argument("--half", choices=("A", "B"), default="A")
    parser.add_argument("--level", type=float, default=0.3)
    parser.add_argument("--pairs", type=int, default=20)
    options = parser.parse_args()
    on_one_thread()
    scenes: dict[str, list[Scene | None]] = {}
    flashes: dict[float, list[float]] = {factor: [] for factor in FLASHES}
    rows, within, image = [], [], np.zeros((1, 1, 3), np.uint8)
    for one in find_sequences(options.data, list(HALVES[options.half]), None):
        own: list[Scene | None] = []
        for index, image in enumerate(one.images()):
            own.append(describe_scene(image))
            for factor in FLASHES if index and index % EVERY == 0 else ():
                bright = describe_scene(cv2.convertScaleAbs(image, alpha=factor))
                flashes[factor] += distances([(own[-2], bright)])
        scenes[one.name] = own
        found = distances(pairwise(own))
        within += found
        rows.append([one.name, str(len(own)), f"{max(found):.3f}"])
    rng = np.random.default_rng(0)
    across = distances(
        (rng.choice(np.array(a)), rng.choice(np.array(b)))
        for name, a in scenes.items()
        for other, b in scenes.items()
        if other != name
        for _ in range(options.pairs)
    )
    print(environment() + "\n")
    print(table(["sequence", "frames", "largest"], rows))
    quantiles = np.quantile(across, (0.0, 0.01, 0.05, 0.5))
    print(f"\nhalf {options.half}, level {options.level:g}")
    print(f"frames in a row: largest {max(within):.3f}, {np.sum(np.array(within) > options.level)} too far")
    print("different sequences, quantiles 0, .01, .05, .5: " + ", ".join(f"{q:.3f}" for q in quantiles))
    print(f"  not far enough: {np.mean(np.array(across) <= options.level):.4f} of {len(across)}")
    for factor, found in flashes.items():
        wrong = np.sum(np.array(found) > options.level)
        print(f"one frame {factor:g} times as bright: {wrong} of {len(found)} too far; the others are blank")
    small = cv2.resize(image, (320, 240))
    print(f"time of a frame of 320 x 240 px: {time_of(np.asarray(small, np.uint8)):.3f} ms")


if __name__ == "__main__":
    main()
