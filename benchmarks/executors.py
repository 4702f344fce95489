"""What executors gain and what they cost: two equally heavy agents side by side, and two that do nothing.

    python benchmarks/executors.py [--frames 200] [--ms 10] [--workers 2]

Every executor tracks in the same frames with the same seed, all of them taking turns at each frame, so that a
neighbour on the machine slows all alike; ratios and differences are those of single frames, told by their
median and quartiles. `seconds` are those of the whole step: belief, rules and learning are in them.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping
from contextlib import ExitStack

import numpy as np
from measuring import table
from numpy.typing import NDArray
from placed_agents import WORK

from bayesnet_track.engine.step import Engine, Outcome, State, make_engine, start_target, step
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.checks.run import check_graph
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.observation.planes import Frame
from bayesnet_track.runtime.executors import make_executor

Floats = NDArray[np.float64]
KINDS = ("serial", "processes")
SIZE = (480, 640)
BOX = np.array([200.0, 150.0, 60.0, 60.0])
WARM = 10
"""Frames that are not counted: kernels are loaded, workers start."""


def two_agents(turns: int) -> CheckedGraph:
    """A graph with two agents of so much work each."""
    work, same = ({"parent": "root", "agent": {"work": {"turns": turns + more}}} for more in (0, 1))
    root = {
        "belief": {"particles": {"size": 500}},
        "fuse": "product",
        "motion": {"random_walk": {"sd_px": {"x": 5.0, "y": 5.0}}},
        "learn": {"below": {"ud_px2": 1e6}, "rate_max": 0.05},
    }
    nodes = {"root": root, "one": work, "other": same}
    spec = GraphSpec.model_validate({"name": "two_agents", "targets": {"plate": {"nodes": nodes}}})
    return check_graph(spec, {"work": WORK})


def two_histograms() -> CheckedGraph:
    """A graph with two equal agents that are real ones, at their usual work."""
    own, same = (
        {"parent": "root", "agent": {"color_histogram": {"bins": 32, "floor": floor}}}
        for floor in (0.02, 0.021)
    )
    root = {
        "belief": {"particles": {"size": 4000}},
        "fuse": "product",
        "motion": {"random_walk": {"sd_px": {"x": 20.0, "y": 20.0, "w": 2.0, "h": 2.0}}},
    }
    nodes = {"root": root, "one": own, "other": same}
    return load_graph(
        GraphSpec.model_validate({"name": "two_histograms", "targets": {"plate": {"nodes": nodes}}})
    )


def turns_of(milliseconds: float) -> int:
    """How much work takes so long here and now."""
    from placed_agents import _turned

    _turned(1)
    spent = []
    for _ in range(5):
        started = time.perf_counter()
        _turned(1_000_000)
        spent.append(time.perf_counter() - started)
    return int(1e6 * milliseconds * 1e-3 / min(spent))


def measured(graph: CheckedGraph, frames: int, workers: int) -> Mapping[str, Floats]:
    """Seconds of every counted frame, by executor."""
    cues = {"work": WORK} if graph.spec.name == "two_agents" else None
    rng = np.random.default_rng(0)
    with ExitStack() as stack:
        engines: dict[str, Engine] = {}
        for kind in KINDS:
            executor = stack.enter_context(make_executor(kind, workers=workers, cues=cues))
            engines[kind] = executor.engine(make_engine(graph, 0, cues))
        states = dict.fromkeys(KINDS, State())
        spent: dict[str, list[float]] = {kind: [] for kind in KINDS}
        for index in range(WARM + frames):
            frame = Frame(index, float(index), rng.integers(0, 255, (*SIZE, 3), dtype=np.uint8))
            outcomes: dict[str, Outcome] = {}
            for turn in range(len(KINDS)):
                kind = KINDS[(index + turn) % len(KINDS)]
                started = time.perf_counter()
                if index == 0:
                    outcomes[kind] = start_target(engines[kind], states[kind], frame, "1", "plate", BOX)
                else:
                    outcomes[kind] = step(engines[kind], states[kind], frame)
                spent[kind].append(time.perf_counter() - started)
                states[kind] = outcomes[kind].state
            assert len({outcome.metrics[0].centre_box for outcome in outcomes.values()}) == 1
    return {kind: np.array(seconds[WARM:]) for kind, seconds in spent.items()}


def quartiles(values: Floats, decimals: int) -> str:
    """Median and quartiles in words."""
    low, middle, high = np.percentile(values, [25, 50, 75])
    return f"{middle:.{decimals}f} ({low:.{decimals}f}-{high:.{decimals}f})"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--ms", type=float, default=10.0, help="work of each heavy agent a frame")
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    heavy = {
        f"two agents of {options.ms:.3g} ms": two_agents(turns_of(options.ms)),
        "two color_histogram, 4000 hypotheses": two_histograms(),
    }
    rows = []
    for name, graph in heavy.items():
        seconds = measured(graph, options.frames, options.workers)
        for kind in KINDS:
            ratio = quartiles(seconds["serial"] / seconds[kind], 2)
            rows.append([name, kind, quartiles(1e3 * seconds[kind], 2), ratio])
    print(table(["graph", "executor", "ms a frame", "speed-up, frame by frame"], rows))
    seconds = measured(two_agents(0), options.frames, options.workers)
    rows = [
        [
            kind,
            quartiles(1e3 * seconds[kind], 3),
            quartiles(1e3 * (seconds[kind] - seconds["serial"]), 3),
        ]
        for kind in KINDS
    ]
    print()
    print(table(["two agents that do nothing", "ms a frame", "more than serial, ms"], rows))


if __name__ == "__main__":
    main()
