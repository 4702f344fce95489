"""The journal's events around births, besides decisions."""

from __future__ import annotations

from dataclasses import dataclass

from bayesnet_track.journal.net.life_decisions import Recognition


@dataclass(frozen=True)
class CandidateConfirmed:
    """What a detector found was seen often enough and is no target that is remembered: a new one is born.

    Attributes:
        frame: the frame.
        target: id of the new target; its `target_started` follows.
        template: name of the plate.
        detector: name of the detector.
        first_frame: frame in which it was first detected.
        seen: in how many looks it was seen.
        looks: of how many.
        score: mean score of these detections, 0..1.
        nearest: the remembered target that it was most likely to be, or null when none is remembered.
    """

    frame: int
    target: str
    template: str
    detector: str
    first_frame: int
    seen: int
    looks: int
    score: float
    nearest: Recognition | None


@dataclass(frozen=True)
class BirthsRefused:
    """Detections got no net, for a plate has as many live targets as it may. Told at 1, 10, 100, ... of them.

    Attributes:
        frame: the frame.
        template: name of the plate.
        detector: name of the detector.
        live: live targets of the plate.
        max_targets: the rule's number.
        refused: confirmed detections refused so far; one that stays counts in every look.
        waiting: confirmed detections refused in this frame.
    """

    frame: int
    template: str
    detector: str
    live: int
    max_targets: int
    refused: int
    waiting: int


@dataclass(frozen=True)
class DetectorFailed:
    """A detector failed and is out for a while, longer with each failure in a row; it finds no targets then.

    Attributes:
        frame: frame at which it failed.
        detector: its name.
        reason: what it raised or returned.
        until: first frame in which it is tried again; None when it never is.
        times: how many times in a row it has failed.
    """

    frame: int
    detector: str
    reason: str
    until: int | None = None
    times: int = 1
