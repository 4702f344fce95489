"""Events of a target's life: births, recognitions, and the ends of its net."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from bayesnet_track.journal.target_net import TargetNet
from bayesnet_track.journal.text.wording import decimals, distinct_texts, plural, round_away


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
        box: centre box x, y, w, h in px; of a point 1 x 1, in the unit of its sensors.
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
        effect = f"target {self.target} is back{_centre_text(self.box)}"
        return _describe_recognition(self.recognition, effect, "a new target")


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
        effect = f"target {self.target} found again{_centre_text(self.box)}"
        return _describe_recognition(self.recognition, effect, "left alone")

    def change(self, net: TargetNet) -> TargetNet:
        """The net of the target after it."""
        return replace(net, status="tracking")


@dataclass(frozen=True)
class Continued:
    """Detections that would have started a target go on with one whose own had stopped: it turned or jumped.

    Attributes:
        frame: frame in which they were often enough for a target of their own.
        target: target id.
        box: centre box x, y, w, h in px of the last of them.
        first_frame: frame of the first of them.
        distance_box: distance of the first of them from where the target was last seen, in sides sqrt(w h) of
            the target a frame interval.
        continue_box: the level of the rule.
    """

    frame: int
    target: str
    box: tuple[float, float, float, float]
    first_frame: int
    distance_box: float
    continue_box: float

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        value, level = distinct_texts(self.distance_box, self.continue_box)
        refused = round_away(self.distance_box, 2, up=False)
        return (
            f"detections began in frame {self.first_frame}, when those of target {self.target} had ended, "
            f"{value} sides a frame from it ≤ {level} → target {self.target} goes on with them"
            f"{_centre_text(self.box)}; would have been a new target at continue_box < {refused}"
        )

    def change(self, net: TargetNet) -> TargetNet:
        """The net of the target after it."""
        return replace(net, status="tracking")


def _describe_recognition(recognition: Recognition, effect: str, otherwise: str) -> str:
    value, level = distinct_texts(recognition.probability, recognition.min_probability)
    # As many digits as tell it from 1, and rounded up, so that the level named would have refused it.
    digits = max(2, math.ceil(-math.log10(max(1.0 - recognition.probability, 1e-7))))
    turning = float(round_away(recognition.probability, digits, up=True))
    would = f"; would have been {otherwise} at min_probability ≥ {turning:.9g}"
    but = "" if turning >= 1 or recognition.contested else would
    relation = "≥" if recognition.probability > recognition.min_probability else "="
    rival = "a new target" if recognition.rival == "new" else f"target {recognition.rival}"
    return (
        f"a detection is target {recognition.target} with probability {value} {relation} {level} "
        f"({explain_odds(recognition)}; next {rival}, {recognition.rival_probability:.2g}) → {effect}{but}"
    )


def explain_odds(recognition: Recognition) -> str:
    """The log-odds' parts."""
    whom = f" by {', '.join(recognition.agents)}" if recognition.agents else ""
    return (
        f"unseen for {plural(recognition.away, 'frame')} {recognition.fading:+.2f}, "
        f"{recognition.distance_px:.0f} px off {recognition.place:+.2f}, "
        f"appearance{whom} {recognition.appearance:+.2f} nats"
    )


def _centre_text(box: tuple[float, float, float, float]) -> str:
    return f", centre {box[0]:.4g}, {box[1]:.4g}, {box[2]:.4g} x {box[3]:.4g} px"


MOST_DETECTIONS = 10_000
"""Detections of a frame that a graph can use."""


@dataclass(frozen=True)
class TargetStarted:
    """A net starts: a copy of the plate `template` for the target inside `box`.

    Attributes:
        frame: frame at which it starts.
        target: the new target's id.
        template: name of the plate.
        box: centre box x, y, w, h in px.
        active: agents that are switched on.
    """

    frame: int
    target: str
    template: str
    box: tuple[float, float, float, float]
    active: tuple[str, ...]

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        x, y, w, h = self.box
        active = ", ".join(self.active) or "no agent"
        place = f"centre {x:.4g}, {y:.4g}, {w:.4g} x {h:.4g} px"
        if w == h == 1.0:  # a point, which has no size
            place = f"at {x:.4g}, {y:.4g}"
        return f"target {self.target} starts as {self.template}, {place} → {active} on"


@dataclass(frozen=True)
class CandidateConfirmed:
    """A candidate was detected often enough and is none of the remembered targets: a new target starts.

    Attributes:
        frame: the frame.
        target: id of the new target; its `target_started` follows.
        template: name of the plate.
        detector: name of the detector.
        first_frame: frame in which it was first detected.
        seen: in how many runs of the detector it was detected.
        looks: of how many runs.
        score: mean score of these detections, 0..1.
        nearest: the remembered target that it was most likely to be, or null when none is remembered.
        existence: probability that it exists, where the plate goes by it.
        confirm: the rule's least probability.
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
    existence: float | None = field(default=None, metadata={"left_out_when_empty": True})
    confirm: float | None = field(default=None, metadata={"left_out_when_empty": True})

    def describe(self) -> str:
        """`gray_level detected it in 3 of 4 evaluations ...  → target 3 is new`."""
        evaluations = plural(self.looks, "evaluation")
        detected = f"{self.detector} detected it in {self.seen} of {evaluations}"
        start = f" since frame {self.first_frame}" if self.first_frame < self.frame else ""
        exists = ""
        if self.existence is not None and self.confirm is not None:
            value, level = distinct_texts(self.existence, self.confirm)
            exists = f", existence {value} ≥ {level}"
        evidence = f"{detected}{start}, mean score {self.score:.2f}{exists} → target {self.target} is new"
        nearest = self.nearest
        if nearest is None:
            return evidence
        value, level = distinct_texts(nearest.probability, nearest.min_probability)
        if nearest.probability >= nearest.min_probability:
            return f"{evidence} (target {nearest.target} is taken for another detection)"
        evidence += (
            f": it is target {nearest.target} with probability {value} < {level} ({explain_odds(nearest)})"
        )
        if nearest.contested:
            return evidence
        turning = round_away(
            nearest.probability, decimals(nearest.probability, nearest.min_probability), up=False
        )
        return f"{evidence}; would have been target {nearest.target} at min_probability ≤ {turning}"


@dataclass(frozen=True)
class BirthsRefused:
    """Detections got no net: the plate has its maximum of live targets. Reported at the 1st, 10th, 100th, ...

    Attributes:
        frame: the frame.
        template: name of the plate.
        detector: name of the detector.
        live: live targets of the plate.
        max_targets: the rule's number.
        refused: confirmed detections refused so far; one that persists counts in every run of the detector.
        waiting: confirmed detections refused in this frame; several of one object count once.
    """

    frame: int
    template: str
    detector: str
    live: int
    max_targets: int
    refused: int
    waiting: int

    def describe(self) -> str:
        """`20 targets of square live, the maximum → 3 new targets refused`."""
        so_far = f", {self.refused} so far" if self.refused > self.waiting else ""
        return (
            f"{plural(self.live, 'target')} of {self.template} live, the maximum → "
            f"{plural(self.waiting, 'new target')} refused{so_far}; would have started at max_targets ≥ "
            f"{self.live + self.waiting}"
        )


@dataclass(frozen=True)
class DetectorFailed:
    """A detector failed and is paused, longer with each failure in a row; meanwhile it detects nothing.

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

    def describe(self) -> str:
        """`motion failed: ... → paused for 10 frames, tried again in frame 14`."""
        pause = "the rest of the run"
        if self.until is not None:
            waits = plural(self.until - self.frame, "frame")
            pause = f"{waits} after {self.times} failures in a row" if self.times > 1 else waits
            pause += f", tried again in frame {self.until}"
        return f"detector {self.detector} failed: {self.reason} → paused for {pause}"


@dataclass(frozen=True)
class DetectionsCut:
    """A detector found more than it may give: the best are used. Reported in the 1st, 10th, 100th such frame.

    Attributes:
        frame: the frame.
        detector: its name.
        used: detections of this frame that are used.
        cut: others of this frame that count as much, but for their number.
        frames: frames so far in which detections were cut.
    """

    frame: int
    detector: str
    used: int
    cut: int
    frames: int

    def describe(self) -> str:
        """`blobs found 60 → 28 are not used: the best 32 are; would all be used at max_count ≥ 60`."""
        count = self.used + self.cut
        so_far = f", in {self.frames} frames so far" if self.frames > 1 else ""
        would = f"would all be used at max_count ≥ {count}"
        if count > MOST_DETECTIONS:
            would = f"max_count is at most {MOST_DETECTIONS}"
        usage = f"the best {self.used} are used, not {self.cut}{so_far}"
        return f"{self.detector} found {count} → {usage}; {would}"


@dataclass(frozen=True)
class TargetDied:
    """A net ends: its target was lost, or not detected, for too long.

    Attributes:
        frame: last frame of the net.
        target: target id.
        reason: lost, unseen, or existence: it exists with too small a probability.
        frames: for how many consecutive frames; without a detection of its own where the reason is existence.
        limit: the rule's number of frames; 0 where the reason is existence.
        remembered: whether the target can be recognised later.
        existence: probability that it exists, where it is too small.
        end: the rule's least probability, then.
        unseen_frames: for how many frames it was not detected, where it is lost and that would have been
            enough; else 0.
    """

    frame: int
    target: str
    reason: str
    frames: int
    limit: int
    remembered: bool
    existence: float | None = field(default=None, metadata={"left_out_when_empty": True})
    end: float | None = field(default=None, metadata={"left_out_when_empty": True})
    unseen_frames: int = field(default=0, metadata={"left_out_when_empty": True})

    def describe(self) -> str:
        """`lost for 30 frames → target 3 ends`."""
        memory = ", remembered" if self.remembered else ""
        if self.reason == "existence" and self.existence is not None and self.end is not None:
            value, level = distinct_texts(self.existence, self.end)
            unseen = f" after {plural(self.frames, 'frame')} without a detection" if self.frames else ""
            why = f"existence {value} < {level}{unseen}"
        else:
            how = "lost" if self.reason == "lost" else "not detected"
            why = f"{how} for {plural(self.frames, 'frame')}"
        needs = " and ".join(self._needs())
        return f"{why} → target {self.target} ends{memory}; would have continued at {needs}"

    def _needs(self) -> list[str]:
        """All thresholds that had to differ: of several rules that hold, each would have ended it."""
        needs = []
        if self.reason != "existence":
            key = "lost_frames" if self.reason == "lost" else "unseen_frames"
            needs.append(f"{key} ≥ {self.frames + 1}")
        if self.unseen_frames:
            needs.append(f"unseen_frames ≥ {self.unseen_frames + 1}")
        if self.existence is not None and self.end is not None:
            turning = round_away(self.existence, decimals(self.existence, self.end), up=False)
            needs.append(f"existence.end ≤ {turning}")
        return needs


@dataclass(frozen=True)
class DuplicateEnded:
    """A net ends: its belief overlapped that of an older net for too long, so that both hold one target.

    Attributes:
        frame: last frame of the net.
        target: id of the younger one, which ends.
        kept: id of the older one.
        overlap: smallest Bhattacharyya coefficient of their beliefs over these frames.
        level: threshold of the rule.
        frames: for how many consecutive frames.
    """

    frame: int
    target: str
    kept: str
    overlap: float
    level: float
    frames: int

    def describe(self) -> str:
        """`its belief overlaps that of target 1 ... → target 3, the younger, ends`."""
        digits = decimals(self.overlap, self.level)
        turning = min(1.0, float(round_away(self.overlap, digits, up=True)))
        value = round_away(self.overlap, digits, up=False)
        return (
            f"its belief overlaps that of target {self.kept} by {value} ≥ {self.level:g} for "
            f"{plural(self.frames, 'frame')} → target {self.target}, the younger, ends; would have continued "
            f"at overlap > {turning:g} or frames > {self.frames}"
        )
