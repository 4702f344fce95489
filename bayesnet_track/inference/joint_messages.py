"""What the hypotheses of one target say of those of another: sums over partners; see `inference.joint`."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.inference.joint_members import Edge, Factor, Hidden, Member, Pair
from bayesnet_track.numerics.arrays import Floats

MOST_LOG = 700.0
"""Densities of pairs are numbers up to e^700."""
COMMON_LOG = 50.0
"""A largest density beyond e^±50 is divided out, so that products of several messages stay numbers."""


@dataclass(frozen=True, eq=False)
class Message:
    """What one target says of another's hypotheses: (N,) each."""

    in_front: Floats
    untouched: Floats
    hidden: Floats
    share: Floats

    @cached_property
    def free(self) -> Floats:
        """Where it hides nothing of them."""
        return self.in_front + self.untouched


@dataclass(frozen=True, eq=False)
class Said:
    """What several targets say together: where none hides, and where one does."""

    free: Floats
    taken: Floats

    @property
    def all(self) -> Floats:
        """Either way."""
        return self.free + self.taken


@dataclass(frozen=True, eq=False)
class Question:
    """What one target is asked: to say of another's hypotheses what pairs with its own do.

    Attributes:
        speaker: the target that is asked.
        hearer: the other.
        hidden: what stands for what they hide of each other: of the speaker's, of the hearer's.
        said: what further targets say of the speaker.
        edge: the pair, the hearer first.
        rng: generator of the partners.
    """

    speaker: Member
    hearer: Member
    hidden: tuple[Hidden, Hidden]
    said: Said
    edge: Edge
    rng: np.random.Generator


def together(one: Member, speakers: Sequence[str], hearer: str, messages: Mapping[Pair, Message]) -> Said:
    """The product of what `speakers` say of one target, of which at most one may hide it."""
    if not speakers:
        return _nothing_said(len(one.boxes))
    first, *others = (messages[speaker, hearer] for speaker in speakers)
    free, taken = first.free, first.hidden
    for said in others:
        own = said.free
        free, taken = free * own, taken * own + free * said.hidden
    return Said(free, taken)


@lru_cache(maxsize=64)
def _nothing_said(size: int) -> Said:
    return Said(np.ones(size), np.zeros(size))


def shares_hidden(
    one: Member, speakers: Sequence[str], hearer: str, messages: Mapping[Pair, Message]
) -> dict[str, Floats]:
    """Speaker -> (N,) how much each hides of one target, where none of the others does."""
    free = np.ones(len(one.boxes))
    shares: dict[str, Floats] = {}
    for speaker in speakers:
        said = messages[speaker, hearer]
        own = said.free
        shares = {name: known * own for name, known in shares.items()}
        shares[speaker] = free * said.share
        free = free * own
    return shares


def answer(questions: Sequence[Question]) -> list[Message]:
    """What the speakers say, each in units of its own evidence; those that are alike at once."""
    alike: dict[Hashable, list[int]] = {}
    for k, one in enumerate(questions):
        sizes = len(one.speaker.boxes), len(one.hearer.boxes)
        alike.setdefault((sizes, one.edge.pairings, one.edge.factor is None), []).append(k)
    found: dict[int, Message] = {}
    for places in alike.values():
        found.update(zip(places, _answer([questions[k] for k in places]), strict=True))
    return [found[k] for k in range(len(questions))]


def _answer(questions: Sequence[Question]) -> list[Message]:
    """Messages of targets with as many hypotheses and partners."""
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.kernels.joint_kernels import pair_sums_of_each

    speakers, hearers, edges = zip(*((one.speaker, one.hearer, one.edge) for one in questions), strict=True)
    prior = np.array([one.prior.weights for one in speakers])
    free, taken = (np.array([getattr(one.said, name) for one in questions]) for name in ("free", "taken"))
    belief = np.array([one.seen for one in speakers]) * (free + taken)
    shares = 0.5 * (prior + belief / belief.sum(axis=1)[:, None])
    order, size = np.array([one.by_place for one in speakers]), len(hearers[0].boxes)
    partners = draw_partners(order, shares, size, edges[0].pairings, [one.rng for one in questions])
    evidence = np.array([one.log_evidence for one in speakers])
    with np.errstate(divide="ignore"):
        log_importance = np.array([one.prior.log for one in speakers]) - np.log(shares) - evidence[:, None]
    losses, heard_losses = (np.array([one.losses for one in own]) for own in (speakers, hearers))
    if edges[0].factor is not None:
        weights = np.exp(log_importance - losses) * (free + taken)
        return [
            _related(one.hearer.states, one.speaker.states, one.edge.factor, own, weight)
            for one, own, weight in zip(questions, partners, weights, strict=True)
            if one.edge.factor is not None
        ]
    sums = pair_sums_of_each(
        (np.array([one.boxes for one in hearers]), heard_losses, np.array([one.bad for one in hearers])),
        np.array([one.hidden[1] for one in questions]),
        (np.array([one.boxes for one in speakers]), losses, np.array([one.bad for one in speakers])),
        np.array([one.hidden[0] for one in questions]),
        partners,
        (log_importance, free, taken),
        np.array([(edge.first_in_front, edge.nats) for edge in edges]),
    )
    return [Message(*own) for own in sums]


def draw_partners(
    by_place: NDArray[np.intp],
    shares: Floats,
    size: int,
    pairings: int,
    rngs: Sequence[np.random.Generator],
) -> NDArray[np.intp]:
    """(K, pairings, size) indices of M hypotheses, each column one from every stratum of the `shares` (K, M).

    The strata cut the hypotheses in the order `by_place` (K, M) into parts of equal share.
    """
    from bayesnet_track.numerics.kernels.joint_kernels import pick_in_strata_of_each

    shifts = np.empty((len(rngs), pairings * size))
    for own, rng in zip(shifts, rngs, strict=True):
        rng.random(out=own)
    bounds = np.cumsum(np.take_along_axis(shares, by_place, axis=1), axis=1)
    chosen = pick_in_strata_of_each(by_place, bounds, shifts).reshape(-1, pairings, size)
    for picked, rng in zip(chosen, rngs, strict=True):
        rng.permuted(picked, axis=1, out=picked)
    return chosen


def _related(
    hearer: Mapping[str, Floats],
    speaker: Mapping[str, Floats],
    factor: Factor,
    partners: NDArray[np.intp],
    weight: Floats,
) -> Message:
    """The mean over partners of their weight times the pair's factor; without it where it is 0 for all.

    Of a factor that is tiny or huge it is the mean but for a constant, which all hypotheses share.
    """
    own = {name: values[None] for name, values in hearer.items()}
    log = np.minimum(factor(own, {name: values[partners] for name, values in speaker.items()}), MOST_LOG)
    top = float(log.max())
    if top == -np.inf:
        density = np.ones(partners.shape)
    else:
        density = np.exp(log - top if abs(top) > COMMON_LOG else log)
    nothing = np.zeros(partners.shape[1])
    return Message((weight[partners] * density).mean(axis=0), nothing, nothing, nothing)
