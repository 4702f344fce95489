"""Modes of a target: their names and transitions, and the motion of each hypothesis in its mode."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import Ancestors, MotionModel, Posterior
from bayesnet_track.belief.motion.forgetting import complete
from bayesnet_track.belief.motion.noise import Transition
from bayesnet_track.belief.motion.start_prior import StartPrior
from bayesnet_track.graph.settings.motion import Hidden, Mode
from bayesnet_track.graph.settings.net import Category
from bayesnet_track.graph.spec import InferenceNode
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.distributions import Chain

FIELD = "mode"
"""Name of the last column of the states of particles: the number of the mode."""


@dataclass(frozen=True)
class Constant:
    """A discrete constant of a target: what it is and stays.

    Attributes:
        name: such as `team`.
        values: what it may be.
        prior: probability of each when the target starts.
    """

    name: str
    values: tuple[str, ...]
    prior: tuple[float, ...]


def mode_key(constant: str, value: str) -> str:
    """Name of a value's probability in results.

    >>> mode_key("team", "red")
    'team=red'
    """
    return f"{constant}={value}"


@dataclass(frozen=True)
class Modes:
    """K modes: ways to be in, and beside them what the target is and stays.

    With constants a mode is a way and a value of each constant, the last constant's changing first. Ways
    follow each other, values never do.

    Attributes:
        ways: names of the ways, in the order of the graph; one, without a name, beside constants alone.
        chain: how modes follow each other.
        unseen: (K,) what agents say while the target is hidden; None for a mode in which it is seen.
        constants: what the target is and stays.
        usual: (W,) shares of the ways in the long run; those of the chain where empty.
    """

    ways: tuple[str, ...]
    chain: Chain
    unseen: tuple[Hidden | None, ...]
    constants: tuple[Constant, ...] = ()
    usual: tuple[float, ...] = ()

    def __len__(self) -> int:
        return len(self.unseen)

    @cached_property
    def hidden(self) -> tuple[bool, ...]:
        """(K,) in which the target cannot be seen."""
        return tuple(hiding is not None for hiding in self.unseen)

    @property
    def can_hide(self) -> bool:
        """True if the target cannot be seen in one of them."""
        return any(self.hidden)

    @property
    def missed(self) -> float:
        """Probability that an agent that measures misses a target that can be seen; 0 where it always can."""
        return max((hiding.missed for hiding in self.unseen if hiding is not None), default=0.0)

    @property
    def lost_above(self) -> float:
        """Probability of being hidden above which the target counts as lost."""
        return min((hiding.lost_above for hiding in self.unseen if hiding is not None), default=1.0)

    @cached_property
    def index(self) -> dict[str, Ints]:
        """(K,) number of the way (`mode`), and of the value of each constant, of each mode."""
        shape = (len(self.ways), *(len(constant.values) for constant in self.constants))
        numbers = np.unravel_index(np.arange(len(self)), shape)
        names = (FIELD, *(constant.name for constant in self.constants))
        return {name: np.asarray(column, dtype=np.int64) for name, column in zip(names, numbers, strict=True)}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the modes, such as `walk`, with values `walk team=red`."""
        parts = [[self.ways[number] for number in self.index[FIELD]]]
        for constant in self.constants:
            parts.append(
                [mode_key(constant.name, constant.values[number]) for number in self.index[constant.name]]
            )
        return tuple(" ".join(filter(None, words)) for words in zip(*parts, strict=True))

    @cached_property
    def kinds(self) -> Ints:
        """(K,) number of the combination of values, whatever the way."""
        return np.arange(len(self)) % (len(self) // len(self.ways))

    def fields(self, numbers: Floats | Ints) -> dict[str, Floats]:
        """Names in expressions of hypotheses in modes of these numbers: `mode`, and each constant."""
        modes = numbers.astype(np.intp)
        return {name: values[modes].astype(np.float64) for name, values in self.index.items()}

    def long_run(self) -> Floats:
        """(K,) probabilities in the long run, constants as when the target starts."""
        shares = np.array(self.usual) if self.usual else self.chain.stationary()
        for constant in self.constants:
            shares = np.outer(shares, constant.prior).ravel()
        return np.asarray(shares)

    def start(self) -> Floats:
        """(K,) probabilities where the target starts: those of the long run, given that it is seen."""
        shares = np.where(self.hidden, 0.0, self.long_run())
        if shares.sum() <= 0.0:
            even = replace(self, usual=(1.0 / len(self.ways),) * len(self.ways))
            shares = np.where(self.hidden, 0.0, even.long_run())
        return np.asarray(shares / shares.sum())

    def named(self, probabilities: Floats) -> dict[str, float]:
        """Way -> its probability; empty where there are constants alone."""
        if self.ways == ("",):
            return {}
        shares = np.bincount(self.index[FIELD], probabilities, minlength=len(self.ways))
        return dict(zip(self.ways, shares.tolist(), strict=True))

    def values(self, probabilities: Floats) -> dict[str, float]:
        """`team=red` -> its probability, of each value of each constant."""
        marginals: dict[str, float] = {}
        for constant in self.constants:
            counted = np.bincount(self.index[constant.name], probabilities, minlength=len(constant.values))
            shares = (counted / max(float(counted.sum()), 1e-300)).tolist()
            marginals.update(
                zip((mode_key(constant.name, value) for value in constant.values), shares, strict=True)
            )
        return marginals

    def probability_hidden(self, probabilities: Floats) -> float:
        """Probability that it cannot be seen."""
        return float(min(probabilities[list(self.hidden)].sum(), 1.0))


@runtime_checkable
class Moded(Protocol):
    """A posterior that says how probable its modes are."""

    @property
    def mode_probabilities(self) -> Floats:
        """(K,) probabilities of the modes."""


def has_modes(posterior: Posterior) -> bool:
    """True of a belief in modes."""
    return isinstance(posterior, Moded) or posterior.fields[-1] == FIELD


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


def modes_of(root: InferenceNode) -> Modes | None:
    """The modes that a graph asks for at its root: by `modes` and by `category`; None without either."""
    if root.category is None:
        return None if root.modes is None else make_modes(root.modes)
    still = Modes(("",), Chain(((0.0,),), by_rates=True), (None,))
    ways = still if root.modes is None else make_modes(root.modes)
    constants = tuple(make_constant(name, category) for name, category in root.category.items())
    size = math.prod(len(constant.values) for constant in constants)
    matrix = np.kron(np.array(ways.chain.rows), np.eye(size))
    return Modes(
        ways.ways,
        Chain(tuple(tuple(row) for row in matrix.tolist()), ways.chain.by_rates),
        tuple(unseen for unseen in ways.unseen for _ in range(size)),
        constants,
        tuple(ways.chain.stationary().tolist()),
    )


def make_constant(name: str, category: Category) -> Constant:
    """A category that a graph asks for."""
    prior = category.prior or dict.fromkeys(category.values, 1.0)
    total = sum(prior.values())
    return Constant(name, category.values, tuple(prior[value] / total for value in category.values))


def make_modes(settings: Mapping[str, Mode]) -> Modes:
    """The modes of `modes`."""
    names = tuple(settings)
    by_rates = all(mode.next is None for mode in settings.values())
    rows = []
    for number, (name, mode) in enumerate(settings.items()):
        if mode.next is not None:
            rows.append(tuple(mode.next.get(following, 0.0) for following in names))
            continue
        assert mode.mean_frames is not None
        follow = mode.then or {following: 1.0 for following in names if following != name}
        total = sum(follow.values())
        rates = [follow.get(following, 0.0) / total / mode.mean_frames for following in names]
        rates[number] = -1.0 / mode.mean_frames
        rows.append(tuple(rates))
    return Modes(names, Chain(tuple(rows), by_rates), tuple(mode.hidden for mode in settings.values()))


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
        return all(getattr(part, "leaves_image", False) for part in self.parts)

    def each(self, change: Callable[[MotionModel], MotionModel]) -> Modal:
        """With every mode's motion changed; modes that shared one still do. Itself where nothing changes."""
        changed_parts: dict[int, MotionModel] = {}
        for part in self.parts:
            if id(part) not in changed_parts:
                changed_parts[id(part)] = change(part)
        parts = tuple(changed_parts[id(part)] for part in self.parts)
        same = all(part is original for part, original in zip(parts, self.parts, strict=True))
        return self if same else replace(self, parts=parts)

    def start(self, box: Floats, size: int, rng: np.random.Generator) -> Floats:
        """(size, D) states in the centre box (4,), in modes in which it is seen."""
        states = self._first.start(box, size, rng)
        if self.prior is not None:
            states = self.prior.applied_to(self._first.fields, states, box, rng)
        points = (rng.permutation(size) + rng.random(size)) / size
        return _with(states, draw_mode(np.tile(self.modes.start(), (size, 1)), points))

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
        previous = states if parents is None else states[parents]
        modes = previous[:, -1].astype(np.intp)
        if not self.settled:
            points = (rng.permutation(len(previous)) + rng.random(len(previous))) / len(previous)
            modes = draw_mode(self.chain.over(dt)[modes], points)
        inner_states = np.ascontiguousarray(previous[:, :-1])
        moved_states = np.empty_like(inner_states)
        for motion, rows in self._groups(modes):
            moved_states[rows] = motion.propagate(inner_states, dt, rng, rows)
        return _with(moved_states, modes)

    def drift(self, states: Floats, dt: float) -> Floats:
        """(N, D) states after `dt` frame intervals without noise, each in the mode that it is in."""
        inner_states = np.ascontiguousarray(states[:, :-1])
        moved_states = np.empty_like(inner_states)
        for motion, rows in self._groups(states[:, -1].astype(np.intp)):
            moved_states[rows] = motion.drift(inner_states[rows], dt)
        return _with(moved_states, states[:, -1])

    def linearise(self, state: Floats, dt: float) -> tuple[Floats, Floats]:
        """F and Q of the mode that the state is in; the mode stays."""
        transition, covariance = self.motions[int(state[-1])].linearise(state[:-1], dt)
        padded = np.pad(transition, (0, 1))
        padded[-1, -1] = 1.0
        return padded, np.pad(covariance, (0, 1))

    def log_density(self, states: Floats, previous: Floats, dt: float) -> Floats:
        """(M, N) log P(mode | mode before) + log p(states | previous) as the new mode moves."""
        modes, inner_states = states[:, -1].astype(np.intp), np.ascontiguousarray(previous[:, :-1])
        with np.errstate(divide="ignore"):
            log_chain = np.log(self.chain.over(dt))[previous[:, -1].astype(np.intp)]
        log_densities = np.empty((len(states), len(previous)))
        for number, motion in enumerate(self.motions):
            rows = np.flatnonzero(modes == number)
            if len(rows):
                log_density = motion.log_density(np.ascontiguousarray(states[rows, :-1]), inner_states, dt)
                log_densities[rows] = log_density + log_chain[:, number]
        return log_densities

    def transition(self, previous: Floats, dt: float) -> Transition:
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
        for number, motion in enumerate(self.motions):
            groups.setdefault(id(motion), []).append(number)
        moved_rows = []
        for numbers in groups.values():
            rows = np.flatnonzero(np.isin(modes, numbers))
            if len(rows):
                moved_rows.append((self.motions[numbers[0]], rows.astype(np.intp, copy=False)))
        return moved_rows


def draw_mode(probabilities: Floats, points: Floats) -> NDArray[np.intp]:
    """(N,) a mode for each row of probabilities (N, K), by points (N,) in 0..1."""
    cumulative = probabilities.cumsum(axis=1)[:, :-1]
    return np.asarray((points[:, None] >= cumulative).sum(axis=1), dtype=np.intp)


def _with(states: Floats, modes: NDArray[np.generic]) -> Floats:
    return np.concatenate([states, np.asarray(modes, dtype=np.float64)[:, None]], axis=1)
