"""Steps per second of the bootstrap filter, beside a plain vectorised NumPy filter in the same run.

Usage: python benchmarks/filter.py
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from bayesnet_track.belief.contract import Evidence
from bayesnet_track.belief.map import map_index
from bayesnet_track.belief.motion import make_motion
from bayesnet_track.belief.particles import ParticleFilter
from bayesnet_track.cue import Hypotheses
from bayesnet_track.graph import spec
from bayesnet_track.numerics.streams import Streams

BOX = np.array([160.0, 120.0, 60.0, 50.0])
SD = np.array([20.0, 20.0, 0.5, 0.5])
LIKELIHOODS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "sharp (sd 5 px)": lambda d2: -d2 / 50,
    "floored (sd 10 px, floor .02)": lambda d2: np.logaddexp(np.log(0.02), -d2 / 200),
    "flat": np.zeros_like,
}


def steps_per_second(step: Callable[[int], None], least_s: float = 1.0) -> float:
    """Rate of `step(frame)` over at least `least_s` seconds, after five steps to warm up."""
    for frame in range(5):
        step(frame)
    begin, frame = time.perf_counter(), 5
    while time.perf_counter() - begin < least_s:
        step(frame)
        frame += 1
    return (frame - 5) / (time.perf_counter() - begin)


def squares(boxes: np.ndarray) -> np.ndarray:
    """(N,) squared distances of the centres from the target."""
    away = boxes[:, :2] - BOX[:2]
    return np.einsum("nk,nk->n", away, away)


def filter_rate(size: int, log_likelihood: Callable[[np.ndarray], np.ndarray]) -> tuple[float, float]:
    """Steps per second of the filter, and milliseconds of its MAP search in the last step."""
    sd = dict(zip("xywh", SD, strict=True))
    motion = make_motion(spec.Motion.model_validate({"random_walk": {"sd_px": sd}}))
    belief, streams = ParticleFilter(spec.Particles(size=size)), Streams(0)
    state = [belief.start(BOX, motion, lambda purpose: streams.of("1", "root", 0, purpose))]

    def evaluate(hypotheses: Hypotheses, log_prior: np.ndarray) -> Evidence:
        return Evidence(log_likelihood(squares(hypotheses.boxes)))

    def step(frame: int) -> None:
        def stream(purpose: str) -> np.random.Generator:
            return streams.of("1", "root", frame, purpose)

        state[0] = belief.step(state[0], motion, 1.0, evaluate, stream).posterior

    rate = steps_per_second(step)
    rng = np.random.default_rng(0)
    parents, weights = state[0].states, state[0].weights
    moved = motion.propagate(parents[rng.choice(size, size, p=weights.weights)], 1.0, rng)
    likelihood = log_likelihood(squares(moved))
    times = []
    for _ in range(5):
        begin = time.perf_counter()
        map_index(likelihood, moved, parents, weights, motion, 1.0)
        times.append(time.perf_counter() - begin)
    return rate, 1e3 * float(np.median(times))


def numpy_rate(size: int, log_likelihood: Callable[[np.ndarray], np.ndarray]) -> float:
    """Steps per second of the shortest filter in NumPy: no MAP, no evidence, one random stream."""
    rng = np.random.default_rng(0)
    state = [np.tile(BOX, (size, 1)), np.full(size, 1 / size)]

    def step(_frame: int) -> None:
        positions = (np.arange(size) + rng.random()) / size
        ancestors = np.minimum(np.searchsorted(np.cumsum(state[1]), positions), size - 1)
        moved = state[0][ancestors] + SD * rng.standard_normal((size, 4))
        log = log_likelihood(squares(moved))
        weights = np.exp(log - log.max())
        state[:] = moved, weights / weights.sum()

    return steps_per_second(step)


def main() -> None:
    """Print one line for each likelihood and number of particles."""
    print(f"{'likelihood':32}{'N':>8}{'filter /s':>12}{'NumPy /s':>12}{'ratio':>8}{'MAP ms':>9}")
    for name, log_likelihood in LIKELIHOODS.items():
        for size in (1000, 10_000):
            rate, map_ms = filter_rate(size, log_likelihood)
            plain = numpy_rate(size, log_likelihood)
            print(f"{name:32}{size:8}{rate:12.0f}{plain:12.0f}{rate / plain:8.2f}{map_ms:9.2f}")


if __name__ == "__main__":
    main()
