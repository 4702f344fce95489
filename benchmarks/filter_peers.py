"""One constant-velocity model and its bootstrap filter by other hands: the peers of `benchmarks/filter.py`.

Needs NumPy and Numba alone; `filter_libraries.py` has the filters of libraries.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Model:
    """A point of which x and y are measured: state x, y, vx, vy, time step 1, exactly discretised noise.

    Attributes:
        diffusion: variance of the change of velocity per step, px^2.
        measured_sd: sd of a measured coordinate, px.
        start_sd: sd of the first velocity, px; the first position is 0.
        steps: number of measurements.
        seed: of the path and its measurements.
    """

    diffusion: float = 1.0
    measured_sd: float = 10.0
    start_sd: float = 1.0
    steps: int = 40
    seed: int = 1

    @cached_property
    def transition(self) -> Floats:
        """F, (4, 4)."""
        return np.kron([[1.0, 1.0], [0.0, 1.0]], np.eye(2))

    @cached_property
    def noise(self) -> Floats:
        """Q, (4, 4)."""
        return self.diffusion * np.kron([[1 / 3, 1 / 2], [1 / 2, 1.0]], np.eye(2))

    @cached_property
    def start(self) -> Floats:
        """Covariance of the state before the first step, (4, 4)."""
        return np.diag([0.0, 0.0, self.start_sd**2, self.start_sd**2])

    @cached_property
    def measurements(self) -> Floats:
        """(steps, 2)."""
        rng = np.random.default_rng(self.seed)
        state, root = np.sqrt(self.start) @ rng.standard_normal(4), np.linalg.cholesky(self.noise)
        found = np.empty((self.steps, 2))
        for k in range(self.steps):
            state = self.transition @ state + root @ rng.standard_normal(4)
            found[k] = state[:2] + self.measured_sd * rng.standard_normal(2)
        return found

    @property
    def log_evidence(self) -> float:
        """Exact, by the Kalman filter."""
        mean, covariance, total = np.zeros(4), self.start, 0.0
        for measured in self.measurements:
            mean = self.transition @ mean
            covariance = self.transition @ covariance @ self.transition.T + self.noise
            spread = covariance[:2, :2] + self.measured_sd**2 * np.eye(2)
            away = measured - mean[:2]
            total -= 0.5 * (away @ np.linalg.solve(spread, away) + np.log(np.linalg.det(2 * np.pi * spread)))
            gain = covariance[:, :2] @ np.linalg.inv(spread)
            mean, covariance = mean + gain @ away, covariance - gain @ covariance[:2]
        return float(total)


class Filter(Protocol):
    """A filter that has begun."""

    def step(self, measured: Floats) -> None:
        """Resample, move, weigh."""
        ...

    def log_evidence(self) -> float:
        """Of the last step; what it costs is not counted."""
        ...


Start = Callable[[Model, int, int], Filter]
"""(model, number of particles, seed) -> a filter before its first step."""


def run(start: Start, model: Model, size: int, seed: int) -> tuple[float, float]:
    """CPU seconds per step and the log-evidence of all measurements. The first step is not timed."""
    one = start(model, size, seed)
    taken, total = 0.0, 0.0
    for k, measured in enumerate(model.measurements):
        begin = time.process_time()
        one.step(measured)
        if k > 0:
            taken += time.process_time() - begin
        total += one.log_evidence()
    return taken / (model.steps - 1), total


def log_mean(log: Floats) -> float:
    """log of the mean of exp(log)."""
    top = log.max()
    return float(top + np.log(np.mean(np.exp(log - top))))


class Vectorised:
    """The shortest filter in NumPy."""

    def __init__(self, model: Model, size: int, seed: int) -> None:
        self.model, self.size, self.rng = model, size, np.random.default_rng(seed)
        self.states = self.rng.standard_normal((size, 4)) * np.sqrt(np.diag(model.start))
        self.weights = np.full(size, 1.0 / size)
        self.root = np.linalg.cholesky(model.noise)

    def ancestors(self) -> NDArray[Any]:
        positions = (np.arange(self.size) + self.rng.random()) / self.size
        return np.minimum(np.searchsorted(np.cumsum(self.weights), positions), self.size - 1)

    def step(self, measured: Floats) -> None:
        old, normals = self.states[self.ancestors()], self.rng.standard_normal((self.size, 4))
        self.states = old @ self.model.transition.T + normals @ self.root.T
        away = self.states[:, :2] - measured
        self.log = -np.einsum("nk,nk->n", away, away) / (2 * self.model.measured_sd**2)
        weights = np.exp(self.log - self.log.max())
        self.weights = weights / weights.sum()

    def log_evidence(self) -> float:
        return log_mean(self.log) - np.log(2 * np.pi * self.model.measured_sd**2)


def loop(own_normals: bool) -> Start:
    """A bare compiled loop; its normals are Numba's `np.random.normal`, or those of a NumPy Generator."""
    import numba

    if own_normals:

        @numba.njit
        def normal(rng):
            return np.random.normal()  # noqa: NPY002 - what such a loop uses
    else:

        @numba.njit
        def normal(rng):
            return rng.standard_normal()

    @numba.njit
    def seeded(seed):
        np.random.seed(seed)  # noqa: NPY002

    @numba.njit
    def step(rng, shift, old, weights, root, measured, precision, new, log):
        size = weights.size
        ancestor, cumulative = 0, weights[0]
        for n in range(size):
            while cumulative < (n + shift) / size and ancestor < size - 1:
                ancestor += 1
                cumulative += weights[ancestor]
            x, y, vx, vy = old[ancestor]
            a, b, c, d = normal(rng), normal(rng), normal(rng), normal(rng)
            new[n, 0] = x + vx + root[0, 0] * a
            new[n, 1] = y + vy + root[1, 1] * b
            new[n, 2] = vx + root[2, 0] * a + root[2, 2] * c
            new[n, 3] = vy + root[3, 1] * b + root[3, 3] * d
            away_x, away_y = new[n, 0] - measured[0], new[n, 1] - measured[1]
            log[n] = -0.5 * precision * (away_x * away_x + away_y * away_y)
        top, total = log.max(), 0.0
        for n in range(size):
            weights[n] = np.exp(log[n] - top)
            total += weights[n]
        for n in range(size):
            weights[n] /= total
        return top + np.log(total / size)

    class Loop:
        def __init__(self, model: Model, size: int, seed: int) -> None:
            self.rng = np.random.default_rng(seed)
            seeded(seed)
            self.sd = model.measured_sd
            self.states = self.rng.standard_normal((size, 4)) * np.sqrt(np.diag(model.start))
            self.spare, self.log = np.empty((size, 4)), np.empty(size)
            self.weights = np.full(size, 1.0 / size)
            self.root = np.linalg.cholesky(model.noise)

        def step(self, measured: Floats) -> None:
            self.last = step(
                self.rng,
                self.rng.random(),
                self.states,
                self.weights,
                self.root,
                measured,
                self.sd**-2,
                self.spare,
                self.log,
            )
            self.states, self.spare = self.spare, self.states

        def log_evidence(self) -> float:
            return float(self.last - np.log(2 * np.pi * self.sd**2))

    return Loop


def plain() -> Mapping[str, Start]:
    """Filters that need NumPy and Numba only."""
    return {
        "compiled loop, np.random.normal": loop(own_normals=True),
        "compiled loop, Generator": loop(own_normals=False),
        "vectorised NumPy": Vectorised,
    }


def request(name: str, model: Model, size: int, seed: int) -> str:
    """The line that asks for a run."""
    return json.dumps({"filter": name, "model": asdict(model), "size": size, "seed": seed}) + "\n"
