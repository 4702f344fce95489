"""A target hidden entirely for 11 or 22 frames: in how many runs is it found again, and how soon?

    python benchmarks/occlusion.py [--seeds 24] [--graphs general,color_fusion,two_squares]

The scene `occluder`: a patterned orange square passes behind a textured column at 4 px per frame. Found again
means a mean IoU above one half over the last ten frames; the delay counts from the first frame in which half
of the square can be seen again to the first with an IoU above one half. Mean shift (OpenCV, on the first
box's hue histogram) runs beside. Asked for: 45 of 48.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import cv2
import numpy as np
from measuring import environment, on_one_thread, table
from two_squares import held_to_the_end, opencv_run, track_scene

from bayesnet_track.numerics.boxes import centre_from_corner, overlap
from bayesnet_track.sources.scenes import Scene
from bayesnet_track.sources.scenes.shapes import occluder

HIDDEN = (11, 22)


@dataclass(frozen=True)
class Found:
    """One run.

    Attributes:
        again: whether the target was held at the end.
        delay: frames from seeing half of it again to an IoU above one half; None when that never came.
        lost_said: share of the hidden frames in which the status was lost.
    """

    again: bool
    delay: int | None
    lost_said: float = 0.0


def engine_run(graph: str, scene: Scene, seed: int) -> Found:
    """One run of the engine."""
    results = list(track_scene(graph, scene, seed))
    boxes = np.array([result.targets[0].centre_box for result in results])
    lost = np.array([result.targets[0].status == "lost" for result in results])
    good = overlap(boxes, centre_from_corner(scene.truth)) > 0.5
    hidden = np.flatnonzero(scene.visible == 0)
    seen = np.flatnonzero(scene.visible >= 0.5)
    back = int(seen[seen > hidden[-1]][0])
    delay = int(good[back:].argmax()) if good[back:].any() else None
    return Found(held_to_the_end(boxes, scene), delay, float(lost[hidden].mean()))


def row(name: str, hidden: int, runs: list[Found]) -> list[str]:
    """A line of the table."""
    delays = [one.delay for one in runs if one.again and one.delay is not None]
    delay = f"{np.median(delays):g} (at most {max(delays)})" if delays else "-"
    said = f"{np.mean([one.lost_said for one in runs]):.0%}"
    return [name, str(hidden), f"{sum(one.again for one in runs)} of {len(runs)}", delay, said]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=24)
    parser.add_argument("--graphs", default="general,color_fusion,two_squares")
    options = parser.parse_args()
    on_one_thread()
    rows = []
    for hidden in HIDDEN:
        scenes = [occluder(seed, hidden) for seed in range(options.seeds)]
        for graph in options.graphs.split(","):
            runs = [engine_run(graph, scene, seed) for seed, scene in enumerate(scenes)]
            rows.append(row(graph, hidden, runs))
        shifted = [Found(opencv_run(cv2.meanShift, scene).held, None) for scene in scenes]
        rows.append([*row("cv2.meanShift", hidden, shifted)[:3], "-", "-"])
    print(environment() + "\n")
    print(table(["", "hidden frames", "found again", "delay, median frames", "lost while hidden"], rows))


if __name__ == "__main__":
    main()
