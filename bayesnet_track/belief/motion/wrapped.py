"""A motion model around another one, which stays as it is but for what the outer one changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesnet_track.belief.contract import Ancestors, MotionModel
from bayesnet_track.belief.motion.noise import Transition
from bayesnet_track.numerics.arrays import Floats


@dataclass(frozen=True, eq=False)
class Wrapped:
    """A motion model (`belief.contract.MotionModel`) that does in all what `motion` does.

    What is made of one motion by changing some of it writes only that.
    """

    motion: MotionModel

    @property
    def fields(self) -> tuple[str, ...]:
        """Those of the model."""
        return self.motion.fields

    def start(self, box: Floats, size: int, rng: np.random.Generator) -> Floats:
        """As the model."""
        return self.motion.start(box, size, rng)

    def start_moments(self, box: Floats) -> tuple[Floats, Floats]:
        """As the model."""
        return self.motion.start_moments(box)

    def propagate(
        self, states: Floats, dt: float, rng: np.random.Generator, parents: Ancestors | None = None
    ) -> Floats:
        """As the model."""
        return self.motion.propagate(states, dt, rng, parents)

    def drift(self, states: Floats, dt: float) -> Floats:
        """As the model."""
        return self.motion.drift(states, dt)

    def linearise(self, state: Floats, dt: float) -> tuple[Floats, Floats]:
        """As the model."""
        return self.motion.linearise(state, dt)

    def log_density(self, new: Floats, old: Floats, dt: float) -> Floats:
        """As the model."""
        return self.motion.log_density(new, old, dt)

    def transition(self, old: Floats, dt: float) -> Transition:
        """As the model."""
        return self.motion.transition(old, dt)
