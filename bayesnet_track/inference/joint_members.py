"""The hypotheses of targets that are near each other, and the pairs that are accounted for together."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.log_weights import DegenerateWeights, LogWeights
from bayesnet_track.numerics.records import evolve

Pair = tuple[str, str]

FARTHEST = 150.0
"""A log-likelihood further below the best counts as so far below it: their ratio has to stay a number."""

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
        return evolve(self, pair=self.pair[::-1], first_in_front=1.0 - self.first_in_front, factor=other)


@dataclass(frozen=True, eq=False)
class Crowd:
    """The S hypotheses of M targets below each other, and what is known of each.

    Attributes:
        names: target -> its number.
        starts: (M + 1,) where those of each target begin.
        boxes: (S, 4) centre boxes, px.
        prior: (S,) prior weights, and their logarithms.
        log_likelihood: (S,) log L.
        losses: (S,) by how much log L is below that of a perfect match.
        bad: (S,) share of each box that does not match.
        seen: (S,) prior weights times L, in units of the best hypothesis.
        by_place: (S,) order of a target's hypotheses along the axis on which they spread most.
        log_evidence: (M,) log of the sum of prior weights times L, in units of a perfect match.
        perfect: (M,) log L of a perfect match.
        worst: (M,) largest loss.
        best: (M,) smallest one.
        agents: (M,) number of agents.
    """

    names: Mapping[str, int]
    starts: Ints
    boxes: Floats
    prior: tuple[Floats, Floats]
    log_likelihood: Floats
    losses: Floats
    bad: Floats
    seen: Floats
    by_place: Ints
    log_evidence: Floats
    perfect: Floats
    worst: Floats
    best: Floats
    agents: Ints

    @classmethod
    def of(cls, members: Mapping[str, Member]) -> Crowd:
        """That of members.

        Raises:
            DegenerateWeights: no hypothesis of a target has a positive, finite weight.
        """
        from bayesnet_track.numerics.kernels.speaking_kernels import weigh_members

        several = list(members.values())
        starts = np.cumsum([0, *(len(one.boxes) for one in several)])
        prior, prior_log, log = (
            np.concatenate(arrays)
            for arrays in (
                [one.prior.weights for one in several],
                [one.prior.log for one in several],
                [one.log_likelihood for one in several],
            )
        )
        agents = np.array([one.agents for one in several], dtype=np.int64)
        tops = np.array([one.top for one in several], dtype=np.float64)
        (log, losses, bad, seen), (perfect, evidence, worst, best) = weigh_members(
            log, (prior, prior_log), starts, tops, agents, (FARTHEST, STEEP, HALF)
        )
        if not np.isfinite(evidence).all():
            raise DegenerateWeights("no hypothesis of a joined target has a positive, finite weight")
        names = {name: number for number, name in enumerate(members)}
        boxes = np.concatenate([one.boxes for one in several])
        each = (boxes, (prior, prior_log), log, losses, bad, seen, _by_place(boxes, starts))
        return cls(names, starts, *each, evidence, perfect, worst, best, agents)

    def hidden(self, members: Mapping[str, Member], pairs: Sequence[Pair]) -> Floats:
        """(K, 5) what stands for pixels of the first of each pair that the second hides.

        The shares that do not match: of hidden pixels, of a box of it on the second, of the worst hypothesis
        and of the best; then its number of agents.
        """
        level = np.array([one.level for one in members.values()])
        losses = np.concatenate([np.maximum(self.perfect - level, 0.0), self.worst, self.best])
        level, worst, best = bad_shares(losses, np.tile(self.agents, 3)).reshape(3, -1)
        own = np.array([self.names[first] for first, _ in pairs], dtype=np.intp)
        said = [members[first].on.get(second, np.nan) for first, second in pairs]
        away = np.minimum(np.maximum(self.perfect[own] - said, self.best[own]), self.worst[own])
        on = bad_shares(np.where(np.isnan(said), self.best[own], away), self.agents[own])
        return np.column_stack([level[own], on, worst[own], best[own], self.agents[own]])


def _by_place(boxes: Floats, starts: Ints) -> Ints:
    """(S,) the order of each target's hypotheses; as arrays where all have as many."""
    sizes = np.diff(starts)
    if (sizes == sizes[0]).all():
        centres = boxes[:, :2].reshape(len(sizes), sizes[0], 2)
        axes = np.argmax(centres.max(axis=1) - centres.min(axis=1), axis=1)
        return np.argsort(centres[np.arange(len(sizes)), :, axes], axis=1, kind="stable").ravel()
    pieces = [boxes[first:last] for first, last in pairwise(starts)]
    return np.concatenate([_by_place(own, np.array([0, len(own)])) for own in pieces])


def bad_shares(losses: Floats, agents: int | Ints) -> Floats:
    """(N,) share of a box that does not match, where `agents` say that log L is `losses` below the best."""
    with np.errstate(divide="ignore"):
        log = np.log(np.expm1(losses / agents) + np.exp(losses / agents - STEEP))
    return np.asarray(np.clip((log + STEEP) / (STEEP / HALF), 0.0, None))
