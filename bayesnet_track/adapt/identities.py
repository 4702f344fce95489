"""Identities of tracks that met, from meeting to meeting: joint probabilities of whose each track has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from bayesnet_track.adapt.meetings import Meeting, Placing, SensorRates

LEAST_DOUBT = 0.001
"""Of who is who, what is less probable is left out."""
MOST_ASSIGNMENTS = 64
"""Joint assignments of identities to tracks that are kept: the most probable ones."""


@dataclass(frozen=True, eq=False)
class Entangled:
    """Tracks whose identities depend on each other.

    Attributes:
        tracks: m tracks.
        identities: of each assignment the identity of every track.
        probability: of each assignment, in falling order.
    """

    tracks: tuple[str, ...]
    identities: tuple[tuple[str, ...], ...]
    probability: tuple[float, ...]

    def of(self, track: str) -> dict[str, float]:
        """The identities of one track, the most probable one first."""
        place, shares = self.tracks.index(track), dict[str, float]()
        for identities, probability in zip(self.identities, self.probability, strict=True):
            shares[identities[place]] = shares.get(identities[place], 0.0) + probability
        return dict(sorted(shares.items(), key=lambda share: -share[1]))


def compose(known: Sequence[Entangled], placing: Placing, sure: float = 0.99) -> tuple[Entangled, ...]:
    """What is known of identities after a meeting: the tracks became what members were before.

    A track that is itself with probability `sure` is not doubtful any more.
    """
    met = {*placing.members, *placing.tracks}
    before = [one for one in known if met.intersection(one.tracks)]
    table: dict[tuple[str, ...], float] = {(): 1.0}
    names: tuple[str, ...] = ()
    for one in before:
        table = {
            (*identities, *others): share * probability
            for identities, share in table.items()
            for others, probability in zip(one.identities, one.probability, strict=True)
        }
        names = (*names, *one.tracks)
    others = [name for name in names if name not in met]
    after: dict[tuple[str, ...], float] = {}
    chosen = [*zip(placing.named(), placing.probability.tolist(), strict=True)]
    for identities, share in table.items():
        of = dict(zip(names, identities, strict=True))
        rest = tuple(of[name] for name in others)
        for members, probability in chosen:
            key = (*rest, *(of.get(member, member) for member in members))
            after[key] = after.get(key, 0.0) + share * probability
    tracks = (*others, *placing.tracks)
    return (*(one for one in known if one not in before), *only(tracks, after, tracks, sure))


def only(
    tracks: Sequence[str], table: Mapping[tuple[str, ...], float], left: Sequence[str], sure: float
) -> tuple[Entangled, ...]:
    """The doubtful ones of the tracks that are `left`, one set at most: others are summed over."""
    every = {
        name: sum(share for identities, share in table.items() if identities[place] == name)
        for place, name in enumerate(tracks)
    }
    kept = [place for place, name in enumerate(tracks) if name in left and every[name] < sure]
    shares: dict[tuple[str, ...], float] = {}
    for identities, share in table.items():
        key = tuple(identities[place] for place in kept)
        shares[key] = shares.get(key, 0.0) + share
    ranked = sorted(shares.items(), key=lambda item: -item[1])[:MOST_ASSIGNMENTS]
    ranked = [(key, share) for key, share in ranked if share >= LEAST_DOUBT]
    total = sum(share for _, share in ranked)
    if not kept or not total:
        return ()
    names = tuple(tracks[place] for place in kept)
    return (Entangled(names, tuple(key for key, _ in ranked), tuple(share / total for _, share in ranked)),)


def keep_live(known: Sequence[Entangled], live: frozenset[str], sure: float) -> tuple[Entangled, ...]:
    """The same, of tracks that are live."""
    after: list[Entangled] = []
    for one in known:
        left = [name for name in one.tracks if name in live]
        if len(left) == len(one.tracks):
            after.append(one)
        else:
            after += only(one.tracks, dict(zip(one.identities, one.probability, strict=True)), left, sure)
    return tuple(after)


@dataclass(frozen=True, eq=False)
class PlateIdentities:
    """What is remembered of the identities of a plate.

    Attributes:
        meetings: targets that are close, or were a short while ago.
        entangled: tracks that may be other ones.
        rates: what is measured of detections.
        unseen: target -> frames since its last detection, if there are any.
        refused: target -> the first frame of its meeting, of those that could not be asked about.
    """

    meetings: tuple[Meeting, ...] = ()
    entangled: tuple[Entangled, ...] = ()
    rates: SensorRates = field(default_factory=SensorRates)
    unseen: Mapping[str, int] = field(default_factory=dict)
    refused: tuple[tuple[str, str], ...] = ()
