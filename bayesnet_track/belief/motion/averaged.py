"""Motion, averaged over modes, of tentative and unconfirmed tracks and of remembered targets."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayesnet_track.belief.contract import Ancestors, MotionModel
from bayesnet_track.belief.motion.modes import Modal
from bayesnet_track.belief.motion.noise import Transition
from bayesnet_track.numerics.arrays import Floats


@dataclass(frozen=True, eq=False)
class Averaged:
    """A motion model (`belief.contract.MotionModel`) of the moments of a state whose mode is not known.

    What may become a target, or was one, is kept as one Gaussian without a mode. It moves as the modes do on
    average, weighted as in the long run: the mean by the mean of their drifts, and where these differ they
    add to the noise.

    Attributes:
        modal: the motion in modes.
    """

    modal: Modal

    @cached_property
    def fields(self) -> tuple[str, ...]:
        """Fields of the motions, without the mode."""
        return self.modal.fields[:-1]

    @cached_property
    def shares(self) -> Floats:
        """(K,) probabilities of the modes in the long run."""
        return np.asarray(self.modal.modes.long_run())

    @property
    def leaves_image(self) -> bool:
        """Like the modes."""
        return self.modal.leaves_image

    def start(self, box: Floats, size: int, rng: np.random.Generator) -> Floats:
        """Like the motion in modes."""
        return np.ascontiguousarray(self.modal.start(box, size, rng)[:, :-1])

    def start_moments(self, box: Floats) -> tuple[Floats, Floats]:
        """Like the motion in modes."""
        return self.modal.start_moments(box)

    def propagate(
        self, states: Floats, dt: float, rng: np.random.Generator, parents: Ancestors | None = None
    ) -> Floats:
        """(N, D) states after `dt` frame intervals, each in a mode that is drawn."""
        previous = states if parents is None else states[parents]
        modes = rng.choice(len(self.shares), len(previous), p=self.shares)
        propagated = replace(self.modal, settled=True).propagate(np.column_stack([previous, modes]), dt, rng)
        return np.ascontiguousarray(propagated[:, :-1])

    def drift(self, states: Floats, dt: float) -> Floats:
        """(N, D) the mean of where each mode leads."""
        return np.asarray(
            np.tensordot(self.shares, [motion.drift(states, dt) for motion in self.modal.motions], 1)
        )

    def linearise(self, state: Floats, dt: float) -> tuple[Floats, Floats]:
        """F and Q: the means of those of the modes, and how far apart they lead."""
        linearised = [motion.linearise(state, dt) for motion in self.modal.motions]
        led = np.array([motion.drift(state[None], dt)[0] for motion in self.modal.motions])
        deviations = led - self.shares @ led
        noise = np.tensordot(self.shares, [noise for _, noise in linearised], 1)
        transition = np.tensordot(self.shares, [transition for transition, _ in linearised], 1)
        return np.asarray(transition), noise + (deviations * self.shares[:, None]).T @ deviations

    def log_density(self, states: Floats, previous: Floats, dt: float) -> Floats:
        """(M, N) log of the mixture of the modes' densities."""
        with np.errstate(divide="ignore"):
            log = np.log(self.shares)
        parts = [
            share + motion.log_density(states, previous, dt)
            for share, motion in zip(log, self.modal.motions, strict=True)
        ]
        return np.asarray(np.logaddexp.reduce(parts, axis=0))

    def transition(self, previous: Floats, dt: float) -> Transition:
        """Not known, as of the modes.

        Raises:
            TypeError: always.
        """
        return self.modal.transition(previous, dt)


def without_modes(motion: MotionModel) -> MotionModel:
    """The motion of the moments of a state: itself, of one in modes their average."""
    return Averaged(motion) if isinstance(motion, Modal) else motion
