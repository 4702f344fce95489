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
from dataclasses import dataclass

import numpy as np

from bayesnet_track.inference.joint_members import Edge, Member, Pair, weigh_all
from bayesnet_track.inference.joint_messages import Message, Question, answer, shares_hidden, together
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.records import changed

FARTHEST = 150.0
"""A log-likelihood further below the best counts as so far below it: their ratio has to stay a number."""


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
    weigh_all(members.values())
    near = _near(members, edges)
    above = _root_tree(near)
    around = _near(members, (*closing, *edges))
    messages: dict[Pair, Message] = {}

    def ask(speaker: str, hearer: str, others: Sequence[str]) -> Question:
        said = together(members[speaker], others, speaker, messages)
        edge = around[speaker][hearer]
        return Question(
            members[speaker],
            members[hearer],
            (members[speaker].hidden_by(hearer), members[hearer].hidden_by(speaker)),
            said,
            edge if edge.pair[0] == hearer else edge.turned,
            stream(speaker, hearer),
        )

    # Whoever has heard all others speaks: all of a depth at once.
    waiting: dict[Pair, list[str]] = {}
    for name, parent in above.items():
        if parent is not None:
            waiting[name, parent] = [other for other in around[name] if other != parent]
            waiting[parent, name] = [other for other in around[parent] if other != name]
    for pair in (edge.pair for edge in closing):
        waiting[pair] = waiting[pair[::-1]] = []
    while waiting:
        ready = [
            pair for pair, others in waiting.items() if all((one, pair[0]) in messages for one in others)
        ]
        answers = answer([ask(*pair, waiting.pop(pair)) for pair in ready])
        messages.update(zip(ready, answers, strict=True))
    marginals = {name: _marginal(one, list(around[name]), name, messages) for name, one in members.items()}
    return marginals, {edge.pair: _order(edge, members, around, messages) for edge in (*edges, *closing)}


def _bound(one: Member) -> Member:
    best = one.log_likelihood.max()
    return changed(one, log_likelihood=np.maximum(one.log_likelihood, best - FARTHEST))


def _near(members: Iterable[str], edges: Iterable[Edge]) -> dict[str, dict[str, Edge]]:
    near: dict[str, dict[str, Edge]] = {name: {} for name in members}
    for edge in edges:
        first, second = edge.pair
        near[first][second] = near[second][first] = edge
    return near


def _root_tree(near: Mapping[str, Mapping[str, Edge]]) -> dict[str, str | None]:
    """All targets, parents before children, and each one's parent."""
    above: dict[str, str | None] = {}
    for root in near:
        if root in above:
            continue
        above[root] = None
        waiting = [root]
        while waiting:
            name = waiting.pop()
            for other in near[name]:
                if other == above[name]:
                    continue
                if other in above:
                    raise ValueError(f"targets {name} and {other} close a ring of joins")
                above[other] = name
                waiting.append(other)
    return above


def _marginal(one: Member, others: Sequence[str], name: str, messages: Mapping[Pair, Message]) -> Marginal:
    said = together(one, others, name, messages).all
    with np.errstate(divide="ignore"):
        log = one.log_likelihood + np.log(said)
    total, shares = float(one.seen @ said), shares_hidden(one, others, name, messages)
    hidden = {other: float(one.seen @ share) / total if total > 0 else 0.0 for other, share in shares.items()}
    return Marginal(log, hidden)


def _order(
    edge: Edge,
    members: Mapping[str, Member],
    near: Mapping[str, Mapping[str, Edge]],
    messages: Mapping[Pair, Message],
) -> float:
    """P(first in front | all evidence): the mean of what both ends say, each an average over its partners."""
    if edge.factor is not None:
        return edge.first_in_front
    found = []
    for own, other in (edge.pair, edge.pair[::-1]):
        one, message = members[own], messages[other, own]
        rest = together(one, [name for name in near[own] if name != other], own, messages)
        front = float(one.seen @ (rest.all * message.in_front))
        behind = float(one.seen @ (rest.all * message.untouched + rest.free * message.hidden))
        total = front + behind
        share = front / total if total > 0 else 0.5
        found.append(share if own == edge.pair[0] else 1.0 - share)
    return sum(found) / 2
