"""In-plane rotation, as a further field of each state: a random walk of its own, 0 in the first frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayesnet_track.belief.contract import Ancestors, MotionModel
from bayesnet_track.belief.motion.noise import Transition
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.cue import ANGLE


@dataclass(frozen=True, eq=False)
class Rotating:
    """`motion`, with a last column of the state: by how much the target is turned since its first frame.

    In degrees, clockwise in the picture. It walks on the line, not on the circle: a target that turned once
    is at 360, so that means, variances and densities of the belief are plain ones. What looks at the target
    sees the same at 360 as at 0.

    Attributes:
        motion: how the rest moves.
        sd: of the angle's step in one frame interval, degrees, above 0.
    """

    motion: MotionModel
    sd: float

    @property
    def fields(self) -> tuple[str, ...]:
        """Those of the model, and the angle."""
        return (*self.motion.fields, ANGLE)

    def start(self, box: Floats, size: int, rng: np.random.Generator) -> Floats:
        """As the model, upright."""
        return _with(self.motion.start(box, size, rng), np.zeros(size))

    def start_moments(self, box: Floats) -> tuple[Floats, Floats]:
        """As the model, upright."""
        mean, covariance = self.motion.start_moments(box)
        return np.append(mean, 0.0), np.pad(covariance, (0, 1))

    def propagate(
        self, states: Floats, dt: float, rng: np.random.Generator, parents: Ancestors | None = None
    ) -> Floats:
        """(N, D) states after `dt` frame intervals."""
        angles = states[:, -1] if parents is None else states[parents, -1]
        moved = self.motion.propagate(_without(states), dt, rng, parents)
        return _with(moved, angles + self.sd * np.sqrt(dt) * rng.standard_normal(len(angles)))

    def drift(self, states: Floats, dt: float) -> Floats:
        """(N, D) states after `dt` frame intervals without noise: turned as before."""
        return _with(self.motion.drift(_without(states), dt), states[:, -1])

    def linearise(self, state: Floats, dt: float) -> tuple[Floats, Floats]:
        """F and Q of the model; the angle's are 1 and sd^2 dt."""
        transition, covariance = (np.pad(one, (0, 1)) for one in self.motion.linearise(state[:-1], dt))
        transition[-1, -1], covariance[-1, -1] = 1.0, self.sd**2 * dt
        return transition, covariance

    def log_density(self, new: Floats, old: Floats, dt: float) -> Floats:
        """(M, N) that of the model, times the angle's, per degree."""
        return self.transition(old, dt).log_density(new)

    def transition(self, old: Floats, dt: float) -> Transition:
        """That of the model; the angle is the last coordinate."""
        own = self.motion.transition(_without(old), dt)
        sds = np.full((*own.sds.shape[:2], 1), self.sd * np.sqrt(dt))

        def coordinates(states: Floats) -> tuple[Floats, Floats]:
            points, log_jacobian = own.coordinates(_without(states))
            return _with(points, states[:, -1]), log_jacobian

        def states_at(points: Floats, still: Floats) -> Floats:
            assert own.states is not None
            return _with(own.states(_without(points), _without(still)), points[:, -1])

        return replace(
            own,
            coordinates=coordinates,
            means=_with(own.means, old[:, -1]),
            sds=np.concatenate([own.sds, sds], axis=2),
            states=None if own.states is None else states_at,
        )


def _without(states: Floats) -> Floats:
    return np.ascontiguousarray(states[:, :-1])


def _with(states: Floats, angles: Floats) -> Floats:
    return np.concatenate([states, angles[:, None]], axis=1)
