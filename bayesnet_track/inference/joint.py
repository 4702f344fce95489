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

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from bayesnet_track.inference.joint_members import Crowd, Edge, Member, Pair
from bayesnet_track.inference.joint_messages import Keys, PairBatch, pass_messages, ragged
from bayesnet_track.numerics.arrays import Floats


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

    above = _root_tree(_near(members, edges))
    if not members:
        return {}, {}
    crowd = Crowd.of(members)
    batch = PairBatch.along(crowd, edges, closing, above)
    said = pass_messages(crowd, members, batch, keys)
    heard = [batch.heard[name] for name in members]
    log, hides, fronts = conclude(
        crowd.log_likelihood, crowd.seen, crowd.starts, batch.at, ragged(heard), said
    )
    marginals = {
        name: Marginal(
            log[crowd.starts[m] : crowd.starts[m + 1]], {batch.pairs[k][0]: float(hides[k]) for k in heard[m]}
        )
        for m, name in enumerate(members)
    }
    orders = {
        edge.pair: edge.first_in_front if edge.factor is not None else float(front + 1.0 - back) / 2
        for edge, front, back in zip(batch.edges[::2], fronts[::2], fronts[1::2], strict=True)
    }
    return marginals, orders


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
