"""What the MAP search costs against the number of hypotheses, milliseconds of CPU time.

    python benchmarks/map.py

Beside it the sum that it stands for, log sum_k beta_k p(x_i | x_k) for all i, written out in NumPy for up to
2000 hypotheses. Beliefs have settled for four frames on a sharp likelihood, one with a floor, or a flat one,
under noise in pixels and under the mixture of narrow and wide noise of the general graph.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from measuring import environment, on_one_thread, table

from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.belief.motion.models import make_motion
from bayesnet_track.belief.particles.map import map_index
from bayesnet_track.graph import spec
from bayesnet_track.numerics.log_weights import LogWeights

BOX = np.array([160.0, 120.0, 60.0, 50.0])
NOISES = {
    "px": {"sd_px": {"x": 20, "y": 20, "w": 0.5, "h": 0.5}},
    "narrow and wide": {
        "sd_box": {"x": 0.1, "y": 0.1},
        "heavy_tail": {"weight": 0.5, "factor": 4},
        "sd_log": {"scale": 0.02},
    },
}
LIKELIHOODS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "sharp (sd 5 px)": lambda d2: -d2 / 50,
    "floored (sd 10 px, floor .02)": lambda d2: np.logaddexp(np.log(0.02), -d2 / 200),
    "flat": np.zeros_like,
}
SIZES = (500, 1000, 2000, 10_000)
SUMMED_UP_TO = 2000

Case = tuple[np.ndarray, np.ndarray, np.ndarray, LogWeights, MotionModel, float]


def settled(noise: str, likelihood: str, size: int, seed: int) -> Case:
    """The arguments of `map_index` on the fourth frame."""
    rng = np.random.default_rng(seed)
    motion = make_motion(spec.Motion.model_validate({"random_walk": NOISES[noise]}))
    states, weights = np.tile(BOX, (size, 1)), LogWeights.uniform(size)
    for _ in range(4):
        parents, prior = states, weights
        states = motion.propagate(parents[rng.choice(size, size, p=prior.weights)], 1.0, rng)
        away = states[:, :2] - BOX[:2]
        log_likelihood = LIKELIHOODS[likelihood](np.einsum("nk,nk->n", away, away))
        weights = LogWeights.normalise(log_likelihood)[0]
    return log_likelihood, states, parents, prior, motion, 1.0


def summed(case: Case) -> int:
    """The same index from the sum written out."""
    log_likelihood, states, parents, weights, motion, dt = case
    density = np.logaddexp.reduce(motion.log_density(states, parents, dt) + weights.log, axis=1)
    return int(np.argmax(log_likelihood + density))


def milliseconds(search: Callable[[Case], int], cases: list[Case], rounds: int) -> str:
    """Median CPU time, and the longest."""
    search(cases[0])
    taken = []
    for case in cases * rounds:
        begin = time.process_time()
        search(case)
        taken.append(time.process_time() - begin)
    return f"{1e3 * np.median(taken):.2f} (max {1e3 * np.max(taken):.2f})"


def main() -> None:
    """Print one line for each noise, likelihood and number of hypotheses."""
    on_one_thread()
    rows = []
    for noise in NOISES:
        for likelihood in LIKELIHOODS:
            for size in SIZES:
                cases = [settled(noise, likelihood, size, seed) for seed in range(4)]
                sums = "-"
                if size <= SUMMED_UP_TO:
                    assert all(map_index(*case) == summed(case) for case in cases)
                    sums = milliseconds(summed, cases[:1], 1)
                found = milliseconds(lambda case: map_index(*case), cases, 10 if size <= SUMMED_UP_TO else 1)
                rows.append([noise, likelihood, str(size), found, sums])
    print(environment() + "\n")
    print(table(["noise", "likelihood", "hypotheses", "MAP, ms", "all sums, ms"], rows))


if __name__ == "__main__":
    main()
