"""The modes of a target: their names, how they follow each other, and what is seen in each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np

from bayesnet_track.belief.contract import Posterior
from bayesnet_track.graph.settings.modes import Hidden, Mode
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.mixtures import Chain

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
        """Whether the target cannot be seen in one of them."""
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
