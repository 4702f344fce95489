"""Targets that are recognised in a detection."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from bayesnet_track.journal.net.target_net import TargetNet
from bayesnet_track.journal.text.wording import distinct_texts, plural, round_away


@dataclass(frozen=True)
class Recognition:
    """The numbers by which a detection was compared with a remembered target.

    Its odds against a new target are exp(fading + place + appearance); the probability is these odds divided
    by 1 plus the odds of all remembered targets.

    Attributes:
        target: the target's id.
        probability: that the detection is this target.
        min_probability: the level of the rule.
        away: frame intervals since the target was last well seen.
        distance_px: distance of the detection from where its motion leads it.
        fading: log of g = exp(-away / reidentify.frames), nats.
        place: log of the frame's area times the density of its place there, nats.
        appearance: log of the likelihood of the box by its references, over that of boxes elsewhere (one in
            twenty is assumed to look like it), nats.
        agents: agents that scored its appearance.
        rival: what else it most probably is: another target's id, or new.
        rival_probability: the probability of that.
        contested: whether another detection or target has a say in what would have become of it at another
            level, so that no level is named.
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
    contested: bool = field(default=False, metadata={"left_out_when_empty": True})


@dataclass(frozen=True)
class Returned:
    """A target whose net had ended was recognised: a net starts with its identity and its references.

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

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        then = f"target {self.target} is back{_at(self.box)}"
        return _describe_recognition(self.recognition, then, "a new target")


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

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        then = f"target {self.target} found again{_at(self.box)}"
        return _describe_recognition(self.recognition, then, "left alone")

    def change(self, net: TargetNet) -> TargetNet:
        """The net of the target after it."""
        return replace(net, status="tracking")


Decisions = Returned | Reacquired


def _describe_recognition(by: Recognition, then: str, otherwise: str) -> str:
    value, level = distinct_texts(by.probability, by.min_probability)
    # As many digits as tell it from 1, and rounded up, so that the level named would have refused it.
    digits = max(2, math.ceil(-math.log10(max(1.0 - by.probability, 1e-7))))
    turning = float(round_away(by.probability, digits, up=True))
    would = f"; would have been {otherwise} at min_probability ≥ {turning:.9g}"
    but = "" if turning >= 1 or by.contested else would
    relation = "≥" if by.probability > by.min_probability else "="
    rival = "a new target" if by.rival == "new" else f"target {by.rival}"
    return (
        f"a detection is target {by.target} with probability {value} {relation} {level} ({explain_odds(by)}; "
        f"next {rival}, {by.rival_probability:.2g}) → {then}{but}"
    )


def explain_odds(by: Recognition) -> str:
    """The log-odds' parts."""
    whom = f" by {', '.join(by.agents)}" if by.agents else ""
    return (
        f"unseen for {plural(by.away, 'frame')} {by.fading:+.2f}, {by.distance_px:.0f} px off "
        f"{by.place:+.2f}, appearance{whom} {by.appearance:+.2f} nats"
    )


def _at(box: tuple[float, float, float, float]) -> str:
    return f", centre {box[0]:.4g}, {box[1]:.4g}, {box[2]:.4g} x {box[3]:.4g} px"
