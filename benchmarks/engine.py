"""What a frame costs: four agents, 1000 hypotheses, 640x480, beside OpenCV's CSRT in the same run.

    python benchmarks/engine.py [--graphs color_fusion] [--sweep [WORDS]]

All agents stay active and learn, frames are in memory, everything runs on one core. Wall and CPU time are
measured frame by frame, engine and peer in turn on the same frame, so that a busy machine slows both alike;
CPU time says more there. CSRT is in opencv-contrib-python-headless only; without it MIL stands beside.
--sweep varies hypotheses, box, frame and agents one at a time, and the side of the target of `general`; with
words, only what has them in its name.
Asked for: 8 ms a frame (goal 5) and three times the rate of CSRT.
"""

from __future__ import annotations

import argparse
import gc
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from measuring import (
    FOUR_AGENTS,
    Image,
    always_on,
    decoded,
    environment,
    milliseconds,
    moving_target,
    on_one_thread,
    table,
)
from peers import Peer, peers

from bayesnet_track.engine.step import Engine, State, make_engine, start_target, step
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.numerics.boxes import centre_from_corner, overlap
from bayesnet_track.observation.planes import Frame

WARM_UP = 10
AGENTS = ("color", "filter")
"""Those of `general`."""
STAGES = ("planes", "belief", "measure", "learn")


@dataclass(frozen=True)
class Setting:
    """What is measured."""

    particles: int = 1000
    side: float = 60.0
    size: tuple[int, int] = (640, 480)
    agents: tuple[str, ...] = FOUR_AGENTS
    graph: str = "color_fusion"


@dataclass
class Cost:
    """Seconds frame by frame, the first frames left out."""

    wall: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)
    parts: dict[str, list[float]] = field(default_factory=dict)
    overlaps: list[float] = field(default_factory=list)

    @property
    def cpu_ms(self) -> float:
        """Median CPU time of a frame."""
        return float(np.median(self.cpu)) * 1e3


class TrackedByEngine:
    """The engine on frames in memory."""

    def __init__(self, setting: Setting, start: tuple[float, float, float, float], first: Image) -> None:
        if setting.agents == AGENTS:  # as it is installed
            graph = load_graph(setting.graph)
        else:
            graph = load_graph(always_on(setting.graph, setting.agents, setting.particles))
        self.engine: Engine = replace(make_engine(graph), clock=time.process_time)
        box = centre_from_corner(start)
        (plate,) = graph.targets
        self.state = start_target(self.engine, State(), Frame(0, 0.0, first), "1", plate, box).state
        self.parts: dict[str, float] = {}

    def update(self, index: int, image: Image) -> np.ndarray:
        """Centre box of the next frame."""
        outcome = step(self.engine, self.state, Frame(index, float(index), image))
        self.state, self.parts = outcome.state, dict(outcome.seconds)
        return np.array(outcome.metrics[0].centre_box)


class TrackedByPeer:
    """A tracker of OpenCV on the same frames."""

    def __init__(self, peer: Peer, start: tuple[float, float, float, float], first: Image) -> None:
        self.peer = peer
        self.peer.init(first, start)

    def update(self, index: int, image: Image) -> np.ndarray:
        """Centre box of the next frame."""
        return centre_from_corner(self.peer.update(image)[1])


def measured(setting: Setting, frames: int, with_peer: bool = False) -> dict[str, Cost]:
    """Name -> its cost on one pass over a scene; names are "engine" and, when wanted, the peer's."""
    scene = moving_target(*setting.size, setting.side, frames)
    images, truth = decoded(scene), centre_from_corner(scene.truth)
    trackers: dict[str, TrackedByEngine | TrackedByPeer] = {
        "engine": TrackedByEngine(setting, scene.start_box, images[0])
    }
    if with_peer:
        name = "CSRT" if "CSRT" in peers() else "MIL"
        trackers[name] = TrackedByPeer(peers()[name](), scene.start_box, images[0])
    costs = {name: Cost() for name in trackers}
    gc.collect()
    for index in range(1, frames):
        for name, tracker in trackers.items():
            wall, cpu = time.perf_counter(), time.process_time()
            box = tracker.update(index, images[index])
            cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
            if index < WARM_UP:
                continue
            cost = costs[name]
            cost.wall.append(wall)
            cost.cpu.append(cpu)
            cost.overlaps.append(float(overlap(box, truth[index])))
            if isinstance(tracker, TrackedByEngine):
                for part, seconds in _without_overlap(tracker.parts, cpu).items():
                    cost.parts.setdefault(part, []).append(seconds)
    return costs


def _without_overlap(parts: dict[str, float], whole: float) -> dict[str, float]:
    """Parts that add up to the whole: the engine's belief includes the planes and agents that it asks."""
    inside = sum(seconds for name, seconds in parts.items() if name not in STAGES or name == "planes")
    outside = sum(parts[name] for name in ("belief", "measure", "learn"))
    return {**parts, "belief": parts["belief"] - inside, "rest": whole - outside}


def report(costs: dict[str, Cost]) -> str:
    """Tables of the engine beside its peer, and of its parts."""
    ours, theirs = costs["engine"], costs[next(name for name in costs if name != "engine")]
    rows = [
        [name, milliseconds(cost.wall), milliseconds(cost.cpu), f"{np.mean(cost.overlaps):.2f}"]
        for name, cost in costs.items()
    ]
    ratio = f"wall {np.median(theirs.wall) / np.median(ours.wall):.1f}, CPU {theirs.cpu_ms / ours.cpu_ms:.1f}"
    parts = [[name, milliseconds(values)] for name, values in ours.parts.items()]
    return "\n\n".join(
        [
            table(["", "wall ms", "CPU ms", "mean IoU"], rows),
            f"rate over the peer's: {ratio}",
            table(["part of the engine's frame", "CPU ms"], parts),
        ]
    )


def sweeps() -> dict[str, list[tuple[float, Setting]]]:
    """What varies -> (its value, the setting)."""
    usual = Setting()
    return {
        "hypotheses": [(n, replace(usual, particles=n)) for n in (100, 250, 500, 1000, 2000, 4000)],
        "side of the box (px)": [(s, replace(usual, side=float(s))) for s in (20, 40, 60, 80, 120, 160)],
        "width of the frame (px, 4:3)": [
            (w, replace(usual, size=(w, w * 3 // 4))) for w in (320, 640, 960, 1280, 1920)
        ],
        "agents": [(n, replace(usual, agents=FOUR_AGENTS[:n])) for n in (1, 2, 3, 4)],
        "side of the target of general (px)": [
            (s, Setting(500, float(s), (max(640, 22 * s // 10), max(480, 18 * s // 10)), AGENTS, "general"))
            for s in (20, 40, 64, 100, 150, 200, 300, 600, 1000)
        ],
    }


def sweep(frames: int, words: str) -> None:
    """Print the cost of every setting of the `sweeps` with these words in their name."""
    for name, settings in sweeps().items():
        if words not in name:
            continue
        parts = (*settings[-1][1].agents, *STAGES, "rest")
        costs = [(value, measured(setting, frames)["engine"]) for value, setting in settings]
        rows = [
            [f"{value:g}", f"{cost.cpu_ms:.2f}", *(_part(cost, part) for part in parts)]
            for value, cost in costs
        ]
        print("\n" + table([name, "CPU ms", *parts], rows), flush=True)


def _part(cost: Cost, part: str) -> str:
    return f"{np.median(cost.parts[part]) * 1e3:.2f}" if part in cost.parts else "-"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--graphs", default="color_fusion")
    parser.add_argument("--sweep", nargs="?", const="", metavar="WORDS")
    options = parser.parse_args(arguments)
    on_one_thread()
    print(environment() + "\n")
    for graph in filter(None, options.graphs.split(",")):
        print(
            f"## {graph}\n\n" + report(measured(Setting(graph=graph), options.frames, with_peer=True)) + "\n"
        )
    if options.sweep is not None:
        sweep(min(options.frames, 60), options.sweep)


if __name__ == "__main__":
    main()
