"""Constant velocity of a whole box, with independent noise in px: the state of SORT and its successors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesnet_track.belief.contract import BOX_FIELDS, Ancestors
from bayesnet_track.belief.motion.noise import Transition
from bayesnet_track.belief.motion.start_prior import StartPrior
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
