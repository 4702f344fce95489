"""Joint beliefs of targets that are near each other: exact on a tree up to sampling, O(N) per pair.

Of targets a and b, and of the order o (who is in front), the joint posterior of hypotheses i and j is

    p(i, j, o) ~ beta_i beta_j p(o) e^(-nats c) L_i(h_i) L_j(h_j)

with prior weights beta and the overlap c as a share of the smaller box. h is the hidden share of a box: 0
for the one in front, and for the one behind what lies under the one in front, so that no pixel counts for
both. Log-likelihoods do not add up over parts of a box, shares of it that do not match do. With the share
s(L) at which a box loses as much as one of likelihood L has lost,

    K log [(1 + e^(16 s - 4)) / (1 + e^-4)] = log L_top - log L       (K agents; thesis eq. 3.3, corrected)

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
from dataclasses import dataclass, field
from itertools import groupby, pairwise

import numpy as np
from numpy.typing import NDArray

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
        turned_factor = None if factor is None else lambda first, second: factor(second, first)
        return evolve(
            self, pair=self.pair[::-1], first_in_front=1.0 - self.first_in_front, factor=turned_factor
        )


@dataclass(frozen=True, eq=False)
class JointHypotheses:
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
    def of(cls, members: Mapping[str, Member]) -> JointHypotheses:
        """The crowd of the members.

        Raises:
            DegenerateWeights: no hypothesis of a target has a positive, finite weight.
        """
        from bayesnet_track.numerics.kernels.speaking_kernels import weigh_members

        ordered = list(members.values())
        starts = np.cumsum([0, *(len(member.boxes) for member in ordered)])
        prior, prior_log, log = (
            np.concatenate(arrays)
            for arrays in (
                [member.prior.weights for member in ordered],
                [member.prior.log for member in ordered],
                [member.log_likelihood for member in ordered],
            )
        )
        agents = np.array([member.agents for member in ordered], dtype=np.int64)
        tops = np.array([member.top for member in ordered], dtype=np.float64)
        (log, losses, bad, visible), (perfect, evidence, worst, highest) = weigh_members(
            log, (prior, prior_log), starts, tops, agents, (FARTHEST, STEEP, HALF)
        )
        if not np.isfinite(evidence).all():
            raise DegenerateWeights("no hypothesis of a joined target has a positive, finite weight")
        names = {name: number for number, name in enumerate(members)}
        boxes = np.concatenate([member.boxes for member in ordered])
        each = (boxes, (prior, prior_log), log, losses, bad, visible, _by_place(boxes, starts))
        return cls(names, starts, *each, evidence, perfect, worst, highest, agents)

    def hidden(self, members: Mapping[str, Member], pairs: Sequence[Pair]) -> Floats:
        """(K, 5) what stands for pixels of the first of each pair that the second hides.

        The shares that do not match: of hidden pixels, of a box of it on the second, of the worst hypothesis
        and of the best; then its number of agents.
        """
        level = np.array([member.level for member in members.values()])
        losses = np.concatenate([np.maximum(self.perfect - level, 0.0), self.worst, self.best])
        level, worst, highest = bad_shares(losses, np.tile(self.agents, 3)).reshape(3, -1)
        firsts = np.array([self.names[first] for first, _ in pairs], dtype=np.intp)
        overlaid = [members[first].on.get(second, np.nan) for first, second in pairs]
        losses_on = np.minimum(
            np.maximum(self.perfect[firsts] - overlaid, self.best[firsts]), self.worst[firsts]
        )
        on_second = bad_shares(
            np.where(np.isnan(overlaid), self.best[firsts], losses_on), self.agents[firsts]
        )
        return np.column_stack(
            [level[firsts], on_second, worst[firsts], highest[firsts], self.agents[firsts]]
        )


def _by_place(boxes: Floats, starts: Ints) -> Ints:
    """(S,) the order of each target's hypotheses; as arrays where all have as many."""
    sizes = np.diff(starts)
    if (sizes == sizes[0]).all():
        centres = boxes[:, :2].reshape(len(sizes), sizes[0], 2)
        axes = np.argmax(centres.max(axis=1) - centres.min(axis=1), axis=1)
        return np.argsort(centres[np.arange(len(sizes)), :, axes], axis=1, kind="stable").ravel()
    pieces = [boxes[first:end] for first, end in pairwise(starts)]
    return np.concatenate([_by_place(piece, np.array([0, len(piece)])) for piece in pieces])


def bad_shares(losses: Floats, agents: int | Ints) -> Floats:
    """(N,) share of a box that does not match, where `agents` say that log L is `losses` below the best."""
    with np.errstate(divide="ignore"):
        log = np.log(np.expm1(losses / agents) + np.exp(losses / agents - STEEP))
    return np.asarray(np.clip((log + STEEP) / (STEEP / HALF), 0.0, None))


Keys = Callable[[Sequence[Pair]], NDArray[np.uint64]]
"""(Who speaks, who hears) of K pairs -> (K, 2) keys of the generators of their partners."""

MOST_LOG = 700.0
"""Densities of pairs are numbers up to e^700."""
COMMON_LOG = 50.0
"""A largest density beyond e^±50 is divided out, so that products of several messages stay numbers."""


@dataclass(frozen=True, eq=False)
class PairBatch:
    """Pairs of targets between which messages pass: two for each edge, one in either direction.

    Attributes:
        pairs: speaker and hearer of each of the K.
        edges: edge of each, the hearer first.
        ends: (K,) numbers of the speakers, and of the hearers.
        at: (K,) where what is said begins: a column for each of the hearer's hypotheses.
        columns: how many there are.
        heard: target -> the pairs in which it hears.
        before: of each pair the pairs that say what its speaker has to know.
        order: the pairs, each after those.
    """

    pairs: Sequence[Pair]
    edges: Sequence[Edge]
    ends: tuple[Ints, Ints]
    at: Ints
    columns: int
    heard: Mapping[str, Sequence[int]]
    before: Sequence[Sequence[int]]
    order: Sequence[int]

    @classmethod
    def along(
        cls,
        crowd: JointHypotheses,
        edges: Sequence[Edge],
        closing: Sequence[Edge],
        parents: Mapping[str, str | None],
    ) -> PairBatch:
        """The batch of a forest, by the `parents` of its targets, after children, and of edges closing rings.

        Along these a target says what it believes by itself, and no more.
        """
        all_edges = [*closing, *edges]
        pairs = [pair for edge in all_edges for pair in (edge.pair[::-1], edge.pair)]
        number = {pair: k for k, pair in enumerate(pairs)}
        to_hearer: dict[str, list[int]] = {name: [] for name in crowd.names}
        for k, (_, hearer) in enumerate(pairs):
            to_hearer[hearer].append(k)
        closing_count = 2 * len(closing)
        earlier = [
            [message for message in to_hearer[speaker] if k >= closing_count and pairs[message][0] != hearer]
            for k, (speaker, hearer) in enumerate(pairs)
        ]
        downwards = [(parent, name) for name, parent in parents.items() if parent is not None]
        order = [
            *range(closing_count),
            *(number[edge_or_pair[::-1]] for edge_or_pair in reversed(downwards)),
            *(number[link] for link in downwards),
        ]
        speakers, hearers = (
            np.array([crowd.names[pair[end]] for pair in pairs], dtype=np.int64) for end in (0, 1)
        )
        begins = np.cumsum([0, *np.diff(crowd.starts)[hearers].tolist()])
        directed = [directed_edge for edge in all_edges for directed_edge in (edge, edge.turned)]
        return cls(
            pairs, directed, (speakers, hearers), begins[:-1], int(begins[-1]), to_hearer, earlier, order
        )


def pass_messages(
    crowd: JointHypotheses, members: Mapping[str, Member], batch: PairBatch, keys: Keys
) -> Floats:
    """Messages of all pairs, (4, ...), each in units of its own evidence.

    In front; behind but not touched; behind and partly hidden; and the last times the share.
    """
    from bayesnet_track.numerics.kernels.speaking_kernels import ask_partners, speak

    messages = np.zeros((4, batch.columns))
    if not batch.pairs:
        return messages
    columns = (crowd.boxes, crowd.losses, crowd.bad, crowd.seen, *crowd.prior, crowd.by_place)
    pairs, incoming = (*batch.ends, batch.at), ragged(batch.before)
    draws = _draw(crowd, batch, keys)
    rules = (
        crowd.hidden(members, batch.pairs),
        crowd.hidden(members, [pair[::-1] for pair in batch.pairs]),
        np.array([(edge.first_in_front, edge.nats) for edge in batch.edges]),
    )
    context = columns, crowd.starts, crowd.log_evidence, pairs, incoming, draws
    for is_plain, some in groupby(batch.order, key=lambda k: batch.edges[k].factor is None):
        if is_plain:
            speak(np.array([*some]), *context, rules, messages)
            continue
        for k in some:
            partners, log_importance, free, blocked = ask_partners(k, *context, messages)
            (speaker, hearer), factor = batch.pairs[k], batch.edges[k].factor
            assert factor is not None
            rows = slice(crowd.starts[batch.ends[0][k]], crowd.starts[batch.ends[0][k] + 1])
            weight = np.exp(log_importance - crowd.losses[rows]) * (free + blocked)
            ends = members[hearer].states, members[speaker].states
            ratio = related(*ends, factor, partners, weight)
            messages[0, batch.at[k] : batch.at[k] + len(ratio)] = ratio
    return messages


def ragged(lists: Sequence[Sequence[int]]) -> tuple[Ints, Ints]:
    """Numbers of several lists below each other: where each list begins, and all of them."""
    starts = np.cumsum([0, *map(len, lists)])
    return starts, np.array([number for numbers in lists for number in numbers], dtype=np.int64)


def _draw(crowd: JointHypotheses, batch: PairBatch, keys: Keys) -> tuple[Floats, Ints, Ints, Ints]:
    """Random numbers of all partners: shifts, turns, where those of a pair begin, how many each has.

    In each round of a pair every hypothesis of the hearer has one partner from every stratum of as many:
    shifts say where in its stratum each partner is, turns for which hypothesis.
    """
    from bayesnet_track.numerics.streams import shuffled_of_each

    rounds = np.array([edge.pairings for edge in batch.edges], dtype=np.int64)
    begins = np.cumsum([0, *(rounds * np.diff(crowd.starts)[batch.ends[1]]).tolist()])
    return *shuffled_of_each(keys(batch.pairs), begins, rounds), begins[:-1], rounds


def related(
    hearer: Mapping[str, Floats],
    speaker: Mapping[str, Floats],
    factor: Factor,
    partners: Ints,
    weight: Floats,
) -> Floats:
    """(N,) mean over partners of their weight times the pair's factor; without it where it is 0 for all.

    Of a factor that is tiny or huge it is the mean but for a constant, which all hypotheses share.
    """
    hearer_states = {name: values[None] for name, values in hearer.items()}
    log = np.minimum(
        factor(hearer_states, {name: values[partners] for name, values in speaker.items()}), MOST_LOG
    )
    top = float(log.max())
    if top == -np.inf:
        density = np.ones(partners.shape)
    else:
        density = np.exp(log - top if abs(top) > COMMON_LOG else log)
    return np.asarray((weight[partners] * density).mean(axis=0))


@dataclass(frozen=True, eq=False)
class Marginal:
    """Marginal of the joint belief for one target.

    Attributes:
        log_likelihood: (N,) log of what its own evidence and the other targets say together: the prior
            weights times it are its marginal. Without an edge it is its own.
        hidden: other -> expected share of its box that this one hides.
    """

    log_likelihood: Floats
    hidden: Mapping[str, float]


def joint_marginals(
    members: Mapping[str, Member], edges: Sequence[Edge], keys: Keys, closing: Sequence[Edge] = ()
) -> tuple[dict[str, Marginal], dict[Pair, float]]:
    """The marginals of all members, and of each edge the probability that its first target is in front.

    Args:
        members: target -> its hypotheses.
        edges: a forest over the targets.
        keys: (who speaks, who hears) of each pair -> keys of the generators of the partners.
        closing: edges that close rings. Along them each target says what it believes by itself, and no more.

    Raises:
        ValueError: the edges close a ring.
    """
    from bayesnet_track.numerics.kernels.speaking_kernels import conclude

    parents = _root_tree(_near(members, edges))
    if not members:
        return {}, {}
    crowd = JointHypotheses.of(members)
    batch = PairBatch.along(crowd, edges, closing, parents)
    messages = pass_messages(crowd, members, batch, keys)
    incoming = [batch.heard[name] for name in members]
    log, hides, fronts = conclude(
        crowd.log_likelihood, crowd.seen, crowd.starts, batch.at, ragged(incoming), messages
    )
    marginals = {
        name: Marginal(
            log[crowd.starts[m] : crowd.starts[m + 1]],
            {batch.pairs[k][0]: float(hides[k]) for k in incoming[m]},
        )
        for m, name in enumerate(members)
    }
    orders = {
        edge.pair: edge.first_in_front if edge.factor is not None else float(front + 1.0 - back) / 2
        for edge, front, back in zip(batch.edges[::2], fronts[::2], fronts[1::2], strict=True)
    }
    return marginals, orders


def _near(members: Iterable[str], edges: Iterable[Edge]) -> dict[str, dict[str, Edge]]:
    neighbours: dict[str, dict[str, Edge]] = {name: {} for name in members}
    for edge in edges:
        first, second = edge.pair
        neighbours[first][second] = neighbours[second][first] = edge
    return neighbours


def _root_tree(neighbours: Mapping[str, Mapping[str, Edge]]) -> dict[str, str | None]:
    """All targets, parents before children, and each one's parent."""
    parents: dict[str, str | None] = {}
    for root in neighbours:
        if root in parents:
            continue
        parents[root] = None
        waiting = [root]
        while waiting:
            name = waiting.pop()
            for neighbour in neighbours[name]:
                if neighbour == parents[name]:
                    continue
                if neighbour in parents:
                    raise ValueError(f"targets {name} and {neighbour} close a ring of joins")
                parents[neighbour] = name
                waiting.append(neighbour)
    return parents
