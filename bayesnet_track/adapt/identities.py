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


def compose(beliefs: Sequence[Entangled], placing: Placing, sure: float = 0.99) -> tuple[Entangled, ...]:
    """Beliefs about identities after a meeting: the tracks became what members were before.

    A track that is itself with probability `sure` is not doubtful any more.
    """
    met = {*placing.members, *placing.tracks}
    involved = [entangled for entangled in beliefs if met.intersection(entangled.tracks)]
    table: dict[tuple[str, ...], float] = {(): 1.0}
    names: tuple[str, ...] = ()
    for entangled in involved:
        table = {
            (*identities, *addition): share * probability
            for identities, share in table.items()
            for addition, probability in zip(entangled.identities, entangled.probability, strict=True)
        }
        names = (*names, *entangled.tracks)
    outsiders = [name for name in names if name not in met]
    merged: dict[tuple[str, ...], float] = {}
    placings = [*zip(placing.named(), placing.probability.tolist(), strict=True)]
    for identities, share in table.items():
        identity_of = dict(zip(names, identities, strict=True))
        unmet = tuple(identity_of[name] for name in outsiders)
        for members, probability in placings:
            key = (*unmet, *(identity_of.get(member, member) for member in members))
            merged[key] = merged.get(key, 0.0) + share * probability
    tracks = (*outsiders, *placing.tracks)
    return (
        *(entangled for entangled in beliefs if entangled not in involved),
        *only(tracks, merged, tracks, sure),
    )


def only(
    tracks: Sequence[str], table: Mapping[tuple[str, ...], float], remaining: Sequence[str], sure: float
) -> tuple[Entangled, ...]:
    """The doubtful ones of the tracks that are `remaining`, one set at most: others are summed over."""
    self_share = {
        name: sum(share for identities, share in table.items() if identities[place] == name)
        for place, name in enumerate(tracks)
    }
    doubtful = [place for place, name in enumerate(tracks) if name in remaining and self_share[name] < sure]
    shares: dict[tuple[str, ...], float] = {}
    for identities, share in table.items():
        key = tuple(identities[place] for place in doubtful)
        shares[key] = shares.get(key, 0.0) + share
    ranked = sorted(shares.items(), key=lambda item: -item[1])[:MOST_ASSIGNMENTS]
    ranked = [(key, share) for key, share in ranked if share >= LEAST_DOUBT]
    total = sum(share for _, share in ranked)
    if not doubtful or not total:
        return ()
    names = tuple(tracks[place] for place in doubtful)
    return (Entangled(names, tuple(key for key, _ in ranked), tuple(share / total for _, share in ranked)),)


def keep_live(beliefs: Sequence[Entangled], live: frozenset[str], sure: float) -> tuple[Entangled, ...]:
    """The same, of tracks that are live."""
    updated: list[Entangled] = []
    for entangled in beliefs:
        remaining = [name for name in entangled.tracks if name in live]
        if len(remaining) == len(entangled.tracks):
            updated.append(entangled)
        else:
            updated += only(
                entangled.tracks,
                dict(zip(entangled.identities, entangled.probability, strict=True)),
                remaining,
                sure,
            )
    return tuple(updated)


@dataclass(frozen=True, eq=False)
class PlateIdentities:
    """Memory of the identities of a plate.

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
