"""Decisions about a target's life: it is recognised again, or its net ends (`journal.net.net` applies it)."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Recognition:
    """The numbers by which a detection was compared with a target that is remembered.

    Its odds against a new target are exp(fading + place + appearance); the probability is these odds divided
    by 1 plus the odds of all targets that are remembered.

    Attributes:
        target: the target's id.
        probability: that the detection is this target.
        min_probability: the level of the rule.
        away: frame intervals since the target was last well seen.
        distance_px: distance of the detection from where its motion leads it.
        fading: log of g = exp(-away / reidentify.frames), nats.
        place: log of the frame's area times the density of its place there, nats.
        appearance: log of the likelihood that its remembered looks give the box, over that of boxes elsewhere
            (one in twenty is taken to look like it), nats.
        agents: those that were asked about its appearance.
        rival: what else it most probably is: another target's id, or new.
        rival_probability: the probability of that.
    """

    target: str
    probability: float
    min_probability: float
    away: float
    distance_px: float
    fading: float
    place: float
    appearance: float
    agents: tuple[str, ...]
    rival: str
    rival_probability: float


@dataclass(frozen=True)
class Returned:
    """A target whose net had ended was recognised: a net is born with its identity and what it remembers.

    Attributes:
        frame: frame at which it starts again.
        target: its old id.
        template: name of the plate.
        box: centre box x, y, w, h in px.
        active: agents that are switched on.
        recognition: the numbers.
    """

    frame: int
    target: str
    template: str
    box: tuple[float, float, float, float]
    active: tuple[str, ...]
    recognition: Recognition


@dataclass(frozen=True)
class Reacquired:
    """A target that was lost was recognised in a detection: its belief starts again there.

    Attributes:
        frame: frame of the detection.
        target: target id.
        box: centre box x, y, w, h in px of the detection.
        recognition: the numbers.
    """

    frame: int
    target: str
    box: tuple[float, float, float, float]
    recognition: Recognition


@dataclass(frozen=True)
class TargetDied:
    """A net ends: its target was lost, or not detected, for too long.

    Attributes:
        frame: last frame of the net.
        target: target id.
        reason: lost or unseen.
        frames: for how many consecutive frames.
        limit: the rule's number of frames.
        remembered: whether the target can be recognised later.
    """

    frame: int
    target: str
    reason: str
    frames: int
    limit: int
    remembered: bool


@dataclass(frozen=True)
class DuplicateEnded:
    """A net ends: its belief overlapped that of an older net for too long, so that both hold one target.

    Attributes:
        frame: last frame of the net.
        target: id of the younger one, which ends.
        kept: id of the older one.
        overlap: least Bhattacharyya coefficient of their beliefs over these frames.
        level: the rule's least overlap.
        frames: for how many consecutive frames.
    """

    frame: int
    target: str
    kept: str
    overlap: float
    level: float
    frames: int
