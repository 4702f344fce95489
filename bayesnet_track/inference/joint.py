"""Joint beliefs of targets that are near each other: exact on a tree up to sampling, O(N) per pair.

Of targets a and b, and of the order o (who is in front), the joint posterior of hypotheses i and j is

    p(i, j, o) ~ beta_i beta_j p(o) e^(-nats c) L_i(h_i) L_j(h_j)

with prior weights beta and the overlap c as a share of the smaller box. h is the hidden share of a box: 0
for the one in front, and for the one behind what lies under the one in front, so that no pixel counts for
both. Log-likelihoods do not add up over parts of a box, shares of it that do not match do. With the share
s(L) at which a box loses as much as one of likelihood L has lost,

    K log (1 + e^(16 s - 4)) / (1 + e^-4) = log L_top - log L         (K agents; thesis eq. 3.3, corrected)

what is left of a box behind, without the pixels of the one in front, is

    s(h) = s(L) - h s(W), kept within (1 - h) s(best) .. (1 - h) s(worst),    + h s(l)

W is the target's likelihood of a box wholly on the one in front, and l the level that stands for what cannot
be seen: half way between its best and worst hypotheses, so that to be hidden is better than to match badly
and worse than to match well. Of several targets each is hidden by one other at most, so that no share of a
box is taken out twice. L_top is that of a target that is seen, so that one of which nothing is to be seen is
not taken for one that matches. Targets that a factor f relates share no pixels:

    p(i, j) ~ beta_i beta_j L_i L_j f(i, j)

The sum over j is an average over a few partners of each i, drawn by a mixture of j's own posterior and prior,
one from every stratum of it: no table of all pairs is made. Targets that hang together form a tree; messages
go up and down once. Along pairs that would close a ring each is told what the other believes by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.log_weights import LogWeights

Floats = NDArray[np.float64]
Pair = tuple[str, str]
Hidden = tuple[float, float, float, float, int]

STEEP, HALF = 4.0, 0.25
"""Log-odds at the best hypothesis, and share of a box whose misfit halves an agent's likelihood."""

LEAST_LOG = -700.0
"""Densities of pairs are numbers up to e^700."""

FARTHEST = 150.0
"""A log-likelihood further below the best counts as so far below it: their ratio has to stay a number."""


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

    def hidden_by(self, other: str) -> Hidden:
        """Shares that do not match: what stands for hidden pixels, W, the worst's and the best's; agents."""
        worst, best = float(self.losses.max()), float(self.losses.min())
        occluder = min(max(self._perfect - self.on.get(other, self._perfect), best), worst)
        losses = np.array([max(self._perfect - self.level, 0.0), occluder, worst, best])
        level, occluder, worst, best = bad_shares(losses, self.agents).tolist()
        return level, occluder, worst, best, self.agents

    @property
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
        return replace(self, pair=self.pair[::-1], first_in_front=1.0 - self.first_in_front, factor=other)


@dataclass(frozen=True, eq=False)
class Marginal:
    """What the joint belief says of one target.

    Attributes:
        log_likelihood: (N,) log of what its own evidence and the other targets say together: the prior
            weights times it are its marginal. Without an edge it is its own.
        hidden: other -> expected share of its box that this one hides.
    """

    log_likelihood: Floats
    hidden: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class _Message:
    """What one target says of another's hypotheses: (N,) each."""

    in_front: Floats
    untouched: Floats
    hidden: Floats
    share: Floats

    @property
    def free(self) -> Floats:
        """Where it hides nothing of them."""
        return self.in_front + self.untouched


@dataclass(frozen=True, eq=False)
class _Said:
    """What several targets say together: where none hides, where one does, and that one's shares."""

    free: Floats
    taken: Floats
    shares: Mapping[str, Floats]

    @property
    def all(self) -> Floats:
        """Either way."""
        return self.free + self.taken


def joint_marginals(
    members: Mapping[str, Member],
    edges: Sequence[Edge],
    stream: Callable[[str, str], np.random.Generator],
    closing: Sequence[Edge] = (),
) -> tuple[dict[str, Marginal], dict[Pair, float]]:
    """The marginals of all members, and of each edge the probability that its first target is in front.

    Args:
        members: target -> its hypotheses.
        edges: a forest over the targets.
        stream: (who speaks, who hears) -> generator of the partners.
        closing: edges that close rings. Along them each target says what it believes by itself, and no more.

    Raises:
        ValueError: the edges close a ring.
    """
    members = {name: _bound(one) for name, one in members.items()}
    near = _near(members, edges)
    order, above = _root_tree(near)
    around = _near(members, (*closing, *edges))
    messages: dict[Pair, _Message] = {}

    def say(speaker: str, hearer: str, others: Sequence[str]) -> None:
        said = _together(members[speaker], others, speaker, messages)
        edge = around[speaker][hearer]
        if edge.pair[0] != hearer:
            edge = edge.turned
        messages[speaker, hearer] = _message(
            members[speaker],
            members[hearer],
            (members[speaker].hidden_by(hearer), members[hearer].hidden_by(speaker)),
            said,
            edge,
            stream(speaker, hearer),
        )

    for first, second in (edge.pair for edge in closing):
        say(first, second, ())
        say(second, first, ())
    upward = [(name, above[name]) for name in reversed(order)]
    downward = [(above[name], name) for name in order]
    for speaker, hearer in (*upward, *downward):
        if speaker is not None and hearer is not None:
            say(speaker, hearer, [name for name in around[speaker] if name != hearer])
    marginals = {
        name: _marginal(one, _together(one, list(around[name]), name, messages))
        for name, one in members.items()
    }
    return marginals, {edge.pair: _order(edge, members, around, messages) for edge in (*edges, *closing)}


def bad_shares(losses: Floats, agents: int) -> Floats:
    """(N,) share of a box that does not match, where `agents` say that log L is `losses` below the best."""
    with np.errstate(divide="ignore"):
        log = np.log(np.expm1(losses / agents) + np.exp(losses / agents - STEEP))
    return np.asarray(np.clip((log + STEEP) / (STEEP / HALF), 0.0, None))


def draw_partners(
    boxes: Floats, shares: Floats, size: int, pairings: int, rng: np.random.Generator
) -> NDArray[np.intp]:
    """(pairings, size) indices of hypotheses (M, 4), each column one from every stratum of the `shares` (M,).

    The strata cut the hypotheses, sorted along the axis on which they spread most, into parts of equal share.
    """
    axis = int(np.argmax(boxes[:, :2].max(axis=0) - boxes[:, :2].min(axis=0)))
    by_place = np.argsort(boxes[:, axis], kind="stable")
    bounds = np.cumsum(shares[by_place])
    total = pairings * size
    points = (np.arange(total) + rng.random(total)) * (bounds[-1] / total)
    chosen = by_place[np.minimum(np.searchsorted(bounds, points, side="right"), len(shares) - 1)]
    return np.asarray(rng.permuted(chosen.reshape(pairings, size), axis=1))


def _bound(one: Member) -> Member:
    best = one.log_likelihood.max()
    return replace(one, log_likelihood=np.maximum(one.log_likelihood, best - FARTHEST))


def _near(members: Iterable[str], edges: Iterable[Edge]) -> dict[str, dict[str, Edge]]:
    near: dict[str, dict[str, Edge]] = {name: {} for name in members}
    for edge in edges:
        first, second = edge.pair
        near[first][second] = near[second][first] = edge
    return near


def _root_tree(near: Mapping[str, Mapping[str, Edge]]) -> tuple[list[str], dict[str, str | None]]:
    """All targets, parents before children, and each one's parent."""
    order: list[str] = []
    above: dict[str, str | None] = {}
    for root in near:
        if root in above:
            continue
        above[root] = None
        waiting = [root]
        while waiting:
            name = waiting.pop()
            order.append(name)
            for other in near[name]:
                if other == above[name]:
                    continue
                if other in above:
                    raise ValueError(f"targets {name} and {other} close a ring of joins")
                above[other] = name
                waiting.append(other)
    return order, above


def _together(one: Member, speakers: Sequence[str], hearer: str, messages: Mapping[Pair, _Message]) -> _Said:
    """The product of what `speakers` say of one target, of which at most one may hide it."""
    size = len(one.boxes)
    free, taken = np.ones(size), np.zeros(size)
    shares: dict[str, Floats] = {}
    for speaker in speakers:
        said = messages[speaker, hearer]
        shares = {name: known * said.free for name, known in shares.items()}
        shares[speaker] = free * said.share
        free, taken = free * said.free, taken * said.free + free * said.hidden
    return _Said(free, taken, shares)


def _message(
    speaker: Member,
    hearer: Member,
    hidden: tuple[Hidden, Hidden],
    said: _Said,
    edge: Edge,
    rng: np.random.Generator,
) -> _Message:
    """What pairs with `speaker` say of the hypotheses of `hearer`, in units of the speaker's evidence.

    The first of the `edge` is the hearer.
    """
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.kernels.joint_kernels import pair_sums

    prior = speaker.prior.weights
    belief = prior * np.exp(speaker.log_likelihood - speaker.log_likelihood.max()) * said.all
    shares = 0.5 * (prior + belief / belief.sum())
    partners = draw_partners(speaker.boxes, shares, len(hearer.boxes), edge.pairings, rng)
    _, evidence = LogWeights.normalise(speaker.prior.log - speaker.losses)
    with np.errstate(divide="ignore"):
        log_importance = speaker.prior.log - np.log(shares) - evidence
    if edge.factor is not None:
        weight = np.exp(log_importance - speaker.losses) * said.all
        return _related(hearer.states, speaker.states, edge.factor, partners, weight)
    return _Message(
        *pair_sums(
            np.ascontiguousarray(hearer.boxes),
            hearer.losses,
            hearer.bad,
            hidden[1],
            np.ascontiguousarray(speaker.boxes),
            speaker.losses,
            speaker.bad,
            hidden[0],
            partners,
            log_importance,
            said.free,
            said.taken,
            edge.first_in_front,
            edge.nats,
        )
    )


def _related(
    hearer: Mapping[str, Floats],
    speaker: Mapping[str, Floats],
    factor: Factor,
    partners: NDArray[np.intp],
    weight: Floats,
) -> _Message:
    """The mean over partners of their weight times the pair's factor; without it where it is 0 for all."""
    own = {name: values[None] for name, values in hearer.items()}
    log = factor(own, {name: values[partners] for name, values in speaker.items()})
    density = np.exp(np.clip(log, None, -LEAST_LOG))
    if not density.any():
        density = np.ones(partners.shape)
    nothing = np.zeros(partners.shape[1])
    return _Message((weight[partners] * density).mean(axis=0), nothing, nothing, nothing)


def _marginal(one: Member, said: _Said) -> Marginal:
    with np.errstate(divide="ignore"):
        log = one.log_likelihood + np.log(said.all)
    weights = one.prior.weights * np.exp(one.log_likelihood - one.log_likelihood.max())
    total = float(weights @ said.all)
    hidden = {
        name: float(weights @ share) / total if total > 0 else 0.0 for name, share in said.shares.items()
    }
    return Marginal(log, hidden)


def _order(
    edge: Edge,
    members: Mapping[str, Member],
    near: Mapping[str, Mapping[str, Edge]],
    messages: Mapping[Pair, _Message],
) -> float:
    """P(first in front | all evidence): the mean of what both ends say, each an average over its partners."""
    if edge.factor is not None:
        return edge.first_in_front
    found = []
    for own, other in (edge.pair, edge.pair[::-1]):
        one, message = members[own], messages[other, own]
        rest = _together(one, [name for name in near[own] if name != other], own, messages)
        weights = one.prior.weights * np.exp(one.log_likelihood - one.log_likelihood.max())
        front = float(weights @ (rest.all * message.in_front))
        behind = float(weights @ (rest.all * message.untouched + rest.free * message.hidden))
        total = front + behind
        share = front / total if total > 0 else 0.5
        found.append(share if own == edge.pair[0] else 1.0 - share)
    return sum(found) / 2
