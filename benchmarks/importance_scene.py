"""A rendered target that leaps: how often is it held with and without a second pass, at equal cost?

Usage: python benchmarks/importance_scene.py [--seeds 20]

A textured orange square drifts over a cluttered background and in frames 12, 24 and 36 and the two after each
leaps farther than its motion model expects. Colour and intensity see it. Prints, for each importance
function, how many flights were overcome (overlap above one half five frames later), runs held to the end,
and second passes per run.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np

from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.sample_sizes import SecondPass
from bayesnet_track.numerics.boxes import centre_from_corner, overlap
from bayesnet_track.runtime.results import Result
from bayesnet_track.runtime.run import Start, run
from bayesnet_track.sources.scene_source import SceneSource
from bayesnet_track.sources.scenes.render import Sprite
from bayesnet_track.sources.scenes.scene import Scene, assemble
from bayesnet_track.sources.scenes.texture import ORANGE, shaded_cells, smooth_background

WIDTH, HEIGHT, SIDE, FRAMES = 320, 240, 16.0, 46
FLIGHTS = (12, 24, 36)
LEAPS = tuple(first + more for first in FLIGHTS for more in range(3))
AFTER = 7
"""Frames after the first leap of a flight at which it is judged."""

SIZE = 100


def leaping(seed: int, leap_px: float) -> Scene:
    """The scene: 320x240 px, a square of 16 px that drifts by 1 px per frame and leaps `leap_px`."""
    rng = np.random.Generator(np.random.Philox(seed))
    centre, path = np.array([160.0, 120.0]), []
    heading = rng.uniform(0, 2 * np.pi)
    for frame in range(FRAMES):
        step = leap_px if frame in LEAPS else 1.0
        new = centre + step * np.array([np.cos(heading), np.sin(heading)])
        while not ((new > SIDE) & (new < [WIDTH - SIDE, HEIGHT - SIDE])).all():
            heading = rng.uniform(0, 2 * np.pi)
            new = centre + step * np.array([np.cos(heading), np.sin(heading)])
        centre = new
        path.append([*centre, SIDE, SIDE])
        if frame in LEAPS and frame + 1 not in LEAPS:
            heading = rng.uniform(0, 2 * np.pi)
    background = smooth_background(WIDTH, HEIGHT, 110.0, 18.0, rng)
    sprite = Sprite(shaded_cells(6, 6, ORANGE, 0.75, rng), np.array(path))
    return assemble("leaping", background, (sprite,), 0, noise_sd=4.0, seed=seed)


def graph(size: int, importance: object, sd_px: float = 8.0) -> GraphSpec:
    """Colour and intensity for a box that drifts as a random walk."""
    nodes = {
        "square": {
            "belief": {"particles": {"size": size, "proposal": importance}},
            "motion": {"random_walk": {"sd_px": {"x": sd_px, "y": sd_px, "w": 0.5, "h": 0.5}}},
            "fuse": "product",
        },
        "color": {"parent": "square", "agent": {"color_histogram": {"floor": 0.001}}},
        "intensity": {"parent": "square", "agent": {"intensity": {"floor": 0.001}}},
    }
    return GraphSpec.model_validate(
        {"bayesnet": 1, "name": "leaping", "targets": {"square": {"nodes": nodes}}}
    )


@dataclass(frozen=True)
class Leaps:
    """What became of one run.

    Attributes:
        overcome: how many flights were overcome.
        held: whether the target was held in the last frame.
        passes: frames with a second pass.
        at_leaps: frames of leaps in which there was one.
    """

    overcome: int
    held: bool
    passes: int
    at_leaps: int


class Passes:
    """Gathers the frames with a second pass."""

    def __init__(self) -> None:
        """With none yet."""
        self.frames: list[int] = []

    def event(self, event: Event) -> None:
        """Keep the frame of a second pass."""
        if isinstance(event, SecondPass):
            self.frames.append(event.frame)

    def frame(self, result: Result) -> None:
        """Nothing is kept of a frame."""


def track(chosen: GraphSpec, scene: Scene, seed: int) -> Leaps:
    """One run from the true first box."""
    sink = Passes()
    source = SceneSource(scene, f"scene:{scene.name}")
    results = list(run(load_graph(chosen), source, [Start(scene.start_box)], seed=seed, sinks=[sink]))
    boxes = np.array([result.targets[0].centre_box for result in results])
    shared = overlap(boxes, centre_from_corner(scene.truth))
    return Leaps(
        sum(bool(shared[leap + AFTER] > 0.5) for leap in FLIGHTS),
        bool(shared[-1] > 0.5),
        len(sink.frames),
        len(set(LEAPS) & set(sink.frames)),
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument(
        "--leaps", type=float, nargs="+", default=[20.0, 26.0], help="px per frame of a flight"
    )
    options = parser.parse_args()
    methods: dict[str, tuple[int, object]] = {
        "plain, N": (SIZE, "bootstrap"),
        "plain, 2 N": (2 * SIZE, "bootstrap"),
        "second_pass": (SIZE, "second_pass"),
        "adaptive, parents": (SIZE, {"second_pass": {"by": "parents"}}),
        "auxiliary": (SIZE, "auxiliary"),
        "prior_editing": (SIZE, "prior_editing"),
        "iterated": (SIZE, "iterated"),
        "likelihood mixture": (SIZE, "likelihood_mixture"),
    }
    print("| importance | leap, px | overcome | held at the end | second passes a run | at leaps |")
    print("|---|---:|---:|---:|---:|---:|")
    for leap in options.leaps:
        for name, (size, importance) in methods.items():
            runs = [
                track(graph(size, importance), leaping(seed, leap), seed) for seed in range(options.seeds)
            ]
            total = len(FLIGHTS) * options.seeds
            print(
                f"| {name} | {leap:g} | {sum(r.overcome for r in runs)} of {total} "
                f"| {sum(r.held for r in runs)} of {options.seeds} | {np.mean([r.passes for r in runs]):.1f} "
                f"| {sum(r.at_leaps for r in runs)} of {len(LEAPS) * options.seeds} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
