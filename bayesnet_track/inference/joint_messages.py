"""What the hypotheses of one target say of those of another: sums over partners; see `inference.joint`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.inference.joint_members import Crowd, Edge, Factor, Member, Pair
from bayesnet_track.numerics.arrays import Floats, Ints

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
        cls, crowd: Crowd, edges: Sequence[Edge], closing: Sequence[Edge], above: Mapping[str, str | None]
    ) -> PairBatch:
        """That of a forest, in which `above` has the parents, after children, and of edges that close rings.

        Along these a target says what it believes by itself, and no more.
        """
        every = [*closing, *edges]
        pairs = [pair for edge in every for pair in (edge.pair[::-1], edge.pair)]
        number = {pair: k for k, pair in enumerate(pairs)}
        heard: dict[str, list[int]] = {name: [] for name in crowd.names}
        for k, (_, hearer) in enumerate(pairs):
            heard[hearer].append(k)
        alone = 2 * len(closing)
        before = [
            [one for one in heard[speaker] if k >= alone and pairs[one][0] != hearer]
            for k, (speaker, hearer) in enumerate(pairs)
        ]
        down = [(parent, name) for name, parent in above.items() if parent is not None]
        order = [
            *range(alone),
            *(number[own[::-1]] for own in reversed(down)),
            *(number[own] for own in down),
        ]
        speakers, hearers = (
            np.array([crowd.names[pair[end]] for pair in pairs], dtype=np.int64) for end in (0, 1)
        )
        begins = np.cumsum([0, *np.diff(crowd.starts)[hearers].tolist()])
        both = [own for edge in every for own in (edge, edge.turned)]
        return cls(pairs, both, (speakers, hearers), begins[:-1], int(begins[-1]), heard, before, order)


def pass_messages(crowd: Crowd, members: Mapping[str, Member], batch: PairBatch, keys: Keys) -> Floats:
    """Messages of all pairs, (4, ...), each in units of its own evidence.

    In front; behind but not touched; behind and partly hidden; and the last times the share.
    """
    from bayesnet_track.numerics.kernels.speaking_kernels import ask, speak

    said = np.zeros((4, batch.columns))
    if not batch.pairs:
        return said
    known = (crowd.boxes, crowd.losses, crowd.bad, crowd.seen, *crowd.prior, crowd.by_place)
    pairs, heard = (*batch.ends, batch.at), ragged(batch.before)
    draws = _draw(crowd, batch, keys)
    rules = (
        crowd.hidden(members, batch.pairs),
        crowd.hidden(members, [pair[::-1] for pair in batch.pairs]),
        np.array([(edge.first_in_front, edge.nats) for edge in batch.edges]),
    )
    given = known, crowd.starts, crowd.log_evidence, pairs, heard, draws
    for is_plain, some in groupby(batch.order, key=lambda k: batch.edges[k].factor is None):
        if is_plain:
            speak(np.array([*some]), *given, rules, said)
            continue
        for k in some:
            partners, log_importance, free, taken = ask(k, *given, said)
            (speaker, hearer), factor = batch.pairs[k], batch.edges[k].factor
            assert factor is not None
            own = slice(crowd.starts[batch.ends[0][k]], crowd.starts[batch.ends[0][k] + 1])
            weight = np.exp(log_importance - crowd.losses[own]) * (free + taken)
            ends = members[hearer].states, members[speaker].states
            found = related(*ends, factor, partners, weight)
            said[0, batch.at[k] : batch.at[k] + len(found)] = found
    return said


def ragged(several: Sequence[Sequence[int]]) -> tuple[Ints, Ints]:
    """Numbers of several lists below each other: where each list begins, and all of them."""
    starts = np.cumsum([0, *map(len, several)])
    return starts, np.array([one for own in several for one in own], dtype=np.int64)


def _draw(crowd: Crowd, batch: PairBatch, keys: Keys) -> tuple[Floats, Ints, Ints, Ints]:
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
    own = {name: values[None] for name, values in hearer.items()}
    log = np.minimum(factor(own, {name: values[partners] for name, values in speaker.items()}), MOST_LOG)
    top = float(log.max())
    if top == -np.inf:
        density = np.ones(partners.shape)
    else:
        density = np.exp(log - top if abs(top) > COMMON_LOG else log)
    return np.asarray((weight[partners] * density).mean(axis=0))
