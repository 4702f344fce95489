"""Example 1 of the thesis over many seeds and geometries: how often is the right square held to the end?

    python benchmarks/two_squares.py [--seeds 50] [--geometries 50] [--first 0]

Prints, for colour only, motion only, both always, adaptive (the graph `two_squares`), velocity (the graph
`two_squares_velocity`), and OpenCV's mean shift and CamShift: runs held to the end and mean agents per frame,
in the stated geometry and in random ones.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.journal.events.switches import Activated, Deactivated
from bayesnet_track.numerics.boxes import centre_from_corner, overlap
from bayesnet_track.runtime.results import Result
from bayesnet_track.runtime.run import Start, run
from bayesnet_track.sources.scenes import Scene, random_geometry, two_squares
from bayesnet_track.sources.scenes.library import SceneSource

LAST = 10


@dataclass(frozen=True)
class Held:
    """One run: whether the target was held to the end, agents per frame, motion's switches."""

    held: bool
    agents: float
    switches: tuple[tuple[int, str, str], ...] = ()


def track_scene(graph: GraphSpec | str, scene: Scene, seed: int) -> Iterator[Result]:
    """Track the scene's target from its true first box."""
    source = SceneSource(scene, f"scene:{scene.name}")
    return run(load_graph(graph), source, [Start(scene.start_box)], seed=seed)


def without_adaptation(agents: frozenset[str]) -> GraphSpec:
    """The graph `two_squares` with only `agents`, always on."""
    written = load_graph("two_squares").spec.model_dump(exclude_none=True)
    (plate,) = written["targets"].values()
    nodes = plate["nodes"]
    for name in [name for name, node in nodes.items() if "agent" in node and name not in agents]:
        del nodes[name]
    for node in nodes.values():
        node.pop("adapt", None)
    return GraphSpec.model_validate(written)


def held_to_the_end(boxes: np.ndarray, scene: Scene) -> bool:
    """Mean IoU with the target over the last ten frames above one half."""
    truth = centre_from_corner(scene.truth)
    return float(overlap(boxes[-LAST:], truth[-LAST:]).mean()) > 0.5


def engine_run(graph: GraphSpec | str, scene: Scene, seed: int) -> Held:
    """One run of the engine."""
    results = list(track_scene(graph, scene, seed))
    boxes = np.array([result.targets[0].centre_box for result in results])
    agents = float(np.mean([len(result.targets[0].active) for result in results[1:]]))
    switches = tuple(
        (decision.frame, type(decision).__name__, decision.node)
        for result in results
        for decision in result.decisions
        if isinstance(decision, Activated | Deactivated)
    )
    return Held(held_to_the_end(boxes, scene), agents, switches)


def opencv_run(shift: Callable[..., tuple[object, tuple[int, int, int, int]]], scene: Scene) -> Held:
    """Mean shift or CamShift on the back-projection of the first box's hue histogram."""
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 10, 1)
    x, y, w, h = (round(value) for value in scene.start_box)
    window, boxes, histogram = (x, y, w, h), [], None
    for image in scene.frames:
        hsv = cv2.cvtColor(image, cv2.COLOR_BGR2HSV)
        colourful = cv2.inRange(hsv, (0, 60, 32), (180, 255, 255))
        if histogram is None:
            part = np.s_[y : y + h, x : x + w]
            histogram = cv2.calcHist([hsv[part]], [0], colourful[part], [16], [0, 180])
            cv2.normalize(histogram, histogram, 0, 255, cv2.NORM_MINMAX)
        else:
            back = cv2.calcBackProject([hsv], [0], histogram, [0, 180], 1) & colourful
            if window[2] > 0 and window[3] > 0:
                _, window = shift(back, window, stop)
        boxes.append(centre_from_corner(window))
    return Held(held_to_the_end(np.array(boxes), scene), 1.0)


TRACKERS: dict[str, Callable[[Scene, int], Held]] = {
    "colour only": lambda scene, seed: engine_run(without_adaptation(frozenset({"color"})), scene, seed),
    "motion only": lambda scene, seed: engine_run(without_adaptation(frozenset({"motion"})), scene, seed),
    "both always": lambda scene, seed: engine_run(
        without_adaptation(frozenset({"color", "motion"})), scene, seed
    ),
    "adaptive": lambda scene, seed: engine_run("two_squares", scene, seed),
    "velocity": lambda scene, seed: engine_run("two_squares_velocity", scene, seed),
    "cv2.meanShift": lambda scene, seed: opencv_run(cv2.meanShift, scene),
    "cv2.CamShift": lambda scene, seed: opencv_run(cv2.CamShift, scene),
}


def main() -> None:
    """Print the table, and when the adaptive net switched motion in the stated geometry."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--geometries", type=int, default=50)
    parser.add_argument("--first", type=int, default=0, help="seed of the first random geometry")
    parser.add_argument("--trackers", help="comma-separated; default all")
    options = parser.parse_args()
    chosen = options.trackers.split(",") if options.trackers else list(TRACKERS)

    random = range(options.first, options.first + options.geometries)
    groups = {
        "stated": [(seed, two_squares(seed)) for seed in range(options.seeds)],
        "random": [
            (seed, two_squares(seed, random_geometry(np.random.default_rng(seed)))) for seed in random
        ],
    }
    print("| tracker | geometry | held | agents per frame |\n|---|---|---:|---:|")
    switches: list[tuple[tuple[int, str, str], ...]] = []
    for name in chosen:
        for group, scenes in groups.items():
            runs = [TRACKERS[name](scene, seed) for seed, scene in scenes]
            if runs:
                agents = np.mean([one.agents for one in runs])
                print(
                    f"| {name} | {group} | {sum(one.held for one in runs)} of {len(runs)} | {agents:.2f} |",
                    flush=True,
                )
            if (name, group) == ("adaptive", "stated"):
                switches = [one.switches for one in runs]
    for seed, one in enumerate(switches):
        summary = ", ".join(
            f"{frame} {node} {'on' if kind == 'Activated' else 'off'}" for frame, kind, node in one
        )
        print(f"seed {seed}: {summary}")


if __name__ == "__main__":
    main()
