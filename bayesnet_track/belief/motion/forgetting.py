"""Motions of one state: those that lack some of its fields forget them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayesnet_track.belief.contract import Ancestors, MotionModel
from bayesnet_track.belief.motion.noise import Transition
from bayesnet_track.numerics.arrays import Floats


def complete(motions: tuple[MotionModel, ...]) -> tuple[MotionModel, ...]:
    """The motions, all with the fields of all of them; those that have them already are the same objects.

    The fields of the longest motion come first, then those of the others. A field that a motion does not have
    is drawn anew in each frame, as at the start of a target that moves as the first one says that has it:
    after a stop the target sets off in any direction.
    """
    starts: dict[str, tuple[float, float]] = {}
    for one in sorted(motions, key=lambda one: -len(one.fields)):
        mean, covariance = one.start_moments(np.ones(4))
        own = zip(one.fields, mean.tolist(), np.sqrt(np.diagonal(covariance)).tolist(), strict=True)
        for name, start, sd in own:
            starts.setdefault(name, (start, sd))
    fields = tuple(starts)
    made: dict[int, MotionModel] = {}
    for one in motions:
        if id(one) not in made:
            missing = [starts[name] for name in fields if name not in one.fields]
            means, sds = tuple(mean for mean, _ in missing), tuple(sd for _, sd in missing)
            made[id(one)] = one if one.fields == fields else Forgetting(one, fields, sds, means)
    return tuple(made[id(one)] for one in motions)


@dataclass(frozen=True, eq=False)
class Forgetting:
    """`motion`, in a state with further fields, which are drawn anew in every frame.

    Attributes:
        motion: how the fields move that it has.
        fields: of the whole state.
        sds: of the further fields, in the order of the state.
        means: around which they are drawn; zeros when empty.
    """

    motion: MotionModel
    fields: tuple[str, ...]
    sds: tuple[float, ...]
    means: tuple[float, ...] = ()

    @cached_property
    def _own(self) -> list[int]:
        return [self.fields.index(name) for name in self.motion.fields]

    @cached_property
    def _further(self) -> list[int]:
        return [k for k, name in enumerate(self.fields) if name not in self.motion.fields]

    @cached_property
    def _drawn(self) -> list[int]:
        """Further fields that have noise: the others are their means."""
        return [k for k, sd in zip(self._further, self.sds, strict=True) if sd > 0]

    @cached_property
    def _centre(self) -> Floats:
        return np.array(self.means or np.zeros(len(self.sds)))

    def start(self, box: Floats, size: int, rng: np.random.Generator) -> Floats:
        """Like the model, the further fields drawn."""
        return self._join(self.motion.start(box, size, rng), rng)

    def start_moments(self, box: Floats) -> tuple[Floats, Floats]:
        """Mean and covariance of what `start` draws."""
        mean, covariance = np.zeros(len(self.fields)), self._spread()
        mean[self._own], covariance[np.ix_(self._own, self._own)] = self.motion.start_moments(box)
        mean[self._further] = self._centre
        return mean, covariance

    def propagate(
        self, states: Floats, dt: float, rng: np.random.Generator, parents: Ancestors | None = None
    ) -> Floats:
        """(N, D) states after `dt` frame intervals."""
        return self._join(self.motion.propagate(self._of(states), dt, rng, parents), rng)

    def drift(self, states: Floats, dt: float) -> Floats:
        """(N, D) states after `dt` frame intervals without noise: further fields are their means."""
        found = np.empty((len(states), len(self.fields)))
        found[:, self._own] = self.motion.drift(self._of(states), dt)
        found[:, self._further] = self._centre
        return found

    def linearise(self, state: Floats, dt: float) -> tuple[Floats, Floats]:
        """F and Q: nothing of the further fields is kept."""
        whole, covariance = np.zeros((len(self.fields),) * 2), self._spread()
        at = np.ix_(self._own, self._own)
        whole[at], covariance[at] = self.motion.linearise(state[self._own], dt)
        return whole, covariance

    def log_density(self, new: Floats, old: Floats, dt: float) -> Floats:
        """(M, N) that of the model, times that of the further fields."""
        sds, means = np.array([sd for sd in self.sds if sd > 0]), self._centre[np.array(self.sds) > 0]
        normal = -0.5 * ((new[:, self._drawn] - means) / sds) ** 2 - np.log(sds * np.sqrt(2.0 * np.pi))
        own = self.motion.log_density(self._of(new), self._of(old), dt)
        return np.asarray(own + normal.sum(axis=1)[:, None])

    def transition(self, old: Floats, dt: float) -> Transition:
        """Transition of the model; the further fields are the last coordinates."""
        own = self.motion.transition(self._of(old), dt)
        sds = np.broadcast_to([sd for sd in self.sds if sd > 0], (*own.sds.shape[:2], len(self._drawn)))
        means = self._centre[np.array(self.sds) > 0]

        def coordinates(states: Floats) -> tuple[Floats, Floats]:
            points, log_jacobian = own.coordinates(self._of(states))
            return np.concatenate([points, states[:, self._drawn]], axis=1), log_jacobian

        return replace(
            own,
            coordinates=coordinates,
            means=np.concatenate([own.means, np.broadcast_to(means, (len(old), len(means)))], axis=1),
            sds=np.concatenate([own.sds, sds], axis=2),
            states=None,
        )

    def _of(self, states: Floats) -> Floats:
        return np.ascontiguousarray(states[:, self._own])

    def _spread(self) -> Floats:
        covariance = np.zeros((len(self.fields),) * 2)
        covariance[self._further, self._further] = np.square(self.sds)
        return covariance

    def _join(self, moved: Floats, rng: np.random.Generator) -> Floats:
        found = np.empty((len(moved), len(self.fields)))
        found[:, self._own] = moved
        drawn = rng.standard_normal((len(moved), len(self.sds)))
        found[:, self._further] = self._centre + drawn * np.array(self.sds)
        return found
