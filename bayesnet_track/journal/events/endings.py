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
        kept = ", remembered" if self.remembered else ""
        if self.reason == "existence" and self.existence is not None and self.end is not None:
            value, level = distinct_texts(self.existence, self.end)
            unseen = f" after {plural(self.frames, 'frame')} without a detection" if self.frames else ""
            why = f"existence {value} < {level}{unseen}"
        else:
            how = "lost" if self.reason == "lost" else "not detected"
            why = f"{how} for {plural(self.frames, 'frame')}"
        return (
            f"{why} → target {self.target} ends{kept}; would have continued at {' and '.join(self._needs())}"
        )

    def _needs(self) -> list[str]:
        """What all would have had to be otherwise: of several rules that hold, each would have ended it."""
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


Decisions = TargetDied | DuplicateEnded
