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
    for motion in sorted(motions, key=lambda motion: -len(motion.fields)):
        mean, covariance = motion.start_moments(np.ones(4))
        moments = zip(motion.fields, mean.tolist(), np.sqrt(np.diagonal(covariance)).tolist(), strict=True)
        for name, start, sd in moments:
            starts.setdefault(name, (start, sd))
    fields = tuple(starts)
    completed: dict[int, MotionModel] = {}
    for motion in motions:
        if id(motion) not in completed:
            missing = [starts[name] for name in fields if name not in motion.fields]
            means, sds = tuple(mean for mean, _ in missing), tuple(sd for _, sd in missing)
            completed[id(motion)] = (
                motion if motion.fields == fields else Forgetting(motion, fields, sds, means)
            )
    return tuple(completed[id(motion)] for motion in motions)


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
    def _columns(self) -> list[int]:
        return [self.fields.index(name) for name in self.motion.fields]

    @cached_property
    def _extra_columns(self) -> list[int]:
        return [k for k, name in enumerate(self.fields) if name not in self.motion.fields]

    @cached_property
    def _noisy_columns(self) -> list[int]:
        """Further fields that have noise: the others are their means."""
        return [k for k, sd in zip(self._extra_columns, self.sds, strict=True) if sd > 0]

    @cached_property
    def _centre(self) -> Floats:
        return np.array(self.means or np.zeros(len(self.sds)))

    def start(self, box: Floats, size: int, rng: np.random.Generator) -> Floats:
        """Like the model, the further fields drawn."""
        return self._join(self.motion.start(box, size, rng), rng)

    def start_moments(self, box: Floats) -> tuple[Floats, Floats]:
        """Mean and covariance of what `start` draws."""
        mean, covariance = np.zeros(len(self.fields)), self._spread()
        mean[self._columns], covariance[np.ix_(self._columns, self._columns)] = self.motion.start_moments(box)
        mean[self._extra_columns] = self._centre
        return mean, covariance

    def propagate(
        self, states: Floats, dt: float, rng: np.random.Generator, parents: Ancestors | None = None
    ) -> Floats:
        """(N, D) states after `dt` frame intervals."""
        return self._join(self.motion.propagate(self._select(states), dt, rng, parents), rng)

    def drift(self, states: Floats, dt: float) -> Floats:
        """(N, D) states after `dt` frame intervals without noise: further fields are their means."""
        drifted = np.empty((len(states), len(self.fields)))
        drifted[:, self._columns] = self.motion.drift(self._select(states), dt)
        drifted[:, self._extra_columns] = self._centre
        return drifted

    def linearise(self, state: Floats, dt: float) -> tuple[Floats, Floats]:
        """F and Q: nothing of the further fields is kept."""
        transition, covariance = np.zeros((len(self.fields),) * 2), self._spread()
        block = np.ix_(self._columns, self._columns)
        transition[block], covariance[block] = self.motion.linearise(state[self._columns], dt)
        return transition, covariance

    def log_density(self, states: Floats, previous: Floats, dt: float) -> Floats:
        """(M, N) that of the model, times that of the further fields."""
        sds, means = np.array([sd for sd in self.sds if sd > 0]), self._centre[np.array(self.sds) > 0]
        normal = -0.5 * ((states[:, self._noisy_columns] - means) / sds) ** 2 - np.log(
            sds * np.sqrt(2.0 * np.pi)
        )
        log = self.motion.log_density(self._select(states), self._select(previous), dt)
        return np.asarray(log + normal.sum(axis=1)[:, None])

    def transition(self, previous: Floats, dt: float) -> Transition:
        """Transition of the model; the further fields are the last coordinates."""
        transition = self.motion.transition(self._select(previous), dt)
        sds = np.broadcast_to(
            [sd for sd in self.sds if sd > 0], (*transition.sds.shape[:2], len(self._noisy_columns))
        )
        means = self._centre[np.array(self.sds) > 0]

        def coordinates(states: Floats) -> tuple[Floats, Floats]:
            points, log_jacobian = transition.coordinates(self._select(states))
            return np.concatenate([points, states[:, self._noisy_columns]], axis=1), log_jacobian

        return replace(
            transition,
            coordinates=coordinates,
            means=np.concatenate(
                [transition.means, np.broadcast_to(means, (len(previous), len(means)))], axis=1
            ),
            sds=np.concatenate([transition.sds, sds], axis=2),
            states=None,
        )

    def _select(self, states: Floats) -> Floats:
        return np.ascontiguousarray(states[:, self._columns])

    def _spread(self) -> Floats:
        covariance = np.zeros((len(self.fields),) * 2)
        covariance[self._extra_columns, self._extra_columns] = np.square(self.sds)
        return covariance

    def _join(self, moved_states: Floats, rng: np.random.Generator) -> Floats:
        states = np.empty((len(moved_states), len(self.fields)))
        states[:, self._columns] = moved_states
        normals = rng.standard_normal((len(moved_states), len(self.sds)))
        states[:, self._extra_columns] = self._centre + normals * np.array(self.sds)
        return states
