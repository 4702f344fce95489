"""What is said of a target: tracking, uncertain or lost."""

from __future__ import annotations

from dataclasses import dataclass, field

from bayesnet_track.journal.net.causes import Cause, FitCause, HiddenCause, ScoreCause
from bayesnet_track.journal.net.target_net import TargetNet
from bayesnet_track.journal.text.wording import decimals, distinct_texts, held, plural, round_away, show_turn
from bayesnet_track.numerics.records import changed


@dataclass(frozen=True)
class StatusChanged:
    """The status of a target changed: tracking, uncertain or lost (the net stays as it is).

    Attributes:
        frame: frame whose numbers caused it.
        target: target id.
        status: tracking, uncertain or lost, from now on.
        cause: the numbers; None when every agent is off, or none saw it.
        reason: why, when there is no cause; what else had to hold when it was found again.
        hidden: why, when it was lost because it is probably hidden; left out otherwise.
    """

    frame: int
    target: str
    status: str
    cause: Cause | ScoreCause | FitCause | None = None
    reason: str = ""
    hidden: HiddenCause | None = field(default=None, metadata={"left_out_when_empty": True})

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        lost = self.status == "lost"
        result = f"target {self.target} {'lost' if lost else 'found again'}"
        if isinstance(self.cause, ScoreCause):
            return _by_score(self, self.cause)
        if isinstance(self.cause, FitCause):
            return _by_fit(self.cause, result)
        if self.hidden is not None:
            return _by_hiding(self.hidden, result)
        if self.cause is None:
            return f"{self.reason} → {result}" if self.reason else result
        if not lost:
            fits = f", and {self.reason}" if self.reason else ""
            return f"{held(self.cause, '≤')}{fits} → {result}"
        turning = show_turn(self.cause, up=True)
        return f"{held(self.cause, '>')} → {result}; would not have been lost at lost.above ≥ {turning}"

    def change(self, net: TargetNet) -> TargetNet:
        """The net of the target after it."""
        return changed(net, status=self.status)


@dataclass(frozen=True)
class FoundAgain:
    """What is seen fits as the target did before it was lost: the score is no longer limited.

    Attributes:
        frame: frame whose numbers caused it.
        target: target id.
        share: likelihood of the best hypothesis as a share of what was usual while it was held.
        level: share that was required at this distance from where it was held.
        found_fit: share that is required at no distance.
        frames: consecutive frames that showed it.
        turning: largest `found_fit` with which all of them would have done so; 1 where any would.
        since: frame since which it was missing.
        moved_px: how far it is from where it was held last.
        score: of the last of these frames; None where it did not count.
        score_level: score that was required at this distance.
    """

    frame: int
    target: str
    share: float
    level: float
    found_fit: float
    frames: int
    turning: float
    since: int
    moved_px: float
    score: float | None = None
    score_level: float | None = None

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        share, level = distinct_texts(self.share, self.level)
        sure = ""
        if self.score is not None and self.score_level is not None:
            sure = ", score {} ≥ {}".format(*distinct_texts(self.score, self.score_level))
        at = round_away(self.turning, decimals(self.turning, self.found_fit), up=True)
        otherwise = (
            "at any found_fit" if self.turning >= 1.0 else f"would have stayed missing at found_fit > {at}"
        )
        return (
            f"target {self.target}, missing since frame {self.since}, recognised {self.moved_px:.3g} px from "
            f"where it was held: {share} of its usual fit ≥ {level}, the last of "
            f"{plural(self.frames, 'frame')}{sure}; {otherwise}"
        )


@dataclass(frozen=True)
class SceneCut:
    """A frame shows another scene than the one before it: the target is lost from this frame on.

    Attributes:
        frame: first frame of the new scene.
        target: target id.
        distance: of the frame from the last one that shows a scene: the root of `colors` times `structure`.
        level: distance above which the scene was cut, `scene_cut`.
        colors: Hellinger distance of their colours, 0 to 1.
        structure: 1 - correlation of their gray levels at the best shift, 0 to 1.
    """

    frame: int
    target: str
    distance: float
    level: float
    colors: float
    structure: float

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        distance, level = distinct_texts(self.distance, self.level)
        turning = round_away(self.distance, decimals(self.distance, self.level), up=True)
        return (
            f"scene cut: distance from the scene before {distance} > {level} (colours {self.colors:.2g}, "
            f"structure {self.structure:.2g}) → target {self.target} lost; would have been ignored at "
            f"scene_cut ≥ {turning}"
        )

    def change(self, net: TargetNet) -> TargetNet:
        """The net of the target after it."""
        return changed(net, status="lost")


Decisions = StatusChanged | SceneCut
Events = Decisions | FoundAgain


def _by_fit(cause: FitCause, result: str) -> str:
    fit, level = distinct_texts(cause.fit, cause.level)
    span = f"for {plural(cause.frames, 'frame')}"
    found = f"the best hypothesis has a likelihood of {fit} of a perfect match < fit_below {level} {span}"
    if cause.turning is None:
        return f"{found} → {result}; would have been lost by its UD at any fit_below"
    turning = round_away(cause.turning, decimals(cause.turning, cause.level), up=False)
    return f"{found} → {result}; would not have been lost at fit_below ≤ {turning}"


def _by_hiding(cause: HiddenCause, result: str) -> str:
    hidden, level = distinct_texts(cause.hidden, cause.level)
    turning = round_away(cause.hidden, decimals(cause.hidden, cause.level), up=True)
    return (
        f"hidden with probability {hidden} > {level} → {result}; would have stayed at lost_above ≥ {turning}"
    )


def _by_score(event: StatusChanged, cause: ScoreCause) -> str:
    score, level = distinct_texts(cause.score, cause.level)
    span = f"for {plural(cause.frames, 'frame')}"
    found = f"{cause.of or 'score'} {score} {'<' if cause.fell else '≥'} {level} {span}"
    turning = round_away(cause.turning, decimals(cause.turning, cause.level), up=not cause.fell)
    key = f"lost.{cause.key}" if cause.key else "a threshold"
    status = event.status
    if status == "tracking":
        status = "tracked again" if cause.before == "uncertain" else "found again"
    if not cause.fell:
        lowest = ", the lowest of these scores" if cause.frames > 1 else ""
        leaps = cause.before == "lost" and event.status == "tracking" and cause.key == "uncertain_below"
        instead = "been uncertain" if leaps else f"stayed {cause.before or 'as it was'}"
        otherwise = f"would have {instead} at {key} > {turning}{lowest}"
    elif event.status == "lost":
        otherwise = f"would not have been lost at {key} ≤ {turning}"
    else:
        otherwise = f"would have stayed tracked at {key} ≤ {turning}"
    return f"{found} → target {event.target} {status}; {otherwise}"
