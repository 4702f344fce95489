"""How much faster a frame of particles is than in an older version: both in one run, turn by turn.

    python benchmarks/paired_speed.py --before OLD/bin/python [--pairs 3] [--frames 60]

The scenes are those of `many_targets.py`: 50 targets of 200 hypotheses with one colour agent, alone and
joined, one target of the graph `general`, and one with a Gaussian belief, whose agent costs nothing: what is
left is the step of the engine. Each turn is a process of its own, older and newer alternate,
so that what else the machine does falls on both. Times are CPU time of the step, the median over the frames.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time

import numpy as np
from many_targets import SIDE, WARM_UP, Squares, measured
from measuring import environment, on_one_thread, table

from bayesnet_track.engine.step import State, make_engine, start_target, step
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.observation.cue import CueDeclaration, Hypotheses, Measurement, Reference
from bayesnet_track.observation.planes import Planes

SETTINGS = {
    "alone": "50 targets",
    "joined": "50 targets, joined",
    "general": "one target of `general`",
    "gaussian": "one Gaussian, agent for nothing",
}


class Given:
    """An agent that measures where the target began, for nothing."""

    needs = ()

    def learn(self, planes: Planes, box: np.ndarray) -> dict[str, np.ndarray]:
        """The box."""
        return {"box": box}

    def measure(
        self, planes: Planes, hypotheses: Hypotheses, weights: np.ndarray, reference: Reference
    ) -> Measurement:
        """The first box, 4 px off."""
        return Measurement(("x", "y", "w", "h"), reference["box"], np.eye(4) * 16.0, 0.01)


GAUSSIAN = {
    "bayesnet": 1,
    "name": "gaussian",
    "about": "One Gaussian belief with an agent that measures.",
    "targets": {
        "square": {
            "nodes": {
                "square": {
                    "belief": {"gaussian": {"filter": "extended", "gate": 1, "samples": 20}},
                    "motion": {
                        "constant_velocity": {
                            "sd_velocity_px": 3,
                            "sd_box": {"x": 0.1, "y": 0.1},
                            "sd_log": {"scale": 0.05, "aspect": 0.03},
                        }
                    },
                    "fuse": "product",
                    "estimate": "mean",
                    "ud_fields": ["x", "y"],
                    "learn": {"below": {"ud_box": 0.2}},
                },
                "given": {"parent": "square", "agent": "given"},
            }
        }
    },
}


def measured_one(frames: int, graph: CheckedGraph) -> float:
    """Milliseconds of CPU time of a frame of one target."""
    squares = Squares(1)
    engine, spent = make_engine(graph, 0), []
    (plate,) = graph.targets
    box = np.array([*squares.centres(0)[0], SIDE, SIDE])
    state = start_target(engine, State(), squares.frame(0), "1", plate, box).state
    for index in range(1, WARM_UP + frames + 1):
        frame = squares.frame(index)
        started = time.process_time()
        state = step(engine, state, frame).state
        spent.append(time.process_time() - started)
    return 1e3 * float(np.median(spent[WARM_UP:]))


def turn(python: str, setting: str, frames: int) -> float:
    """The same, measured by another interpreter."""
    command = [python, __file__, "--one", setting, "--frames", str(frames)]
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--before", help="interpreter of an environment with the older version")
    parser.add_argument("--pairs", type=int, default=3, help="turns of each")
    parser.add_argument("--settings", nargs="+", default=[*SETTINGS], choices=SETTINGS)
    parser.add_argument("--frames", type=int, default=60, help="frames of a turn")
    parser.add_argument("--one", choices=SETTINGS, help="measure one here, and print milliseconds")
    chosen = parser.parse_args()
    on_one_thread()
    if chosen.one is not None:
        if chosen.one == "general":
            print(measured_one(chosen.frames, load_graph("general")))
        elif chosen.one == "gaussian":
            given = CueDeclaration("given", make=Given, measures=True)
            print(measured_one(chosen.frames, load_graph(GAUSSIAN, (given,))))
        else:
            print(measured(50, chosen.one == "joined", chosen.frames).cpu_ms)
        return
    if chosen.before is None:
        raise SystemExit("--before is missing: the interpreter of an environment with the older version")
    print(f"{environment()}; load {os.getloadavg()[0]:.1f}")
    rows = []
    for setting in chosen.settings:
        pairs: list[list[float]] = []
        for _ in range(chosen.pairs):
            old, new = (turn(python, setting, chosen.frames) for python in (chosen.before, sys.executable))
            pairs.append([old, new])
            print(f"{SETTINGS[setting]}: {old:.2f} and {new:.2f} ms, {old / new:.2f}", flush=True)
        before, after = np.median(pairs, axis=0)
        ratios = [old / new for old, new in pairs]
        span = f"{np.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})"
        rows.append([SETTINGS[setting], f"{before:.2f}", f"{after:.2f}", span])
    print(table(["", "before [ms]", "after [ms]", "times as fast"], rows))


if __name__ == "__main__":
    main()
