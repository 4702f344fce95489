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

    def confine_one(self, state: Floats) -> Floats:
        """A copy of the state (D,), confined."""
        x, y, w, h = state[:4].tolist()
        held = state.copy()
        if self.leaves_image:
            held[2:4] = max(w, 1.0), max(h, 1.0)
        else:
            across, down = float(self.width), float(self.height)
            held[0], held[1] = min(max(x, 0.0), across - 1.0), min(max(y, 0.0), down - 1.0)
            held[2], held[3] = min(max(w, 1.0), 2.0 * across), min(max(h, 1.0), 2.0 * down)
        return held

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

    def spread_limit(self, mean: Floats) -> tuple[float, ...]:
        """Root mean square distances from the state `mean` (D,), by x, y, w, h, of a box anywhere."""
        if self.leaves_image:
            return (math.inf,) * 4
        low, across, down = (0.0, 0.0, 1.0, 1.0), float(self.width), float(self.height)
        high = across - 1.0, down - 1.0, 2.0 * across, 2.0 * down
        return tuple(
            math.sqrt((b - a) ** 2 / 12 + (at - (a + b) / 2) ** 2)
            for a, b, at in zip(low, high, mean[:4].tolist(), strict=True)
        )
