"""Motion models confined to the image: wrapped, bounded, and bouncing off the borders of the frame."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from types import MappingProxyType
from typing import Any, cast

import numpy as np

from bayesnet_track.belief.contract import LEAST_SIDE_PX, Ancestors, MotionModel
from bayesnet_track.belief.motion.averaged import Averaged
from bayesnet_track.belief.motion.modes import Modal
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
        """Fields of the model."""
        return self.motion.fields

    def start(self, box: Floats, size: int, rng: np.random.Generator) -> Floats:
        """Like the model."""
        return self.motion.start(box, size, rng)

    def start_moments(self, box: Floats) -> tuple[Floats, Floats]:
        """Like the model."""
        return self.motion.start_moments(box)

    def propagate(
        self, states: Floats, dt: float, rng: np.random.Generator, parents: Ancestors | None = None
    ) -> Floats:
        """Like the model."""
        return self.motion.propagate(states, dt, rng, parents)

    def drift(self, states: Floats, dt: float) -> Floats:
        """Like the model."""
        return self.motion.drift(states, dt)

    def linearise(self, state: Floats, dt: float) -> tuple[Floats, Floats]:
        """Like the model."""
        return self.motion.linearise(state, dt)

    def log_density(self, states: Floats, previous: Floats, dt: float) -> Floats:
        """Like the model."""
        return self.motion.log_density(states, previous, dt)

    def transition(self, previous: Floats, dt: float) -> Transition:
        """Like the model."""
        return self.motion.transition(previous, dt)


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
        """Like the model, then confined."""
        return self.confine(self.motion.propagate(states, dt, rng, parents))

    def drift(self, states: Floats, dt: float) -> Floats:
        """Like the model, then confined."""
        return self.confine(self.motion.drift(states, dt))

    def confine(self, states: Floats) -> Floats:
        """`states` (N, D), changed in place: centres on the image, sizes of 1 px to twice the image's."""
        # Imported here: a graph is validated without compiling anything.
        from bayesnet_track.numerics.kernels.box_kernels import confine

        if self.leaves_image:
            np.maximum(states[:, 2:4], self.least_side, out=states[:, 2:4])
        else:
            confine(states, float(self.width), float(self.height))
        return states

    def confine_moments(self, mean: Floats, covariance: Floats) -> tuple[Floats, Floats]:
        """Copies of a mean (D,), confined, and of a covariance (D, D), no wider than of a box anywhere."""
        # Imported here: a graph is validated without compiling anything.
        from bayesnet_track.numerics.kernels.box_kernels import confine_moments

        width, height = (math.inf, math.inf) if self.leaves_image else (float(self.width), float(self.height))
        bounded, spread = np.array(mean, np.float64), np.array(covariance, np.float64, order="C")
        if self.least_side != LEAST_SIDE_PX:
            bounded[2:4] = np.maximum(bounded[2:4], self.least_side)
            return bounded, spread
        confine_moments(bounded, spread, width, height)
        return bounded, spread

    @cached_property
    def leaves_image(self) -> bool:
        """True if the model's centres go on beyond the image."""
        return bool(getattr(self.motion, "leaves_image", False))

    @cached_property
    def least_side(self) -> float:
        """The least width and height of a target, in the unit of the state."""
        return float(getattr(self.motion, "least_side", LEAST_SIDE_PX))

    @property
    def extent(self) -> Floats:
        """(2,) width and height of the image; infinite where nothing is confined to it."""
        return np.array(
            [np.inf, np.inf] if self.leaves_image else [self.width, self.height], dtype=np.float64
        )


ALONG = (("x", "vx", "ax"), ("y", "vy", "ay"))
"""The fields that turn round where a box bounces off a border, for each axis."""


NOTHING: Mapping[str, float] = MappingProxyType({})


def confined(motion: MotionModel, width: int, height: int, inputs: Mapping[str, float] = NOTHING) -> Confined:
    """The motion on an image of `width` columns and `height` rows, into a frame with these inputs."""
    return Confined(framed(motion, (width, height), inputs), width, height)


def framed(
    motion: MotionModel, frame: tuple[int, int] | None, inputs: Mapping[str, float] = NOTHING
) -> MotionModel:
    """The motion with the frame (width, height) and its inputs where it, or one inside it, asks for them."""
    if isinstance(motion, Averaged):
        return Averaged(cast(Modal, framed(motion.modal, frame, inputs)))
    if isinstance(motion, Modal):
        return motion.each(lambda part: framed(part, frame, inputs))
    changes: dict[str, Any] = {"frame": frame} if frame is not None and hasattr(motion, "frame") else {}
    if inputs and hasattr(motion, "inputs"):
        changes["inputs"] = inputs
    if (inner := getattr(motion, "motion", None)) is not None and (
        framed_inner := framed(inner, frame, inputs)
    ) is not inner:
        changes["motion"] = framed_inner
    return cast(MotionModel, replace(cast(Any, motion), **changes)) if changes else motion


@dataclass(frozen=True, eq=False)
class Reflecting(Wrapped):
    """`motion`, the box reflected at the borders of the frame, and its velocity and acceleration with it.

    A box touches a border where its side reaches it: the centre's column stays in
    [w / 2 - 1/2, W - 1/2 - w / 2]. A box that is larger than the frame is centred. The noise is added first,
    so that what it carries over a border is reflected, too.

    Attributes:
        motion: how it moves away from borders.
        frame: columns and rows of the frame; None before one is known, where nothing is reflected.
    """

    frame: tuple[int, int] | None = None

    def propagate(
        self, states: Floats, dt: float, rng: np.random.Generator, parents: Ancestors | None = None
    ) -> Floats:
        """Like the model, then reflected."""
        return self.reflect(self.motion.propagate(states, dt, rng, parents))

    def drift(self, states: Floats, dt: float) -> Floats:
        """Like the model, then reflected."""
        return self.reflect(self.motion.drift(states, dt))

    def linearise(self, state: Floats, dt: float) -> tuple[Floats, Floats]:
        """J F and J Q J', J the derivative of the reflection where the drift leads."""
        transition, noise = self.motion.linearise(state, dt)
        turn = self._jacobian(self.motion.drift(state[None], dt)[0])
        return turn @ transition, turn @ noise @ turn.T

    def log_density(self, states: Floats, previous: Floats, dt: float) -> Floats:
        """(M, N) log of the sum over the mirror images of each new state, one reflection an axis."""
        free = self.motion.transition(previous, dt)
        if self.frame is None:
            return free.log_density(states)
        total = free.log_density(states)
        for image in list(product((None, 0, 1), repeat=2))[1:]:
            mirrored = states
            for axis, side in enumerate(image):
                mirrored = mirrored if side is None else self._mirrored(mirrored, axis, side)
            total = np.logaddexp(total, free.log_density(mirrored))
        return np.asarray(total)

    def transition(self, previous: Floats, dt: float) -> Transition:
        """The model's around the reflected drift: what noise alone carries over a border is left out."""
        transition = self.motion.transition(previous, dt)
        return replace(transition, means=transition.coordinates(self.drift(previous, dt))[0])

    def reflect(self, states: Floats) -> Floats:
        """`states` (N, D), changed in place: folded back into the frame as often as it takes."""
        for axis in (0, 1) if self.frame is not None else ():
            low, room = self._room(states, axis)
            with np.errstate(divide="ignore", invalid="ignore"):
                offset = np.where(room > 0, (states[:, axis] - low) % (2.0 * room), 0.0)
            states[:, axis] = low + np.minimum(offset, 2.0 * room - offset)
            turned = (offset > room)[:, None]
            columns = self._derivatives(axis)
            states[:, columns] = np.where(turned, -states[:, columns], states[:, columns])
        return states

    def _room(self, states: Floats, axis: int) -> tuple[Floats, Floats]:
        """(N,) least position of the centre along an axis, and how far it may go from there, at least 0."""
        assert self.frame is not None
        size, half = self.frame[axis], states[:, 2 + axis] / 2
        return np.minimum(half - 0.5, (size - 1) / 2), np.maximum(size - 2.0 * half, 0.0)

    def _derivatives(self, axis: int) -> list[int]:
        return [k for k, name in enumerate(self.fields) if name in ALONG[axis][1:]]

    def _mirrored(self, states: Floats, axis: int, side: int) -> Floats:
        """(N, D) states mirrored at the low (0) or the high (1) border of an axis."""
        low, room = self._room(states, axis)
        mirrored = states.copy()
        mirrored[:, axis] = 2.0 * (low + side * room) - states[:, axis]
        columns = self._derivatives(axis)
        mirrored[:, columns] *= -1.0
        return mirrored

    def _jacobian(self, state: Floats) -> Floats:
        """(D, D) derivative of the reflection at a state (D,) that was moved."""
        jacobian = np.eye(len(state))
        for axis in (0, 1) if self.frame is not None else ():
            low, room = (float(bound[0]) for bound in self._room(state[None], axis))
            if room == 0.0:
                jacobian[axis, axis] = 0.0
                continue
            times = int(np.floor((state[axis] - low) / room))
            sign = -1.0 if times % 2 else 1.0
            jacobian[axis, axis] = sign
            jacobian[axis, 2 + axis] = sign * times  # borders stand half a side inside the frame
            for column in self._derivatives(axis):
                jacobian[column, column] = sign
        return jacobian
