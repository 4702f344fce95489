"""Chains of derivatives driven by white noise, discretised exactly: the kinematics of each axis."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from bayesnet_track.belief.contract import Ancestors
from bayesnet_track.numerics.arrays import Floats

Rows = tuple[tuple[float, ...], ...]

FEW = 700
"""Up to so many states NumPy draws their normals, beyond a kernel does: the same bits."""


def chains(states: Floats) -> Floats:
    """(N, 2 n): x, y, vx, vy, ..., the states without the size."""
    return np.concatenate([states[:, :2], states[:, 4:]], axis=1)


def _both_axes(matrix: ArrayLike) -> Floats:
    """The (2 n, 2 n) matrix that does to x, y, vx, vy, ... what `matrix` (n, n) does to each axis."""
    return np.asarray(np.kron(np.asarray(matrix), np.eye(2)), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Unmixing:
    """What makes the noise of an axis' chain independent: `unmix` for both axes, and the variances left."""

    unmix: Floats
    pivots: Floats


@lru_cache(maxsize=256)
def unmixing(dynamics: Rows, diffusion: float, dt: float) -> Unmixing:
    """The triangular factor of the noise's covariance over `dt`, last derivative first."""
    covariance = steps(dynamics, diffusion, dt)[1]
    lower = np.linalg.cholesky(covariance[::-1, ::-1])
    scale = np.diag(lower)
    return Unmixing(_both_axes(np.linalg.inv(lower / scale)[::-1, ::-1]), (scale**2)[::-1])


@lru_cache(maxsize=256)
def step_rows(dynamics: Rows, diffusion: float, dt: float) -> tuple[Rows, Rows]:
    """The rows of the transition, and of the triangular root of the noise's covariance, for one axis."""
    transition, covariance = steps(dynamics, diffusion, dt)
    return _rows(transition), _rows(np.asarray(np.linalg.cholesky(covariance), dtype=np.float64))


@lru_cache(maxsize=256)
def move_rows(dynamics: Rows, diffusion: float, dt: float) -> Rows:
    """The rows of the transition for one axis."""
    return _rows(steps(dynamics, diffusion, dt)[0])


def driven(states: Floats, parents: Ancestors, moves: Rows, root: Rows, rng: np.random.Generator) -> Floats:
    """States moved from `parents` by the rows of the transition and of the noise's root, for both axes."""
    from bayesnet_track.numerics.kernels import kinematic_kernels as kernels

    if len(parents) > FEW:
        return kernels.driven_by(states, parents, moves, root, rng)
    return kernels.driven(states, parents, moves, root, rng.standard_normal((len(parents), 2 * len(moves))))


def plain_states(states: Floats) -> Floats:
    """`states` writable and in C order: one compiled version of a kernel only."""
    from bayesnet_track.numerics.compiled import plain

    return plain(states)


def _rows(matrix: Floats) -> Rows:
    return tuple(tuple(row) for row in matrix.tolist())


@lru_cache(maxsize=256)
def steps(dynamics: Rows, diffusion: float, dt: float) -> tuple[Floats, Floats]:
    """exp(A dt) and the integral of exp(A s) q exp(A s)' over s in 0..dt, for one axis.

    Series on a short step, then doubled: F(2h) = F F, Q(2h) = Q + F Q F'. Unlike the block exponential of
    Van Loan it stays exact over long gaps of a damped motion.

    Raises:
        ValueError: dt is not positive and finite.
    """
    if not (dt > 0 and np.isfinite(dt)):
        raise ValueError(f"time between frames must be positive and finite, not {dt}")
    matrix = np.array(dynamics)
    n = len(matrix)
    doublings = max(0, int(np.ceil(np.log2(np.abs(matrix).sum(axis=1).max() * dt + 1e-300))) + 3)
    h = dt / 2**doublings
    source = np.zeros((n, n))
    source[-1, -1] = diffusion
    # Q' = A Q + Q A' + source and F' = A F as Taylor series of order 12 about 0.
    transition: Floats = np.eye(n)
    term: Floats = np.eye(n)
    covariance, rate = np.zeros((n, n)), source * h
    for k in range(1, 13):
        term = matrix @ term * (h / k)
        transition = transition + term
        covariance = covariance + rate
        rate = (matrix @ rate + rate @ matrix.T) * (h / (k + 1))
    for _ in range(doublings):
        covariance = covariance + transition @ covariance @ transition.T
        transition = transition @ transition
    transition.setflags(write=False)
    covariance.setflags(write=False)
    return transition, covariance
