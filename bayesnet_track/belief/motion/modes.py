"""Modes of a target: their names and transitions, and the motion of each hypothesis in its mode."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import Ancestors, MotionModel, Posterior
from bayesnet_track.belief.motion.noise import Transition
from bayesnet_track.belief.motion.start_prior import StartPrior
from bayesnet_track.graph.settings.motion import Hidden, Mode
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.density import Chain

FIELD = "mode"
"""Name of the last column of the states of particles: the number of the mode."""


@dataclass(frozen=True)
class Modes:
    """K modes.

    Attributes:
        names: of the modes, in the order of the graph.
        chain: how they follow each other.
        unseen: (K,) what agents say while the target is hidden; None for a mode in which it is seen.
    """

    names: tuple[str, ...]
    chain: Chain
    unseen: tuple[Hidden | None, ...]

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def hidden(self) -> tuple[bool, ...]:
        """(K,) in which the target cannot be seen."""
        return tuple(one is not None for one in self.unseen)

    @property
    def can_hide(self) -> bool:
        """True if the target cannot be seen in one of them."""
        return any(self.hidden)

    @property
    def missed(self) -> float:
        """Probability that an agent that measures misses a target that can be seen; 0 where it always can."""
        return max((one.missed for one in self.unseen if one is not None), default=0.0)

    @property
    def lost_above(self) -> float:
        """Probability of being hidden above which the target counts as lost."""
        return min((one.lost_above for one in self.unseen if one is not None), default=1.0)

    def start(self) -> Floats:
        """(K,) probabilities where the target starts: those of the long run, given that it is seen."""
        shares = np.where(self.hidden, 0.0, self.chain.stationary())
        if shares.sum() <= 0.0:
            shares = np.where(self.hidden, 0.0, 1.0)
        return np.asarray(shares / shares.sum())

    def named(self, probabilities: Floats) -> dict[str, float]:
        """Name -> probability."""
        return dict(zip(self.names, probabilities.tolist(), strict=True))

    def probability_hidden(self, probabilities: Floats) -> float:
        """Probability that it cannot be seen."""
        return float(min(probabilities[list(self.hidden)].sum(), 1.0))


@runtime_checkable
class Moded(Protocol):
    """A posterior that says how probable its modes are."""

    @property
    def mode_probabilities(self) -> Floats:
        """(K,) probabilities of the modes."""


def mode_probabilities(posterior: Posterior, size: int) -> Floats:
    """(size,) probabilities of the modes.

    Raises:
        TypeError: the belief has no modes.
    """
    if isinstance(posterior, Moded):
        return posterior.mode_probabilities
    states, weights = getattr(posterior, "states", None), getattr(posterior, "weights", None)
    if states is None or weights is None or posterior.fields[-1] != FIELD:
        raise TypeError(f"a {type(posterior).__name__} has no modes")
    counted = np.bincount(states[:, -1].astype(np.intp), weights.weights, minlength=size)
    return np.asarray(counted, dtype=np.float64)


def moments_of(posterior: Posterior) -> tuple[Floats, Floats]:
    """Mean and covariance of a belief's state without the mode, which is no quantity."""
    size = len(posterior.fields) - (posterior.fields[-1] == FIELD)
    return posterior.mean[:size], posterior.covariance[:size, :size]


def make_modes(settings: Mapping[str, Mode]) -> Modes:
    """The modes that a graph asks for."""
    names = tuple(settings)
    by_rates = all(mode.next is None for mode in settings.values())
    rows = []
    for number, (name, mode) in enumerate(settings.items()):
        if mode.next is not None:
            rows.append(tuple(mode.next.get(other, 0.0) for other in names))
            continue
        assert mode.mean_frames is not None
        follow = mode.then or {other: 1.0 for other in names if other != name}
        total = sum(follow.values())
        rates = [follow.get(other, 0.0) / total / mode.mean_frames for other in names]
        rates[number] = -1.0 / mode.mean_frames
        rows.append(tuple(rates))
    return Modes(names, Chain(tuple(rows), by_rates), tuple(mode.hidden for mode in settings.values()))


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


@dataclass(frozen=True, eq=False)
class Modal:
    """A motion model (`belief.contract.MotionModel`) whose last field is the number of the mode.

    The mode is drawn first, from the one before, then the state is moved as the new mode says.

    Attributes:
        modes: the modes.
        parts: how the target moves in each; they may have different fields.
        settled: the modes of the states that are moved are those after the move already.
        prior: distributions of fields at the start in place of those of the motions; None without any.
    """

    modes: Modes
    parts: tuple[MotionModel, ...]
    settled: bool = False
    prior: StartPrior | None = None

    @cached_property
    def motions(self) -> tuple[MotionModel, ...]:
        """Motions in each mode, all with the same fields, without the mode."""
        return complete(self.parts)

    @property
    def fields(self) -> tuple[str, ...]:
        """Fields of the motions, and the mode."""
        return (*self.motions[0].fields, FIELD)

    @property
    def chain(self) -> Chain:
        """Chain by which modes follow each other."""
        return self.modes.chain

    @property
    def leaves_image(self) -> bool:
        """True if the centres of every mode go on beyond the image."""
        return all(getattr(one, "leaves_image", False) for one in self.parts)

    def each(self, change: Callable[[MotionModel], MotionModel]) -> Modal:
        """With every mode's motion changed; modes that shared one still do. Itself where nothing changes."""
        made: dict[int, MotionModel] = {}
        for one in self.parts:
            if id(one) not in made:
                made[id(one)] = change(one)
        parts = tuple(made[id(one)] for one in self.parts)
        same = all(new is old for new, old in zip(parts, self.parts, strict=True))
        return self if same else replace(self, parts=parts)

    def start(self, box: Floats, size: int, rng: np.random.Generator) -> Floats:
        """(size, D) states in the centre box (4,), in modes in which it is seen."""
        states = self._first.start(box, size, rng)
        if self.prior is not None:
            states = self.prior.applied_to(self._first.fields, states, box, rng)
        points = (rng.permutation(size) + rng.random(size)) / size
        return _with(states, draw(np.tile(self.modes.start(), (size, 1)), points))

    def start_moments(self, box: Floats) -> tuple[Floats, Floats]:
        """(D - 1,) mean and covariance without the mode."""
        mean, spread = self._first.start_moments(box)
        if self.prior is None:
            return mean, spread
        return self.prior.moments_of(self._first.fields, mean, spread, box)

    def propagate(
        self, states: Floats, dt: float, rng: np.random.Generator, parents: Ancestors | None = None
    ) -> Floats:
        """(N, D) states after `dt` frame intervals."""
        old = states if parents is None else states[parents]
        modes = old[:, -1].astype(np.intp)
        if not self.settled:
            points = (rng.permutation(len(old)) + rng.random(len(old))) / len(old)
            modes = draw(self.chain.over(dt)[modes], points)
        before = np.ascontiguousarray(old[:, :-1])
        moved = np.empty_like(before)
        for motion, chosen in self._groups(modes):
            moved[chosen] = motion.propagate(before, dt, rng, chosen)
        return _with(moved, modes)

    def drift(self, states: Floats, dt: float) -> Floats:
        """(N, D) states after `dt` frame intervals without noise, each in the mode that it is in."""
        before = np.ascontiguousarray(states[:, :-1])
        moved = np.empty_like(before)
        for motion, chosen in self._groups(states[:, -1].astype(np.intp)):
            moved[chosen] = motion.drift(before[chosen], dt)
        return _with(moved, states[:, -1])

    def linearise(self, state: Floats, dt: float) -> tuple[Floats, Floats]:
        """F and Q of the mode that the state is in; the mode stays."""
        transition, covariance = self.motions[int(state[-1])].linearise(state[:-1], dt)
        whole = np.pad(transition, (0, 1))
        whole[-1, -1] = 1.0
        return whole, np.pad(covariance, (0, 1))

    def log_density(self, new: Floats, old: Floats, dt: float) -> Floats:
        """(M, N) log P(mode | mode before) + log p(new | old) as the new mode moves."""
        modes, before = new[:, -1].astype(np.intp), np.ascontiguousarray(old[:, :-1])
        with np.errstate(divide="ignore"):
            log_chain = np.log(self.chain.over(dt))[old[:, -1].astype(np.intp)]
        found = np.empty((len(new), len(old)))
        for number, motion in enumerate(self.motions):
            chosen = np.flatnonzero(modes == number)
            if len(chosen):
                own = motion.log_density(np.ascontiguousarray(new[chosen, :-1]), before, dt)
                found[chosen] = own + log_chain[:, number]
        return found

    def transition(self, old: Floats, dt: float) -> Transition:
        """Not known: modes that move differently have no coordinates in common.

        Raises:
            TypeError: always.
        """
        raise TypeError("a motion in modes is no mixture of Gaussians in one set of coordinates")

    @cached_property
    def _first(self) -> MotionModel:
        """The motion as which the target starts: the one with the most fields of its own."""
        longest = max(range(len(self.parts)), key=lambda k: len(self.parts[k].fields))
        return self.motions[longest]

    def _groups(self, modes: NDArray[np.intp]) -> list[tuple[MotionModel, NDArray[np.intp]]]:
        """Motions and the hypotheses that they move: modes that share one are moved together."""
        groups: dict[int, list[int]] = {}
        for number, one in enumerate(self.motions):
            groups.setdefault(id(one), []).append(number)
        found = []
        for numbers in groups.values():
            chosen = np.flatnonzero(np.isin(modes, numbers))
            if len(chosen):
                found.append((self.motions[numbers[0]], chosen.astype(np.intp, copy=False)))
        return found


def draw(probabilities: Floats, points: Floats) -> NDArray[np.intp]:
    """(N,) a mode for each row of probabilities (N, K), by points (N,) in 0..1."""
    above = probabilities.cumsum(axis=1)[:, :-1]
    return np.asarray((points[:, None] >= above).sum(axis=1), dtype=np.intp)


def _with(states: Floats, modes: NDArray[np.generic]) -> Floats:
    return np.concatenate([states, np.asarray(modes, dtype=np.float64)[:, None]], axis=1)
