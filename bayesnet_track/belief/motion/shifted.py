"""States that something moves before their own motion: the camera, or the size they are drawn back to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from bayesnet_track.belief.contract import Ancestors
from bayesnet_track.belief.motion.borders import Wrapped
from bayesnet_track.belief.motion.noise import Transition
from bayesnet_track.numerics.arrays import Floats


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
