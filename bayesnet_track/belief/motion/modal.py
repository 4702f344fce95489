"""Motion in modes: each hypothesis moves as its mode does, and the mode is a column of the state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import Ancestors, MotionModel
from bayesnet_track.belief.modes import FIELD, Modes
from bayesnet_track.belief.motion.forgetting import complete
from bayesnet_track.belief.motion.noise import Transition
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.mixtures import Chain


@dataclass(frozen=True, eq=False)
class Modal:
    """A motion model (`belief.contract.MotionModel`) whose last field is the number of the mode.

    The mode is drawn first, from the one before, then the state is moved as the new mode says.

    Attributes:
        modes: the modes.
        parts: how the target moves in each; they may have different fields.
        settled: the modes of the states that are moved are those after the move already.
    """

    modes: Modes
    parts: tuple[MotionModel, ...]
    settled: bool = False

    @cached_property
    def motions(self) -> tuple[MotionModel, ...]:
        """How it moves in each mode, all with the same fields, without the mode."""
        return complete(self.parts)

    @property
    def fields(self) -> tuple[str, ...]:
        """Those of the motions, and the mode."""
        return (*self.motions[0].fields, FIELD)

    @property
    def chain(self) -> Chain:
        """How modes follow each other."""
        return self.modes.chain

    def each(self, change: Callable[[MotionModel], MotionModel]) -> Modal:
        """With every mode's motion changed; modes that shared one still do."""
        made: dict[int, MotionModel] = {}
        for one in self.parts:
            if id(one) not in made:
                made[id(one)] = change(one)
        return replace(self, parts=tuple(made[id(one)] for one in self.parts))

    def start(self, box: Floats, size: int, rng: np.random.Generator) -> Floats:
        """(size, D) states in the centre box (4,), in modes in which it is seen."""
        states = self._longest.start(box, size, rng)
        points = (rng.permutation(size) + rng.random(size)) / size
        return _with(states, draw(np.tile(self.modes.start(), (size, 1)), points))

    def start_moments(self, box: Floats) -> tuple[Floats, Floats]:
        """(D - 1,) mean and covariance without the mode."""
        return self._longest.start_moments(box)

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
    def _longest(self) -> MotionModel:
        return max(self.parts, key=lambda one: len(one.fields))

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
