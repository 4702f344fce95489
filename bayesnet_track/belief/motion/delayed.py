"""Earlier values of some fields as further columns of the state, for sensors whose readings come late."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil, floor

import numpy as np

from bayesnet_track.belief.contract import Ancestors, MotionModel
from bayesnet_track.belief.motion.modes import Modal
from bayesnet_track.belief.motion.noise import Transition
from bayesnet_track.graph.checked import PAST, MeasuredAs
from bayesnet_track.numerics.arrays import Floats


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
