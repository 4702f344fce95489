"""The hypotheses of targets that are near each other, and the pairs that are accounted for together."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.numerics.records import changed

Pair = tuple[str, str]
Hidden = tuple[float, float, float, float, int]

STEEP, HALF = 4.0, 0.25
"""Log-odds at the best hypothesis, and share of a box whose misfit halves an agent's likelihood."""


@dataclass(frozen=True, eq=False)
class Member:
    """One target's hypotheses.

    Attributes:
        boxes: (N, 4) centre boxes, px.
        prior: their N weights before the evidence.
        log_likelihood: (N,) log L, one of them finite at least.
        level: log of what stands for its evidence where it is hidden.
        on: other -> log L of a box of this target's that lies wholly on the other; that of its best
            hypothesis for one that is not named.
        agents: number of agents that the likelihood is a product of.
        top: log L of a perfect match; that of the best hypothesis where it is higher.
        states: field -> (N,) values, which factors of pairs read.
    """

    boxes: Floats
    prior: LogWeights
    log_likelihood: Floats
    level: float
    on: Mapping[str, float] = field(default_factory=dict)
    agents: int = 1
    top: float = -np.inf
    states: Mapping[str, Floats] = field(default_factory=dict)

    @cached_property
    def losses(self) -> Floats:
        """(N,) by how much log L is below that of a perfect match."""
        return np.asarray(self._perfect - self.log_likelihood)

    @cached_property
    def bad(self) -> Floats:
        """(N,) share of each box that does not match."""
        return bad_shares(self.losses, self.agents)

    @cached_property
    def seen(self) -> Floats:
        """(N,) prior weights times L, in units of the best hypothesis."""
        return np.asarray(self.prior.weights * np.exp(self.log_likelihood - self.log_likelihood.max()))

    @cached_property
    def log_evidence(self) -> float:
        """Log of the sum of prior weights times L, in units of a perfect match."""
        return LogWeights.normalise(self.prior.log - self.losses)[1]

    @cached_property
    def by_place(self) -> NDArray[np.intp]:
        """(N,) order along the axis on which the hypotheses spread most."""
        centres = self.boxes[:, :2]
        axis = int(np.argmax(centres.max(axis=0) - centres.min(axis=0)))
        return np.argsort(centres[:, axis], kind="stable")

    def hidden_by(self, other: str) -> Hidden:
        """Shares that do not match: what stands for hidden pixels, W, the worst's and the best's; agents."""
        level, worst, best, shares = self._hidden
        return level, shares.get(other, best), worst, best, self.agents

    @cached_property
    def _hidden(self) -> tuple[float, float, float, dict[str, float]]:
        worst, best = float(self.losses.max()), float(self.losses.min())
        occluders = [min(max(self._perfect - log, best), worst) for log in self.on.values()]
        losses = np.array([max(self._perfect - self.level, 0.0), worst, best, *occluders])
        level, worst, best, *found = bad_shares(losses, self.agents).tolist()
        return level, worst, best, dict(zip(self.on, found, strict=True))

    @cached_property
    def _perfect(self) -> float:
        return max(self.top, float(self.log_likelihood.max()))


Factor = Callable[[Mapping[str, Floats], Mapping[str, Floats]], Floats]
"""States of the first and of the second target, field by field -> log density of each pair."""


@dataclass(frozen=True)
class Edge:
    """A pair of targets whose pixels are accounted for together, or which a factor relates.

    Attributes:
        pair: the two.
        first_in_front: prior probability that the first is in front.
        nats: log-odds against one box wholly on the other.
        pairings: partners of each hypothesis.
        factor: what relates them instead of pixels.
    """

    pair: Pair
    first_in_front: float
    nats: float = 0.0
    pairings: int = 8
    factor: Factor | None = None

    @property
    def turned(self) -> Edge:
        """The same edge, seen from its second target."""
        factor = self.factor
        other = None if factor is None else lambda first, second: factor(second, first)
        return changed(self, pair=self.pair[::-1], first_in_front=1.0 - self.first_in_front, factor=other)


def weigh_all(members: Iterable[Member]) -> None:
    """Find what members know of their hypotheses, at once where they have as many, to the same bits."""
    alike: dict[int, list[Member]] = {}
    for one in members:
        alike.setdefault(len(one.boxes), []).append(one)
    for several in alike.values():
        _weigh(several)


def _weigh(members: Sequence[Member]) -> None:
    """Fill in the properties of members with the same number of hypotheses."""
    log = np.array([one.log_likelihood for one in members])
    best = log.max(axis=1)
    perfect = np.maximum(best, [one.top for one in members])
    losses = perfect[:, None] - log
    bad = bad_shares(losses, np.array([one.agents for one in members])[:, None])
    seen = np.array([one.prior.weights for one in members]) * np.exp(log - best[:, None])
    weighed = np.array([one.prior.log for one in members]) - losses
    top = weighed.max(axis=1)
    if not np.isfinite(top).all():
        return  # the one it is of will say so
    evidence = top + np.log(np.exp(weighed - top[:, None]).sum(axis=1))
    centres = np.array([one.boxes[:, :2] for one in members])
    axes = np.argmax(centres.max(axis=1) - centres.min(axis=1), axis=1)
    order = np.argsort(centres[np.arange(len(members)), :, axes], axis=1, kind="stable")
    for k, one in enumerate(members):
        one.__dict__.update(
            losses=losses[k],
            bad=bad[k],
            seen=seen[k],
            log_evidence=float(evidence[k]),
            by_place=order[k],
            _perfect=float(perfect[k]),
        )


def bad_shares(losses: Floats, agents: int | Ints) -> Floats:
    """(N,) share of a box that does not match, where `agents` say that log L is `losses` below the best."""
    with np.errstate(divide="ignore"):
        log = np.log(np.expm1(losses / agents) + np.exp(losses / agents - STEEP))
    return np.asarray(np.clip((log + STEEP) / (STEEP / HALF), 0.0, None))
