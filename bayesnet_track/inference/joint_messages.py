"""What the hypotheses of one target say of those of another: sums over partners; see `inference.joint`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.inference.joint_members import Edge, Factor, Hidden, Member, Pair
from bayesnet_track.numerics.arrays import Floats

LEAST_LOG = -700.0
"""Densities of pairs are numbers up to e^700."""


@dataclass(frozen=True, eq=False)
class Message:
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
class Said:
    """What several targets say together: where none hides, where one does, and that one's shares."""

    free: Floats
    taken: Floats
    shares: Mapping[str, Floats]

    @property
    def all(self) -> Floats:
        """Either way."""
        return self.free + self.taken


def together(one: Member, speakers: Sequence[str], hearer: str, messages: Mapping[Pair, Message]) -> Said:
    """The product of what `speakers` say of one target, of which at most one may hide it."""
    size = len(one.boxes)
    free, taken = np.ones(size), np.zeros(size)
    shares: dict[str, Floats] = {}
    for speaker in speakers:
        said = messages[speaker, hearer]
        shares = {name: known * said.free for name, known in shares.items()}
        shares[speaker] = free * said.share
        free, taken = free * said.free, taken * said.free + free * said.hidden
    return Said(free, taken, shares)


def pair_message(
    speaker: Member,
    hearer: Member,
    hidden: tuple[Hidden, Hidden],
    said: Said,
    edge: Edge,
    rng: np.random.Generator,
) -> Message:
    """What pairs with `speaker` say of the hypotheses of `hearer`, in units of the speaker's evidence.

    The first of the `edge` is the hearer.
    """
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.kernels.joint_kernels import pair_sums

    prior = speaker.prior.weights
    belief = speaker.seen * said.all
    shares = 0.5 * (prior + belief / belief.sum())
    partners = draw_partners(speaker.by_place, shares, len(hearer.boxes), edge.pairings, rng)
    with np.errstate(divide="ignore"):
        log_importance = speaker.prior.log - np.log(shares) - speaker.log_evidence
    if edge.factor is not None:
        weight = np.exp(log_importance - speaker.losses) * said.all
        return _related(hearer.states, speaker.states, edge.factor, partners, weight)
    return Message(
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


def draw_partners(
    by_place: NDArray[np.intp], shares: Floats, size: int, pairings: int, rng: np.random.Generator
) -> NDArray[np.intp]:
    """(pairings, size) indices of M hypotheses, each column one from every stratum of the `shares` (M,).

    The strata cut the hypotheses in the order `by_place` into parts of equal share.
    """
    from bayesnet_track.numerics.kernels.joint_kernels import pick_in_strata

    chosen = pick_in_strata(by_place, np.cumsum(shares[by_place]), rng.random(pairings * size))
    return np.asarray(rng.permuted(chosen.reshape(pairings, size), axis=1))


def _related(
    hearer: Mapping[str, Floats],
    speaker: Mapping[str, Floats],
    factor: Factor,
    partners: NDArray[np.intp],
    weight: Floats,
) -> Message:
    """The mean over partners of their weight times the pair's factor; without it where it is 0 for all."""
    own = {name: values[None] for name, values in hearer.items()}
    log = factor(own, {name: values[partners] for name, values in speaker.items()})
    density = np.exp(np.clip(log, None, -LEAST_LOG))
    if not density.any():
        density = np.ones(partners.shape)
    nothing = np.zeros(partners.shape[1])
    return Message((weight[partners] * density).mean(axis=0), nothing, nothing, nothing)
