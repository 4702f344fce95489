"""Which of two that look alike is followed since they met, by how both were moving before."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

SPAN = 5
"""Estimates from which the target's motion is taken."""

BEFORE = 5
"""Estimates before a look-alike is noticed that do not count: the wrong one may be followed already."""

WAIT = 2
"""Frames without a look-alike after which motion may show it."""

LASTS = 50
"""Frames after the look-alike was seen for which either is taken to move on in a straight line."""

APART_BOX = 1.0
"""Box sides that the two have to be apart by then."""

NEAR_BOX = 2.0
"""Box sides from the target's place within which the estimate has to be: farther off it is neither's."""

NEARER = 0.5
"""The estimate has to be nearer to the target's place than this share of its distance to the other's."""


@dataclass(frozen=True)
class Place:
    """The centre of something in a frame, px."""

    frame: int
    x: float
    y: float

    def distance(self, other: Place) -> float:
        """Distance of the centres, px."""
        return math.hypot(self.x - other.x, self.y - other.y)


@dataclass(frozen=True)
class Encounter:
    """How a target and something that looks like it moved when they met.

    Attributes:
        own: two places of the target before; None where there are no two.
        first: the look-alike's when it was seen first, and `last` when it was seen last.
        behind_nats: by how much it was less likely than the target, at most.
    """

    own: tuple[Place, Place] | None
    first: Place
    last: Place
    behind_nats: float


def place_in(frame: int, first: Place, last: Place) -> Place:
    """Where something is in a frame if it moves on as between two places.

    >>> place_in(4, Place(1, 0.0, 5.0), Place(2, 3.0, 5.0))
    Place(frame=4, x=9.0, y=5.0)
    """
    steps = (frame - last.frame) / (last.frame - first.frame)
    return Place(frame, last.x + steps * (last.x - first.x), last.y + steps * (last.y - first.y))


def motion_before(places: Sequence[Place]) -> tuple[Place, Place] | None:
    """Two places that show how the target moved before a look-alike was noticed; None with fewer places."""
    told = places[:-BEFORE][-SPAN:]
    told = told if len(told) > 1 else places[:2]
    return (told[0], told[-1]) if len(told) > 1 else None


def distances_since(met: Encounter, place: Place, side_px: float) -> tuple[float, float] | None:
    """How far an estimate is from where the target and the other one should be by now, in box sides.

    None where motion does not show it: the other was seen in one frame only or long ago, or both should be at
    nearly the same place.
    """
    if met.own is None or met.first.frame == met.last.frame or place.frame - met.last.frame > LASTS:
        return None
    own, other = place_in(place.frame, *met.own), place_in(place.frame, met.first, met.last)
    if own.distance(other) <= APART_BOX * side_px:
        return None
    return place.distance(own) / side_px, place.distance(other) / side_px
