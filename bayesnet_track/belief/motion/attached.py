"""Being carried, as a part of each hypothesis: it moves as its carrier does, or on its own."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import Ancestors, MotionModel
from bayesnet_track.belief.motion.noise import Transition
from bayesnet_track.belief.particles.particle_set import ParticleSet
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.cue import ANGLE

FIELD = "carried"
"""Name of the state's last column: 1 while it is carried, else 0."""


@dataclass(frozen=True, eq=False)
class Attached:
    """`motion`, with a last column of the state that says whether it is carried, a chain of its own.

    A hypothesis that is carried is moved by the carrier's displacement and Gaussian noise, and has the
    carrier's velocity where it has one; its size changes as `motion` says. Densities are those of a carried
    hypothesis that `motion` moves from where its velocity, or the displacement, leads it.

    Attributes:
        motion: how it moves on its own.
        displacement: (2,) of the carrier's centre since the last frame, px.
        start_share: probability per frame interval of being picked up.
        stay_share: the same of staying carried.
        sd_px: sd of what is carried beside its carrier, px per frame interval.
    """

    motion: MotionModel
    displacement: Floats
    start_share: float
    stay_share: float
    sd_px: float

    @property
    def fields(self) -> tuple[str, ...]:
        """Fields of the model, and whether it is carried."""
        return (*self.motion.fields, FIELD)

    def start(self, box: Floats, size: int, rng: np.random.Generator) -> Floats:
        """Like the model, not carried."""
        return with_column(self.motion.start(box, size, rng), np.zeros(size))

    def start_moments(self, box: Floats) -> tuple[Floats, Floats]:
        """Like the model, not carried."""
        mean, covariance = self.motion.start_moments(box)
        return np.append(mean, 0.0), np.pad(covariance, (0, 1))

    def propagate(
        self, states: Floats, dt: float, rng: np.random.Generator, parents: Ancestors | None = None
    ) -> Floats:
        """(N, D) states after `dt` frame intervals."""
        previous = states if parents is None else states[parents]
        moved_states = self.motion.propagate(np.ascontiguousarray(previous[:, :-1]), dt, rng)
        carried = self._draw_carried(previous[:, -1] > 0, dt, rng)
        count = int(carried.sum())
        noise = rng.standard_normal((count, 2)) * (self.sd_px * np.sqrt(dt))
        moved_states[carried, :2] = previous[carried, :2] + self.displacement + noise
        if self._kinematic >= 6:
            moved_states[carried, 4:6] = self.displacement / dt
        moved_states[carried, 6 : self._kinematic] = 0.0
        return with_column(moved_states, carried)

    def drift(self, states: Floats, dt: float) -> Floats:
        """(N, D) states after `dt` frame intervals without noise, carried or not as before."""
        moved_states = self.motion.drift(np.ascontiguousarray(self._seed_velocity(states, dt)), dt)
        return with_column(moved_states, states[:, -1])

    def linearise(self, state: Floats, dt: float) -> tuple[Floats, Floats]:
        """Fields of the model; the last field stays."""
        transition, covariance = self.motion.linearise(state[:-1], dt)
        padded = np.pad(transition, (0, 1))
        padded[-1, -1] = 1.0
        return padded, np.pad(covariance, (0, 1))

    def log_density(self, states: Floats, previous: Floats, dt: float) -> Floats:
        """(M, N) that of the model, from where what is carried would be without its noise."""
        return self.motion.log_density(states[:, :-1], self._seed_velocity(previous, dt), dt)

    def transition(self, previous: Floats, dt: float) -> Transition:
        """Log density of the transition; `states` keeps the last field of the state it is given."""
        transition = self.motion.transition(self._seed_velocity(previous, dt), dt)

        def coordinates(states: Floats) -> tuple[Floats, Floats]:
            return transition.coordinates(np.ascontiguousarray(states[:, :-1]))

        def states_at(points: Floats, still: Floats) -> Floats:
            assert transition.states is not None
            return with_column(transition.states(points, np.ascontiguousarray(still[:, :-1])), still[:, -1])

        return replace(
            transition, coordinates=coordinates, states=None if transition.states is None else states_at
        )

    def _seed_velocity(self, states: Floats, dt: float) -> Floats:
        """The states without the last field, those carried so that `motion` takes them with the carrier."""
        seeded = states[:, :-1].copy()
        carried = states[:, -1] > 0
        if self._kinematic >= 6:
            seeded[carried, 4:6] = self.displacement / dt
            seeded[carried, 6 : self._kinematic] = 0.0
        else:
            seeded[carried, :2] += self.displacement
        return seeded

    @property
    def _kinematic(self) -> int:
        """Columns of a state up to its last derivative: an angle and deviations stay what they are."""
        return sum(name != ANGLE and "." not in name for name in self.motion.fields)

    def _draw_carried(
        self, was_carried: NDArray[np.bool_], dt: float, rng: np.random.Generator
    ) -> NDArray[np.bool_]:
        """(N,) whether each is carried now: the chain over `dt`, its changes drawn systematically."""
        stationary = self.start_share / (self.start_share + 1.0 - self.stay_share)
        memory = (self.stay_share - self.start_share) ** dt if self.stay_share > self.start_share else 0.0
        probability = stationary + np.where(was_carried, 1.0 - stationary, -stationary) * memory
        points = (rng.permutation(len(was_carried)) + rng.random(len(was_carried))) / len(was_carried)
        return np.asarray(points < probability)


def with_column(states: Floats, carried: NDArray[np.generic]) -> Floats:
    """(N, D + 1) the states and whether each is carried."""
    return np.concatenate([states, np.asarray(carried, dtype=np.float64)[:, None]], axis=1)


def with_carried(belief: ParticleSet, carried: Floats | None) -> ParticleSet:
    """The belief with the last field; nothing is carried when (N,) `carried` is None."""
    column = np.zeros(len(belief)) if carried is None else carried
    return replace(belief, states=with_column(belief.states, column), fields=(*belief.fields, FIELD))


def without_carried(belief: ParticleSet) -> tuple[ParticleSet, Floats]:
    """The belief without the last field, and that field (N,)."""
    states = np.ascontiguousarray(belief.states[:, :-1])
    return replace(belief, states=states, fields=belief.fields[:-1]), belief.states[:, -1].copy()
