"""Targets that are born from a start or a detection, and births that are refused."""

from __future__ import annotations

from dataclasses import dataclass, field

from bayesnet_track.journal.events.reidentification import Recognition, explain_odds
from bayesnet_track.journal.text.wording import decimals, distinct_texts, plural, round_away

MOST_DETECTIONS = 1000
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
        return (
            f"target {self.target} starts as {self.template}, centre {x:.4g}, {y:.4g}, "
            f"{w:.4g} x {h:.4g} px → {active} on"
        )


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
        """`gray_level detected it in 3 of its 4 runs ...  → target 3 is new`."""
        runs = "1 run" if self.looks == 1 else f"its {self.looks} runs"
        seen = f"{self.detector} detected it in {self.seen} of {runs}"
        since = f" since frame {self.first_frame}" if self.first_frame < self.frame else ""
        exists = ""
        if self.existence is not None and self.confirm is not None:
            value, level = distinct_texts(self.existence, self.confirm)
            exists = f", existence {value} ≥ {level}"
        found = f"{seen}{since}, mean score {self.score:.2f}{exists} → target {self.target} is new"
        near = self.nearest
        if near is None:
            return found
        value, level = distinct_texts(near.probability, near.min_probability)
        if near.probability >= near.min_probability:
            return f"{found} (target {near.target} is taken for another detection)"
        found += f": it is target {near.target} with probability {value} < {level} ({explain_odds(near)})"
        if near.contested:
            return found
        turning = round_away(near.probability, decimals(near.probability, near.min_probability), up=False)
        return f"{found}; would have been target {near.target} at min_probability ≤ {turning}"


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
        out = "the rest of the run"
        if self.until is not None:
            waits = plural(self.until - self.frame, "frame")
            out = f"{waits} after {self.times} failures in a row" if self.times > 1 else waits
            out += f", tried again in frame {self.until}"
        return f"detector {self.detector} failed: {self.reason} → paused for {out}"


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
        found = self.used + self.cut
        so_far = f", in {self.frames} frames so far" if self.frames > 1 else ""
        would = f"would all be used at max_count ≥ {found}"
        if found > MOST_DETECTIONS:
            would = f"max_count is at most {MOST_DETECTIONS}"
        used = f"the best {self.used} are used, not {self.cut}{so_far}"
        return f"{self.detector} found {found} → {used}; {would}"


Decisions = TargetStarted
Events = Decisions | CandidateConfirmed | BirthsRefused | DetectorFailed | DetectionsCut
