"""What is promised of new videos: the guarantee withholds the status tracking, and the alarm is raised."""

from __future__ import annotations

from dataclasses import dataclass

from bayesnet_track.journal.text.wording import decimals, distinct_texts, plural, round_away


@dataclass(frozen=True)
class AssuranceChanged:
    """From now on the status is at most uncertain, or may be tracking again, as `guarantee` asks.

    Attributes:
        frame: frame whose numbers caused it.
        target: target id.
        assured: whether the status may be tracking.
        mean: mean score of the last frames.
        above: level that it has to exceed.
        frames: of how many frames the mean is.
        share: share of frames, on average over videos, that may be called tracking while off target.
    """

    frame: int
    target: str
    assured: bool
    mean: float
    above: float
    frames: int
    share: float

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        mean, above = distinct_texts(self.mean, self.above)
        sign = ">" if self.assured else "≤"
        found = f"mean score of {plural(self.frames, 'frame')} {mean} {sign} {above}"
        turning = round_away(self.mean, decimals(self.mean, self.above), up=self.assured)
        if self.assured:
            again = f"target {self.target} may be called tracking again"
            return f"{found} → {again}; not at guarantee.above {turning}"
        return (
            f"{found} → target {self.target} at most uncertain, for the guarantee of {100 * self.share:.3g} "
            f"%; would have stayed at guarantee.above < {turning}"
        )


@dataclass(frozen=True)
class AlarmRaised:
    """The evidence that the target is not held has become too large to be chance.

    Attributes:
        frame: frame whose score caused it.
        target: target id.
        e_value: the evidence: over a whole video in which the target is held, its largest value has an
            expectation of 1 at most.
        share: probability of a false alarm in a whole video; it is raised at 1 / share.
        since: frame since which the scores were mostly low.
        videos: videos that calibrated it.
    """

    frame: int
    target: str
    e_value: float
    share: float
    since: int
    videos: int

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        return (
            f"e-value {self.e_value:.3g} ≥ {1.0 / self.share:.3g}, scores low since frame {self.since} → "
            f"alarm: target {self.target} is no longer held; false in at most {100 * self.share:.3g} % of "
            f"videos like the {self.videos} calibrated on"
        )


@dataclass(frozen=True)
class AlarmEnded:
    """The evidence that the target is not held is gone.

    Attributes:
        frame: frame whose score caused it.
        target: target id.
    """

    frame: int
    target: str

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        return f"scores are high again → alarm for target {self.target} ends"


Events = AssuranceChanged | AlarmRaised | AlarmEnded
