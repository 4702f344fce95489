"""States that something else moves, or that keep their past, around the motion of a target.

Earlier values of some fields are further columns, for sensors whose readings come late. The camera, or the
size that a state is drawn back to, moves it before its own motion. A carried target moves as its carrier
does, or on its own, which is a part of each hypothesis.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil, floor
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import Ancestors, MotionModel
from bayesnet_track.belief.motion.borders import Wrapped
from bayesnet_track.belief.motion.modes import Modal
from bayesnet_track.belief.motion.noise import Transition
from bayesnet_track.belief.particles.particle_set import ParticleSet
from bayesnet_track.graph.checked import PAST, MeasuredAs
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.cue import ANGLE


@dataclass(frozen=True, eq=False)
class Delayed:
    """`motion`, with last columns for what some fields were 1, 2, .. `lags` frame intervals before.

    They have no noise of their own: given the trajectory they are known. Between frames a field is taken to
    change evenly, so that frames may be left out. Before its start a target is taken to have moved evenly,
    with the velocity that it has then; without one, to have rested.

    Attributes:
        motion: how the other columns move.
        kept: the fields whose past is kept.
        lags: over how many frame intervals.
    """

    motion: MotionModel
    kept: tuple[str, ...]
    lags: int

    @cached_property
    def fields(self) -> tuple[str, ...]:
        """Fields of the motion, then those kept of each frame interval, the latest first."""
        past = (f"{name}{PAST}{lag}" for lag in range(1, self.lags + 1) for name in self.kept)
        return (*self.motion.fields, *past)

    @property
    def leaves_image(self) -> bool:
        """Like the motion."""
        return bool(getattr(self.motion, "leaves_image", False))

    @cached_property
    def _columns(self) -> list[int]:
        return [self.motion.fields.index(name) for name in self.kept]

    @property
    def _size(self) -> int:
        return len(self.motion.fields)

    def start(self, box: Floats, size: int, rng: np.random.Generator) -> Floats:
        """Like the motion, with the past that leads to it."""
        states = self.motion.start(box, size, rng)
        return np.hstack([states, *(states @ self._past_at_start(lag).T for lag in range(1, self.lags + 1))])

    def start_moments(self, box: Floats) -> tuple[Floats, Floats]:
        """Mean and covariance of what `start` draws."""
        mean, covariance = self.motion.start_moments(box)
        history = np.vstack(
            [np.eye(len(mean)), *(self._past_at_start(lag) for lag in range(1, self.lags + 1))]
        )
        return history @ mean, history @ covariance @ history.T

    def propagate(
        self, states: Floats, dt: float, rng: np.random.Generator, parents: Ancestors | None = None
    ) -> Floats:
        """(N, D) states after `dt` frame intervals."""
        propagated = self.motion.propagate(self._current(states), dt, rng, parents)
        return self._join(propagated, states if parents is None else states[parents], dt)

    def drift(self, states: Floats, dt: float) -> Floats:
        """(N, D) states after `dt` frame intervals without noise."""
        return self._join(self.motion.drift(self._current(states), dt), states, dt)

    def linearise(self, state: Floats, dt: float) -> tuple[Floats, Floats]:
        """F and Q: the past is a linear function of the trajectory, with the noise that this has."""
        size, width = self._size, len(self.kept)
        transition, noise = self.motion.linearise(state[:size], dt)
        select = np.eye(size)[self._columns]
        full, into = np.zeros((len(state), len(state))), np.zeros((len(state), size))
        full[:size, :size], into[:size] = transition, np.eye(size)
        for row, weights in enumerate(self._weights(dt)):
            block = slice(size + row * width, size + (row + 1) * width)
            full[block, :size] = weights[0] * select @ transition + weights[1] * select
            into[block] = weights[0] * select
            for lag, weight in enumerate(weights[2:]):
                full[block, size + lag * width : size + (lag + 1) * width] = weight * np.eye(width)
        return full, into @ noise @ into.T

    def log_density(self, states: Floats, previous: Floats, dt: float) -> Floats:
        """(M, N) that of the motion."""
        return self.motion.log_density(self._current(states), self._current(previous), dt)

    def transition(self, previous: Floats, dt: float) -> Transition:
        """Transition of the motion; the past is none of its coordinates."""
        transition = self.motion.transition(self._current(previous), dt)

        def coordinates(states: Floats) -> tuple[Floats, Floats]:
            return transition.coordinates(self._current(states))

        return replace(transition, coordinates=coordinates, states=None)

    def _current(self, states: Floats) -> Floats:
        return np.ascontiguousarray(states[:, : self._size])

    def _past_at_start(self, lag: int) -> Floats:
        """(W, D) what the fields that are kept were `lag` frame intervals before the start, of the state."""
        back = np.eye(self._size)[self._columns]
        for row, name in enumerate(self.kept):
            if (velocity := f"v{name}") in self.motion.fields:
                back[row, self.motion.fields.index(velocity)] = -float(lag)
        return back

    def _join(self, states: Floats, previous: Floats, dt: float) -> Floats:
        """The moved states with their past, of which each row of `previous` is the state before."""
        size, width = self._size, len(self.kept)
        past = previous[:, size:].reshape(len(previous), self.lags, width).swapaxes(0, 1)
        history = np.concatenate([states[None, :, self._columns], previous[None, :, self._columns], past])
        later = np.tensordot(self._weights(dt), history, 1)  # (lags, N, W)
        return np.hstack([states, later.swapaxes(0, 1).reshape(len(states), -1)])

    def _weights(self, dt: float) -> Floats:
        """(L, 2 + L) shares in each past field of it now, before the move, and 1, 2, .. before that."""
        weights = np.zeros((self.lags, 2 + self.lags))
        for row, lag in enumerate(range(1, self.lags + 1)):
            ago = lag - dt  # before the old frame
            if ago < 0.0:
                share = -ago / dt
                weights[row, :2] = share, 1.0 - share
                continue
            intervals = min(floor(ago), self.lags)
            share = ago - intervals
            weights[row, 1 + intervals] = 1.0 - share
            if share > 0.0:
                weights[row, 2 + intervals] = share
        return weights


def with_past(motion: MotionModel, measured: Iterable[MeasuredAs]) -> MotionModel:
    """The motion with the past of the fields that delayed agents measure; itself without any."""
    late = [measurement for measurement in measured if measurement.late]
    if not late:
        return motion
    fields = tuple(dict.fromkeys(name for measurement in late for name in measurement.late))
    lags = max(ceil(measurement.delay) for measurement in late)
    if isinstance(motion, Modal):
        return motion.each(lambda part: Delayed(part, fields, lags))
    return Delayed(motion, fields, lags)


class Shift(Protocol):
    """Deterministic change of states before their motion."""

    def apply(self, states: Floats) -> Floats:
        """(N, D) states after it, a copy."""

    def jacobian(self, state: Floats) -> Floats:
        """(D, D) derivative at a state (D,)."""


@dataclass(frozen=True, eq=False)
class ShiftedMotion(Wrapped):
    """`motion` after `shift`: p(x | x') is that of the motion from shift(x'), exactly.

    It is made for one frame: the shift is that frame's, whatever `dt`.
    """

    shift: Shift

    def propagate(
        self, states: Floats, dt: float, rng: np.random.Generator, parents: Ancestors | None = None
    ) -> Floats:
        """Shifted, then as the model."""
        return self.motion.propagate(self.shift.apply(states), dt, rng, parents)

    def drift(self, states: Floats, dt: float) -> Floats:
        """Shifted, then as the model."""
        return self.motion.drift(self.shift.apply(states), dt)

    def linearise(self, state: Floats, dt: float) -> tuple[Floats, Floats]:
        """F G and Q: the derivatives of both, and the model's noise at the shifted state."""
        drift, noise = self.motion.linearise(self.shift.apply(state[None])[0], dt)
        return drift @ self.shift.jacobian(state), noise

    def log_density(self, states: Floats, previous: Floats, dt: float) -> Floats:
        """Of the model from the shifted states."""
        return self.transition(previous, dt).log_density(states)

    def transition(self, previous: Floats, dt: float) -> Transition:
        """Of the model from the shifted states."""
        return self.motion.transition(self.shift.apply(previous), dt)


@dataclass(frozen=True, eq=False)
class CameraShift:
    """The picture moves: x <- L x + l for the centre, v <- L v for its derivatives, the size as it is.

    A background that comes nearer says nothing of how far off the target is.

    Attributes:
        linear: (2, 2) L.
        offset: (2,) l, px.
    """

    linear: Floats
    offset: Floats

    def apply(self, states: Floats) -> Floats:
        """(N, D) states where the camera's motion takes them."""
        shifted = states.copy()
        # Sums written out: those of BLAS depend on threads.
        for column in (0, *range(4, states.shape[1], 2)):
            x, y = states[:, column], states[:, column + 1]
            for axis, row in enumerate(self.linear):
                shifted[:, column + axis] = row[0] * x + row[1] * y
        shifted[:, :2] += self.offset
        return shifted

    def jacobian(self, state: Floats) -> Floats:
        """(D, D): L for the centre and each of its derivatives."""
        jacobian = np.eye(len(state))
        for column in (0, *range(4, len(state), 2)):
            jacobian[column : column + 2, column : column + 2] = self.linear
        return jacobian


def camera_shift(flow: Floats, dt: float) -> CameraShift | None:
    """Motion of points of the background over `dt` frame intervals; None where the picture rests.

    Args:
        flow: (2, 3) M of the camera's plane: M (x', y', 1) px per frame interval at the *present* place x'.
        dt: the time.

    x' = x + dt (A x' + b), so x' = (I - dt A)^-1 (x + dt b).
    """
    if not flow.any():
        return None
    linear = np.asarray(np.linalg.inv(np.eye(2) - dt * flow[:, :2]), dtype=np.float64)
    return CameraShift(linear, linear @ (dt * flow[:, 2]))


FIELD = "carried"
"""Name of the state's last column: 1 while it is carried, else 0."""


@dataclass(frozen=True, eq=False)
class Attached:
    """`motion`, with a last column of the state that says whether it is carried, a chain of its own.

    A hypothesis that is carried is moved by the carrier's displacement and Gaussian noise, and has the
    carrier's velocity where it has one; its size changes as `motion` says. Densities are those of a carried
    hypothesis that `motion` moves from where its velocity, or the displacement, leads it.

    Attributes:
        motion: how it moves on its own.
        displacement: (2,) of the carrier's centre since the last frame, px.
        start_share: probability per frame interval of being picked up.
        stay_share: the same of staying carried.
        sd_px: sd of what is carried beside its carrier, px per frame interval.
    """

    motion: MotionModel
    displacement: Floats
    start_share: float
    stay_share: float
    sd_px: float

    @property
    def fields(self) -> tuple[str, ...]:
        """Fields of the model, and whether it is carried."""
        return (*self.motion.fields, FIELD)

    def start(self, box: Floats, size: int, rng: np.random.Generator) -> Floats:
        """Like the model, not carried."""
        return with_column(self.motion.start(box, size, rng), np.zeros(size))

    def start_moments(self, box: Floats) -> tuple[Floats, Floats]:
        """Like the model, not carried."""
        mean, covariance = self.motion.start_moments(box)
        return np.append(mean, 0.0), np.pad(covariance, (0, 1))

    def propagate(
        self, states: Floats, dt: float, rng: np.random.Generator, parents: Ancestors | None = None
    ) -> Floats:
        """(N, D) states after `dt` frame intervals."""
        previous = states if parents is None else states[parents]
        moved_states = self.motion.propagate(np.ascontiguousarray(previous[:, :-1]), dt, rng)
        carried = self._draw_carried(previous[:, -1] > 0, dt, rng)
        count = int(carried.sum())
        noise = rng.standard_normal((count, 2)) * (self.sd_px * np.sqrt(dt))
        moved_states[carried, :2] = previous[carried, :2] + self.displacement + noise
        if self._kinematic >= 6:
            moved_states[carried, 4:6] = self.displacement / dt
        moved_states[carried, 6 : self._kinematic] = 0.0
        return with_column(moved_states, carried)

    def drift(self, states: Floats, dt: float) -> Floats:
        """(N, D) states after `dt` frame intervals without noise, carried or not as before."""
        moved_states = self.motion.drift(np.ascontiguousarray(self._seed_velocity(states, dt)), dt)
        return with_column(moved_states, states[:, -1])

    def linearise(self, state: Floats, dt: float) -> tuple[Floats, Floats]:
        """Fields of the model; the last field stays."""
        transition, covariance = self.motion.linearise(state[:-1], dt)
        padded = np.pad(transition, (0, 1))
        padded[-1, -1] = 1.0
        return padded, np.pad(covariance, (0, 1))

    def log_density(self, states: Floats, previous: Floats, dt: float) -> Floats:
        """(M, N) that of the model, from where what is carried would be without its noise."""
        return self.motion.log_density(states[:, :-1], self._seed_velocity(previous, dt), dt)

    def transition(self, previous: Floats, dt: float) -> Transition:
        """Log density of the transition; `states` keeps the last field of the state it is given."""
        transition = self.motion.transition(self._seed_velocity(previous, dt), dt)

        def coordinates(states: Floats) -> tuple[Floats, Floats]:
            return transition.coordinates(np.ascontiguousarray(states[:, :-1]))

        def states_at(points: Floats, still: Floats) -> Floats:
            assert transition.states is not None
            return with_column(transition.states(points, np.ascontiguousarray(still[:, :-1])), still[:, -1])

        return replace(
            transition, coordinates=coordinates, states=None if transition.states is None else states_at
        )

    def _seed_velocity(self, states: Floats, dt: float) -> Floats:
        """The states without the last field, those carried so that `motion` takes them with the carrier."""
        seeded = states[:, :-1].copy()
        carried = states[:, -1] > 0
        if self._kinematic >= 6:
            seeded[carried, 4:6] = self.displacement / dt
            seeded[carried, 6 : self._kinematic] = 0.0
        else:
            seeded[carried, :2] += self.displacement
        return seeded

    @property
    def _kinematic(self) -> int:
        """Columns of a state up to its last derivative: an angle and deviations stay what they are."""
        return sum(name != ANGLE and "." not in name for name in self.motion.fields)

    def _draw_carried(
        self, was_carried: NDArray[np.bool_], dt: float, rng: np.random.Generator
    ) -> NDArray[np.bool_]:
        """(N,) whether each is carried now: the chain over `dt`, its changes drawn systematically."""
        stationary = self.start_share / (self.start_share + 1.0 - self.stay_share)
        memory = (self.stay_share - self.start_share) ** dt if self.stay_share > self.start_share else 0.0
        probability = stationary + np.where(was_carried, 1.0 - stationary, -stationary) * memory
        points = (rng.permutation(len(was_carried)) + rng.random(len(was_carried))) / len(was_carried)
        return np.asarray(points < probability)


def with_column(states: Floats, carried: NDArray[np.generic]) -> Floats:
    """(N, D + 1) the states and whether each is carried."""
    return np.concatenate([states, np.asarray(carried, dtype=np.float64)[:, None]], axis=1)


def with_carried(belief: ParticleSet, carried: Floats | None) -> ParticleSet:
    """The belief with the last field; nothing is carried when (N,) `carried` is None."""
    column = np.zeros(len(belief)) if carried is None else carried
    return replace(belief, states=with_column(belief.states, column), fields=(*belief.fields, FIELD))


def without_carried(belief: ParticleSet) -> tuple[ParticleSet, Floats]:
    """The belief without the last field, and that field (N,)."""
    states = np.ascontiguousarray(belief.states[:, :-1])
    return replace(belief, states=states, fields=belief.fields[:-1]), belief.states[:, -1].copy()
