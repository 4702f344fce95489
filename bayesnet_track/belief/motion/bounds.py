"""Keep hypotheses where the camera can see: a motion model confined to the image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesnet_track.belief.contract import Ancestors
from bayesnet_track.belief.motion.wrapped import Wrapped
from bayesnet_track.numerics.arrays import Floats


@dataclass(frozen=True, eq=False)
class Confined(Wrapped):
    """`motion`, with centres kept on the image and sizes at most twice the image's.

    A lost target's hypotheses would otherwise drift away for ever and could not find it again. The density
    is that of the unconfined model: confinement matters at the border only.

    Attributes:
        motion: the model.
        width: columns of the image.
        height: rows of the image.
    """

    width: int
    height: int

    def propagate(
        self, states: Floats, dt: float, rng: np.random.Generator, parents: Ancestors | None = None
    ) -> Floats:
        """As the model, then confined."""
        return self.confine(self.motion.propagate(states, dt, rng, parents))

    def drift(self, states: Floats, dt: float) -> Floats:
        """As the model, then confined."""
        return self.confine(self.motion.drift(states, dt))

    def confine(self, moved: Floats) -> Floats:
        """`moved` (N, D), changed in place: centres on the image, sizes of 1 px to twice the image's."""
        # Imported here: a graph is validated without compiling anything.
        from bayesnet_track.numerics.kernels.kinematic_kernels import confine

        if self.leaves_image:
            np.maximum(moved[:, 2:4], 1.0, out=moved[:, 2:4])
        else:
            confine(moved, float(self.width), float(self.height))
        return moved

    def confine_moments(self, mean: Floats, covariance: Floats) -> tuple[Floats, Floats]:
        """Copies of a mean (D,), confined, and of a covariance (D, D), no wider than of a box anywhere."""
        # Imported here: a graph is validated without compiling anything.
        from bayesnet_track.numerics.kernels.kinematic_kernels import confine_moments

        across, down = (math.inf, math.inf) if self.leaves_image else (float(self.width), float(self.height))
        held, spread = np.array(mean, np.float64), np.array(covariance, np.float64, order="C")
        confine_moments(held, spread, across, down)
        return held, spread

    @cached_property
    def leaves_image(self) -> bool:
        """Whether the model's centres go on beyond the image."""
        return bool(getattr(self.motion, "leaves_image", False))

    @property
    def extent(self) -> Floats:
        """(2,) width and height of the image; infinite where nothing is confined to it."""
        return np.array(
            [np.inf, np.inf] if self.leaves_image else [self.width, self.height], dtype=np.float64
        )
