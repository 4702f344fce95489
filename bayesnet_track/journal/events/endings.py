"""Nets that end: their target was lost or not detected, or two nets held one target."""

from __future__ import annotations

from dataclasses import dataclass, field

from bayesnet_track.journal.text.wording import decimals, distinct_texts, plural, round_away


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
        existence: probability that it exists, where that is the reason.
        end: the rule's least probability.
    """

    frame: int
    target: str
    reason: str
    frames: int
    limit: int
    remembered: bool
    existence: float | None = field(default=None, metadata={"left_out_when_empty": True})
    end: float | None = field(default=None, metadata={"left_out_when_empty": True})

    def describe(self) -> str:
        """`lost for 30 frames → target 3 ends`."""
        kept = ", remembered" if self.remembered else ""
        if self.existence is not None and self.end is not None:
            value, level = distinct_texts(self.existence, self.end)
            turning = round_away(self.existence, decimals(self.existence, self.end), up=False)
            unseen = f" after {plural(self.frames, 'frame')} without a detection" if self.frames else ""
            return (
                f"existence {value} < {level}{unseen} → target {self.target} ends{kept}; "
                f"would have continued at existence.end ≤ {turning}"
            )
        how = "lost" if self.reason == "lost" else "not detected"
        key = "lost_frames" if self.reason == "lost" else "unseen_frames"
        return (
            f"{how} for {plural(self.frames, 'frame')} → target {self.target} ends{kept}; "
            f"would have continued at {key} ≥ {self.frames + 1}"
        )


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


Decisions = TargetDied | DuplicateEnded
