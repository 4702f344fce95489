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


@dataclass(frozen=True)
class AlarmEnded:
    """The evidence that the target is not held is gone.

    Attributes:
        frame: frame whose score caused it.
        target: target id.
    """

    frame: int
    target: str


Events = AssuranceChanged | AlarmRaised | AlarmEnded


def describe(event: Events) -> str:
    """The sentence of an event, without its frame."""
    if isinstance(event, AlarmEnded):
        return f"scores are high again → alarm for target {event.target} ends"
    if isinstance(event, AlarmRaised):
        return _raised(event)
    return _assurance(event)


def _raised(event: AlarmRaised) -> str:
    return (
        f"e-value {event.e_value:.3g} ≥ {1.0 / event.share:.3g}, scores low since frame {event.since} → "
        f"alarm: target {event.target} is no longer held; false in at most {100 * event.share:.3g} % of "
        f"videos like the {event.videos} calibrated on"
    )


def _assurance(event: AssuranceChanged) -> str:
    mean, above = distinct_texts(event.mean, event.above)
    sign = ">" if event.assured else "≤"
    found = f"mean score of {plural(event.frames, 'frame')} {mean} {sign} {above}"
    turning = round_away(event.mean, decimals(event.mean, event.above), up=event.assured)
    if event.assured:
        return (
            f"{found} → target {event.target} may be called tracking again; not at guarantee.above {turning}"
        )
    return (
        f"{found} → target {event.target} at most uncertain, for the guarantee of {100 * event.share:.3g} %; "
        f"would have stayed at guarantee.above {turning}"
    )
