"""Steps per second of the bootstrap filter against other filters on the same model and data, in one run.

    python benchmarks/filter.py --peers PYTHON

A point with constant velocity is measured 40 times; every filter resamples systematically in each step.
PYTHON is the interpreter of an environment with `stonesoup`, `particles` and `filterpy` (they want an older
NumPy); it is started once and its filters take their turn with the others, all on one thread, CPU time. A
rate is that of the fastest run, which other work disturbed least; a ratio is this filter's rate over the
other's, the median over the rounds. Every evidence is compared with the exact one of the Kalman filter, so
that all are known to have computed the same.
"""

from __future__ import annotations

import argparse
import json
import subprocess
from collections.abc import Callable
from functools import partial

import numpy as np
from filter_peers import Model, plain, request, run
from measuring import environment, on_one_thread, table

from bayesnet_track.belief.contract import Evidence, Step
from bayesnet_track.belief.motion.models import make_motion
from bayesnet_track.belief.particles.belief import ParticleFilter, ParticleSet
from bayesnet_track.graph import spec
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.streams import Streams
from bayesnet_track.observation.cue import Hypotheses

RUNS = {500: 20, 1000: 20, 10_000: 4, 100_000: 1}
"""Number of particles -> runs in a round."""

BOX = np.array([0.0, 0.0, 60.0, 50.0])
OWN = "bayesnet-track"

Run = Callable[[Model, int, int], tuple[float, float]]


class Own:
    """The engine's particle filter on the model, its likelihood written in NumPy."""

    def __init__(self, model: Model, size: int, seed: int) -> None:
        velocity = {"sd_velocity_px": np.sqrt(model.diffusion), "start_velocity_sd_px": model.start_sd}
        self.motion = make_motion(spec.Motion.model_validate({"constant_velocity": velocity}))
        self.belief = ParticleFilter(
            spec.Particles.model_validate({"size": size, "resample": "systematic", "when": "every_frame"})
        )
        self.model, self.streams, self.frame = model, Streams(seed), 0
        self.state = self.belief.start(BOX, self.motion, self.stream)
        self.last: Step[ParticleSet] | None = None

    def stream(self, purpose: str) -> np.random.Generator:
        return self.streams.of("1", "root", self.frame, purpose)

    def step(self, measured: Floats) -> None:
        def evaluate(hypotheses: Hypotheses, _prior: Floats) -> Evidence:
            away_x, away_y = hypotheses.boxes[:, 0] - measured[0], hypotheses.boxes[:, 1] - measured[1]
            away_x *= away_x
            away_y *= away_y
            away_x += away_y
            away_x *= -0.5 / self.model.measured_sd**2
            return Evidence(away_x)

        self.frame += 1
        self.last = self.belief.step(self.state, self.motion, 1.0, evaluate, self.stream)
        self.state = self.last.posterior

    def log_evidence(self) -> float:
        assert self.last is not None
        return float(self.last.log_evidence - np.log(2 * np.pi * self.model.measured_sd**2))


class Elsewhere:
    """Filters of another environment, asked for one run at a time."""

    def __init__(self, python: str) -> None:
        script = __file__.replace("filter.py", "filter_libraries.py")
        self.process = subprocess.Popen(
            [python, script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        found = self._answer()
        self.numpy, self.filters = found["numpy"], found["filters"]

    def __enter__(self) -> Elsewhere:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.communicate()

    def _answer(self) -> dict[str, object]:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError("the interpreter of the peers ended")
        return dict(json.loads(line))

    def run(self, name: str, model: Model, size: int, seed: int) -> tuple[float, float]:
        assert self.process.stdin is not None
        self.process.stdin.write(request(name, model, size, seed))
        self.process.stdin.flush()
        answer = self._answer()
        return float(answer["seconds"]), float(answer["log_evidence"])


def measure(runs: dict[str, Run], model: Model, size: int, rounds: int) -> dict[str, tuple[Floats, Floats]]:
    """Name -> (rounds,) CPU seconds per step, and the log-evidence of each run; all in turn."""
    taken: dict[str, list[float]] = {name: [] for name in runs}
    found: dict[str, list[float]] = {name: [] for name in runs}
    for one in runs.values():
        one(model, 100, 0)
    for k in range(rounds):
        for name, one in runs.items():
            results = [one(model, size, 1000 * k + seed) for seed in range(RUNS[size])]
            taken[name].append(min(seconds for seconds, _ in results))
            found[name] += [log_evidence for _, log_evidence in results]
    return {name: (np.array(taken[name]), np.array(found[name])) for name in runs}


def agreement(found: Floats, exact: float) -> str:
    """Log of the mean evidence of the runs, less the exact one, with its standard error.

    Raises:
        RuntimeError: they differ by more than five standard errors.
    """
    shares = np.exp(found - exact)
    away, error = np.log(shares.mean()), shares.std(ddof=1) / np.sqrt(len(shares)) / shares.mean()
    if abs(away) > 5 * error:
        raise RuntimeError(f"log-evidence off by {away:.3f}, standard error {error:.3f}")
    return f"{away:+.3f} ± {error:.3f}"


def compare(runs: dict[str, Run], model: Model, rounds: int) -> str:
    """One row for each filter: rate, ratio and log-evidence at each number of particles."""
    measured = {size: measure(runs, model, size, rounds) for size in RUNS}
    head, rows = ["filter"], []
    for size in RUNS:
        head += [f"{size:,}: steps/s", "ratio", "log-evidence"]
    for name in runs:
        row = [name]
        for by_name in measured.values():
            taken, found = by_name[name]
            ratio = float(np.median(taken / by_name[OWN][0]))
            row += [f"{1 / taken.min():,.0f}", f"{ratio:.2f}", agreement(found, model.log_evidence)]
        rows.append(row)
    return table(head, rows)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--peers", metavar="PYTHON", help="interpreter that has the libraries")
    parser.add_argument("--rounds", type=int, default=8, help="rounds (8)")
    asked = parser.parse_args()
    on_one_thread()
    model = Model()
    runs: dict[str, Run] = {OWN: partial(run, Own)}
    runs |= {name: partial(run, start) for name, start in plain().items()}
    print(environment())
    print(f"log-evidence by the Kalman filter: {model.log_evidence:.3f}\n")
    if asked.peers is None:
        print(compare(runs, model, asked.rounds))
        return
    with Elsewhere(asked.peers) as elsewhere:
        print(f"elsewhere, with NumPy {elsewhere.numpy}: {', '.join(elsewhere.filters)}\n")
        runs |= {name: partial(elsewhere.run, name) for name in elsewhere.filters}
        print(compare(runs, model, asked.rounds))


if __name__ == "__main__":
    main()
