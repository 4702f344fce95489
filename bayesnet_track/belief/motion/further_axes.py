"""Motions with more axes than those of the centre: velocities of the sides, and a height in space.

`BoxVelocityMotion` is constant velocity of a whole box, with independent noise in px: the state of SORT and
its successors. `SpaceMotion` moves a target in space, upwards as across.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayesnet_track.belief.contract import BOX_FIELDS, Ancestors
from bayesnet_track.belief.motion.models import KinematicMotion, steps, unmixing
from bayesnet_track.belief.motion.noise import Transition
from bayesnet_track.belief.motion.start_prior import StartPrior
from bayesnet_track.graph.checks.plates import UPWARDS
from bayesnet_track.graph.settings.motion import BoxVelocity, PixelSd
from bayesnet_track.numerics.arrays import Floats


@dataclass(frozen=True)
class BoxVelocityMotion:
    """A motion model (`belief.contract.MotionModel`) of x, y, w, h and their velocities.

    x' = x + v dt, v' = v; each of the eight has noise of its own, its variance in proportion to dt. Particles
    are propagated, but have no `transition`: the language gives this motion to Gaussian beliefs alone.
    """

    settings: BoxVelocity
    prior: StartPrior | None = None

    @property
    def fields(self) -> tuple[str, ...]:
        """x, y, w, h and their velocities, px per frame."""
        return (*BOX_FIELDS, "vx", "vy", "vw", "vh")

    @property
    def leaves_image(self) -> bool:
        """True if centres go on beyond the image."""
        return self.settings.leave_image

    def start(self, box: Floats, size: int, rng: np.random.Generator) -> Floats:
        """(size, 8) states around the centre box (4,)."""
        sds = np.concatenate([np.zeros(4), _sds(self.settings.start_velocity_sd_px)])
        states = np.asarray(np.append(box, np.zeros(4)) + rng.standard_normal((size, 8)) * sds)
        return states if self.prior is None else self.prior.applied_to(self.fields, states, box, rng)

    def start_moments(self, box: Floats) -> tuple[Floats, Floats]:
        """(8,) mean and (8, 8) covariance of what `start` draws."""
        sds = np.concatenate([np.zeros(4), _sds(self.settings.start_velocity_sd_px)])
        mean, spread = np.concatenate([box, np.zeros(4)]).astype(np.float64), np.diag(sds**2)
        return (mean, spread) if self.prior is None else self.prior.moments_of(self.fields, mean, spread, box)

    def propagate(
        self, states: Floats, dt: float, rng: np.random.Generator, parents: Ancestors | None = None
    ) -> Floats:
        """(N, 8) states after `dt` frame intervals; widths and heights stay at least 1 px."""
        propagated = self.drift(states if parents is None else states[parents], dt)
        propagated += rng.standard_normal(propagated.shape) * np.sqrt(np.diagonal(self._noise(dt)))
        np.maximum(propagated[:, 2:4], 1.0, out=propagated[:, 2:4])
        return propagated

    def drift(self, states: Floats, dt: float) -> Floats:
        """(N, 8) states after `dt` frame intervals without noise: F x."""
        drifted = states.copy()
        drifted[:, :4] += dt * states[:, 4:]
        return drifted

    def linearise(self, state: Floats, dt: float) -> tuple[Floats, Floats]:
        """F and Q, each (8, 8): new = F old + noise of covariance Q; the same at every state.

        Raises:
            ValueError: dt is not positive and finite.
        """
        if not (dt > 0 and np.isfinite(dt)):
            raise ValueError(f"time between frames must be positive and finite, not {dt}")
        return np.eye(8) + dt * np.eye(8, k=4), self._noise(dt)

    def log_density(self, states: Floats, previous: Floats, dt: float) -> Floats:
        """Not known of this motion."""
        raise NotImplementedError("box_velocity is a motion of Gaussian beliefs")

    def transition(self, previous: Floats, dt: float) -> Transition:
        """Not known of this motion."""
        raise NotImplementedError("box_velocity is a motion of Gaussian beliefs")

    def _noise(self, dt: float) -> Floats:
        sds = np.concatenate([_sds(self.settings.sd_px), _sds(self.settings.sd_velocity_px)])
        return np.diag(dt * sds**2)


def _sds(sd: PixelSd) -> Floats:
    return np.array([sd.x, sd.y, sd.w, sd.h])


@dataclass(frozen=True)
class SpaceMotion:
    """A motion model (`belief.contract.MotionModel`) of x, y, w, h and their motion, then z, vz, az.

    The third axis obeys the same equation as the others, with noise of its own; sizes are those of `plane`.
    A box that it starts at may have z as a fifth number.

    Attributes:
        plane: the motion of x, y, w and h.
        sd_z: further noise of z, m in one second, its variance in proportion to the time.
    """

    plane: KinematicMotion
    sd_z: float = 0.0

    @property
    def fields(self) -> tuple[str, ...]:
        """Fields of the motion across, then those of the third axis."""
        return (*self.plane.fields, *UPWARDS[: self.plane.order])

    @property
    def leaves_image(self) -> bool:
        """True: a place in space has no border."""
        return self.plane.leaves_image

    @property
    def least_side(self) -> float:
        """Of widths and heights, m."""
        return self.plane.least_side

    def start(self, box: Floats, size: int, rng: np.random.Generator) -> Floats:
        """(size, D) states at x, y, w, h and z (5,), the derivatives drawn around 0."""
        upright = rng.standard_normal((size, self.plane.order)) * self._start_sds
        upright[:, :1] += box[4:]
        return np.concatenate([self.plane.start(box[:4], size, rng), upright], axis=1)

    def start_moments(self, box: Floats) -> tuple[Floats, Floats]:
        """(D,) mean and (D, D) covariance of what `start` draws."""
        mean, covariance = self.plane.start_moments(box[:4])
        order = self.plane.order
        spread = np.pad(covariance, (0, order))
        rows = np.arange(len(mean), len(spread))
        spread[rows, rows] = self._start_sds**2
        upright = np.zeros(order)
        upright[:1] += box[4:]
        return np.append(mean, upright), spread

    def propagate(
        self, states: Floats, dt: float, rng: np.random.Generator, parents: Ancestors | None = None
    ) -> Floats:
        """(N, D) states after `dt` seconds; widths and heights stay at least `least_side`."""
        previous = states if parents is None else states[parents]
        plane_states = self.plane.propagate(np.ascontiguousarray(previous[:, : self._width]), dt, rng)
        moves, covariance = self._upright(dt)
        values, vectors = np.linalg.eigh(covariance)
        noise = rng.standard_normal((len(previous), len(values))) * np.sqrt(np.maximum(values, 0.0))
        return np.concatenate(
            [plane_states, previous[:, self._width :] @ moves.T + noise @ vectors.T], axis=1
        )

    def drift(self, states: Floats, dt: float) -> Floats:
        """(N, D) states after `dt` seconds without noise: F x."""
        plane_states = self.plane.drift(np.ascontiguousarray(states[:, : self._width]), dt)
        return np.concatenate([plane_states, states[:, self._width :] @ self._upright(dt)[0].T], axis=1)

    def linearise(self, state: Floats, dt: float) -> tuple[Floats, Floats]:
        """F and Q, each (D, D): new = F old + noise of covariance Q."""
        order = self.plane.order
        transition, noise = (np.pad(part, (0, order)) for part in self.plane.linearise(state[:-order], dt))
        transition[-order:, -order:], noise[-order:, -order:] = self._upright(dt)
        return transition, noise

    def log_density(self, states: Floats, previous: Floats, dt: float) -> Floats:
        """(M, N) log p(states_m | previous_n) over the coordinates with noise."""
        return self.transition(previous, dt).log_density(states)

    def transition(self, previous: Floats, dt: float) -> Transition:
        """Transition of the motion across, and as many coordinates of the third axis."""
        inner = self.plane.transition(previous[:, : self._width], dt)
        if self.plane.diffusion:
            chain = unmixing(self.plane.dynamics, self.plane.diffusion, dt)
            unmix, variances = chain.unmix[::2, ::2], chain.pivots.copy()
        else:
            unmix, variances = np.eye(self.plane.order), np.zeros(self.plane.order)
        variances[0] += self.sd_z**2 * dt
        noisy = np.flatnonzero(variances)

        def upright(states: Floats) -> Floats:
            return np.asarray((states[:, self._width :] @ unmix.T)[:, noisy])

        def coordinates(states: Floats) -> tuple[Floats, Floats]:
            points, log_jacobian = inner.coordinates(states[:, : self._width])
            return np.concatenate([points, upright(states)], axis=1), log_jacobian

        sds = np.broadcast_to(np.sqrt(variances[noisy]), (*inner.sds.shape[:2], len(noisy)))
        return replace(
            inner,
            coordinates=coordinates,
            means=np.concatenate([inner.means, upright(self.drift(previous, dt))], axis=1),
            sds=np.concatenate([inner.sds, sds], axis=2),
            states=None,
        )

    @property
    def _width(self) -> int:
        return len(self.plane.fields)

    @cached_property
    def _start_sds(self) -> Floats:
        return np.array([0.0, *self.plane.start_sd])

    def _upright(self, dt: float) -> tuple[Floats, Floats]:
        """F and Q of the third axis."""
        moves, covariance = steps(self.plane.dynamics, self.plane.diffusion, dt)
        covariance = covariance.copy()
        covariance[0, 0] += self.sd_z**2 * dt
        return moves, covariance
