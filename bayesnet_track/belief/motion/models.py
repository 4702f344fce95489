"""Motion models: exact linear-Gaussian kinematics of the centre, Gaussian noise of the whole box.

Each axis of the centre has a chain of derivatives s = (position, velocity, acceleration)[:n] that obeys
ds = A s dt + white noise in the last one, discretised exactly: two steps of dt / 2 have the mean and the
covariance of one step of dt. The box's own noise (`belief.motion.noise`) is added to it. Time is in frame
intervals.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayesnet_track.belief.contract import BOX_FIELDS, LEAST_SIDE_PX, Ancestors
from bayesnet_track.belief.motion.noise import (
    Transition,
    add_noise,
    box_coordinates,
    box_covariance,
    boxes_at,
    component_log_shares,
    component_variances,
    is_log,
    noisy,
)
from bayesnet_track.belief.motion.start_prior import StartPrior
from bayesnet_track.graph import spec
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.planes import read_only

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
    """Transform of an axis' chain to independent noise: `unmix` for both axes, and the variances left."""

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


def _driven(states: Floats, parents: Ancestors, moves: Rows, root: Rows, rng: np.random.Generator) -> Floats:
    """States moved from `parents` by the rows of the transition and of the noise's root, for both axes."""
    from bayesnet_track.numerics.kernels import box_kernels as kernels

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
        if not (term.any() or rate.any()):  # the powers of A that are left are 0
            break
    for _ in range(doublings):
        covariance = covariance + transition @ covariance @ transition.T
        transition = transition @ transition
    transition.setflags(write=False)
    covariance.setflags(write=False)
    return transition, covariance


DERIVATIVES = (("vx", "vy"), ("ax", "ay"))


@dataclass(frozen=True)
class KinematicMotion:
    """A motion model (`belief.contract.MotionModel`); make one with `make_motion`.

    Attributes:
        noise: noise of the box, on top of the kinematics.
        dynamics: the rows of A, (n, n); n = 1 for a random walk.
        diffusion: variance per frame interval of the white noise in the last derivative.
        start_sd: sds of the unknown first velocity and acceleration, (n - 1).
        leaves_image: whether targets go on beyond the frame.
        prior: distributions of fields at the start in place of these; None without any.
        least_side: of widths and heights, in the unit of the state.
    """

    noise: spec.Noise
    dynamics: Rows
    diffusion: float = 0.0
    start_sd: tuple[float, ...] = ()
    leaves_image: bool = False
    prior: StartPrior | None = None
    least_side: float = LEAST_SIDE_PX

    def __hash__(self) -> int:
        return self._hash

    @cached_property
    def _hash(self) -> int:  # without the noise: its settings may name a detector, whose parameters have none
        return hash((self.dynamics, self.diffusion, self.start_sd, self.leaves_image))

    @cached_property
    def noisy_columns(self) -> NDArray[np.intp]:
        """(K,) which of x, y, w, h, vx, vy, ... are coordinates with noise."""
        x, y, w, h = noisy(self.noise)
        if self.diffusion == 0:
            return np.flatnonzero([x, y, w, h])
        return np.flatnonzero([True, True, w, h] + [True] * (2 * self.order - 2))

    @cached_property
    def has_box_noise(self) -> bool:
        """True if the box has noise on top of the kinematics."""
        return any(noisy(self.noise))

    @cached_property
    def is_same_everywhere(self) -> bool:
        """True if variances of the noise do not depend on the box."""
        return self.noise.sd_box.x == 0 and self.noise.sd_box.y == 0 and not is_log(self.noise)

    @cached_property
    def draws_twice(self) -> bool:
        """True if a target's numbers are drawn in two turns, for the velocities and for the box."""
        return self.diffusion != 0 and self.has_box_noise

    @property
    def order(self) -> int:
        """n, the length of an axis' chain."""
        return len(self.dynamics)

    @cached_property
    def fields(self) -> tuple[str, ...]:
        """x, y, w, h, then vx, vy (px per frame), then ax, ay (px per frame^2)."""
        return BOX_FIELDS + sum(DERIVATIVES[: self.order - 1], ())

    def start(self, box: Floats, size: int, rng: np.random.Generator) -> Floats:
        """(size, D) states in the centre box (4,), the derivatives drawn around 0."""
        boxes = np.tile(np.asarray(box, dtype=np.float64), (size, 1))
        derivatives = rng.standard_normal((size, 2 * len(self.start_sd))) * np.repeat(self.start_sd, 2)
        states = np.concatenate([boxes, derivatives], axis=1)
        return states if self.prior is None else self.prior.applied_to(self.fields, states, box, rng)

    def start_moments(self, box: Floats) -> tuple[Floats, Floats]:
        """(D,) mean and (D, D) covariance of what `start` draws: the box, and derivatives around 0."""
        sds = np.concatenate([np.zeros(4), np.repeat(self.start_sd, 2)])
        mean, spread = np.concatenate([box, np.zeros(len(sds) - 4)]).astype(np.float64), np.diag(sds**2)
        return (mean, spread) if self.prior is None else self.prior.moments_of(self.fields, mean, spread, box)

    def propagate(
        self, states: Floats, dt: float, rng: np.random.Generator, parents: Ancestors | None = None
    ) -> Floats:
        """(N, D) states after `dt` frame intervals; widths and heights stay at least 1 px."""
        if self.diffusion == 0:
            propagated = self.drift(states if parents is None else states.take(parents, axis=0), dt)
        else:
            parents = np.arange(len(states)) if parents is None else parents
            propagated = _driven(
                plain_states(states), parents, *step_rows(self.dynamics, self.diffusion, dt), rng
            )
        add_noise(self.noise, propagated[:, :4], rng, dt, self.least_side)
        return propagated

    def drift(self, states: Floats, dt: float) -> Floats:
        """(N, D) states after `dt` frame intervals without noise: F x."""
        if self.order == 1:
            steps(self.dynamics, self.diffusion, dt)  # refuses a time that does not move forward
            return states.copy()
        # Imported here: a graph is validated without compiling anything.
        from bayesnet_track.numerics.kernels.box_kernels import drifted

        return drifted(plain_states(states), move_rows(self.dynamics, self.diffusion, dt))

    def linearise(self, state: Floats, dt: float) -> tuple[Floats, Floats]:
        """F and Q, each (D, D): new = F old + noise of covariance Q, at the state (D,).

        F is exact, and read-only. Q is exact for noise in px; relative noise is taken at the state's own
        size, noise of log w and log h to first order, and `heavy_tail` by its total variance.
        """
        transition, kinematic = _kinematics(self.dynamics, self.diffusion, dt)
        covariance = kinematic.copy()
        w, h = state[2:4].tolist()
        x, y, ww, wh, hh = box_covariance(self.noise, w, h, dt)
        covariance[0, 0] += x
        covariance[1, 1] += y
        covariance[2, 2] += ww
        covariance[3, 3] += hh
        if wh != 0.0:
            covariance[2, 3] += wh
            covariance[3, 2] += wh
        return transition, covariance

    def log_density(self, states: Floats, previous: Floats, dt: float) -> Floats:
        """(M, N) log p(states_m | previous_n) over the coordinates with noise, in px (the cuts left out)."""
        return self.transition(previous, dt).log_density(states)

    def transition(self, previous: Floats, dt: float) -> Transition:
        """p(states | previous) of `previous` (N, D), as coordinates and diagonal Gaussians.

        The position's coordinate is what its derivatives, which share its noise, do not predict: the
        triangular factor L of the kinematic covariance L D L' (last derivative first) is inverted, and the
        box's noise adds up with the last entry of D alone.
        """
        mean = self.drift(previous, dt)
        chain = None if self.diffusion == 0 else unmixing(self.dynamics, self.diffusion, dt)
        keep = self.noisy_columns
        same = _same_sds(self, dt) if self.is_same_everywhere else None
        if same is None:
            sds = _sds(self, previous[:, :4], dt)
        else:
            sds = np.empty((len(same), len(previous), same.shape[2]))
            sds[:] = same

        def all_coordinates(states: Floats) -> tuple[Floats, Floats]:
            points, log_jacobian = box_coordinates(self.noise, states[:, :4])
            if chain is not None:
                mixed = chains(states) @ chain.unmix.T
                points[:, :2] = mixed[:, :2]
                points = np.concatenate([points, mixed[:, 2:]], axis=1)
            return points, log_jacobian

        def coordinates(states: Floats) -> tuple[Floats, Floats]:
            if chain is not None and len(keep) == 2 * self.order:  # the size has no noise
                return chains(states) @ chain.unmix.T, np.zeros(len(states))
            points, log_jacobian = all_coordinates(states)
            return points.take(keep, axis=1), log_jacobian

        def states_at(points: Floats, still: Floats) -> Floats:
            full = all_coordinates(still)[0]
            full[:, keep] = points
            states = still.copy()
            if chain is not None:
                chains = np.concatenate([full[:, :2], full[:, 4:]], axis=1) @ np.linalg.inv(chain.unmix).T
                full[:, :2], states[:, 4:] = chains[:, :2], chains[:, 2:]
            states[:, :4] = boxes_at(self.noise, full[:, :4])
            return states

        return Transition(
            coordinates,
            coordinates(mean)[0],
            sds,
            component_log_shares(self.noise),
            states_at,
        )


def make_motion(model: spec.Motion) -> KinematicMotion:
    """The motion model that a graph asks for.

    - `random_walk`: no derivatives.
    - `constant_velocity`: white noise in acceleration, Q = q [[dt^3/3, dt^2/2], [dt^2/2, dt]].
    - `damped_velocity`: the velocity is an Ornstein-Uhlenbeck process dv = -damping v dt + noise. Eq. 3.91 of
      the tracking chapter (as printed it sends every pixel coordinate to about 0) means
      dx <- e^(-1/4) dx + w, x <- x + 1.5 dx + w: one Euler step of such a process, right for one step
      length only. Here it is integrated exactly, so that any dt may follow any other; the default damping
      1/4 keeps its e^(-1/4) per frame, and the gain of position becomes (1 - e^(-1/4)) / (1/4) = .885.
    - `constant_acceleration`: white noise in the derivative of acceleration.
    """
    settings = model.settings
    match settings:
        case spec.DampedVelocity():  # a kind of ConstantVelocity, so it comes first
            rows: Rows = ((0.0, 1.0), (0.0, -settings.damping))
            return KinematicMotion(
                settings, rows, settings.sd_velocity_px**2, (settings.start_velocity_sd_px,)
            )
        case spec.ConstantVelocity():
            rows = ((0.0, 1.0), (0.0, 0.0))
            return KinematicMotion(
                settings, rows, settings.sd_velocity_px**2, (settings.start_velocity_sd_px,)
            )
        case spec.ConstantAcceleration():
            rows = ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
            start = (settings.start_velocity_sd_px, settings.start_acceleration_sd_px)
            return KinematicMotion(settings, rows, settings.sd_acceleration_px**2, start)
        case spec.RandomWalk():
            return KinematicMotion(settings, ((0.0,),))
    raise TypeError(f"no motion model for {type(settings).__name__}")


def linear_gaussian(motion: KinematicMotion, dt: float) -> tuple[Floats, Floats]:
    """(F, Q), each (D, D), of a motion whose noise is in px only: new = F old + N(0, Q).

    Raises:
        ValueError: the noise depends on the state (sd_box, sd_log) or is not Gaussian (wide).
    """
    noise = motion.noise
    if noise.sd_box != spec.BoxSd() or is_log(noise) or noise.heavy_tail is not None:
        raise ValueError("only noise in px makes a linear-Gaussian motion")
    return motion.linearise(np.ones(len(motion.fields)), dt)


@lru_cache(maxsize=1024)
def linear_moves(motion: KinematicMotion, dt: float) -> tuple[Floats, Floats] | None:
    """F and Q of a motion that is linear with noise in px; else None."""
    if motion.least_side != LEAST_SIDE_PX:
        return None
    try:
        return linear_gaussian(motion, dt)
    except ValueError:
        return None


def _sds(motion: KinematicMotion, boxes: Floats, dt: float) -> Floats:
    """(C, N, K) sds of the coordinates with noise around `boxes` (N, 4)."""
    variances = component_variances(motion.noise, boxes, dt)
    if motion.diffusion != 0:
        pivots = unmixing(motion.dynamics, motion.diffusion, dt).pivots
        variances[:, :, :2] += pivots[0]
        derivatives = np.broadcast_to(np.repeat(pivots[1:], 2), (*variances.shape[:2], 2 * motion.order - 2))
        variances = np.concatenate([variances, derivatives], axis=2)
    return np.asarray(np.sqrt(variances.take(motion.noisy_columns, axis=2)))


@lru_cache(maxsize=256)
def _same_sds(motion: KinematicMotion, dt: float) -> Floats:
    """(C, 1, K) those of any box, on which they do not depend."""
    return _sds(motion, np.ones((1, 4)), dt)


@lru_cache(maxsize=256)
def _kinematics(dynamics: Rows, diffusion: float, dt: float) -> tuple[Floats, Floats]:
    """F and the kinematic part of Q, each (D, D), read-only."""
    moves, covariance = steps(dynamics, diffusion, dt)
    size = 2 + 2 * len(dynamics)
    transition, noise_covariance = np.eye(size), np.zeros((size, size))
    for axis in (0, 1):
        columns = [axis, *range(4 + axis, size, 2)]
        transition[np.ix_(columns, columns)] = moves
        noise_covariance[np.ix_(columns, columns)] = covariance
    return read_only(transition), read_only(noise_covariance)


def propagate_rows(
    motion: KinematicMotion,
    states: Floats,
    dt: float,
    streams: Iterable[np.random.Generator],
    parents: Ancestors,
) -> Floats:
    """(T, N, D) states after `dt` frame intervals of the (T, N) `parents` among the states (T, K, D) of each.

    As `motion.propagate(states[t], dt, streams[t], parents[t])` for every target t. Where it `draws_twice`
    each stream is an object of its own, else the next may take the last one's place.
    """
    from bayesnet_track.numerics.kernels.box_kernels import driven

    count, size, width = states.shape
    if motion.draws_twice:
        streams = list(streams)
    flat_parents = (parents + size * np.arange(count)[:, None]).ravel()
    flat = states.reshape(-1, width)
    if motion.diffusion == 0:
        propagated = motion.drift(flat.take(flat_parents, axis=0), dt)
    else:
        normals = np.empty((count, parents.shape[1], 2 * motion.order))
        for target, stream in zip(normals, streams, strict=True):
            stream.standard_normal(out=target)
        rows = step_rows(motion.dynamics, motion.diffusion, dt)
        propagated = driven(flat, flat_parents, *rows, normals.reshape(-1, 2 * motion.order))
    propagated = propagated.reshape(count, -1, width)
    if motion.has_box_noise:
        for target, stream in zip(propagated, streams, strict=True):
            add_noise(motion.noise, target[:, :4], stream, dt, motion.least_side)
    return propagated
