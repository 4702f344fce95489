"""Events of a target's status: tracking, uncertain or lost, look-alikes, and the guarantee."""

from __future__ import annotations

from dataclasses import dataclass, field

from bayesnet_track.journal.target_net import Cause, FitCause, HiddenCause, ScoreCause, TargetNet
from bayesnet_track.journal.text.wording import (
    cause_text,
    decimals,
    distinct_texts,
    plural,
    round_away,
    show_turn,
)
from bayesnet_track.numerics.records import evolve


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
            return _by_hiding(self.hidden, f"target {self.target} hidden")
        if self.cause is None:
            return f"{self.reason} → {result}" if self.reason else result
        if not lost:
            fits = f", and {self.reason}" if self.reason else ""
            return f"{cause_text(self.cause, '≤')}{fits} → {result}"
        turning = show_turn(self.cause, up=True)
        return f"{cause_text(self.cause, '>')} → {result}; would not have been lost at lost.above ≥ {turning}"

    def change(self, net: TargetNet) -> TargetNet:
        """The net of the target after it."""
        return evolve(net, status=self.status)


@dataclass(frozen=True)
class FoundAgain:
    """The target looks as it did before it was lost: the score is no longer limited.

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
        turning = round_away(self.turning, decimals(self.turning, self.found_fit), up=True)
        otherwise = (
            "at any found_fit"
            if self.turning >= 1.0
            else f"would have stayed missing at found_fit > {turning}"
        )
        return (
            f"target {self.target}, missing since frame {self.since}, recognised {self.moved_px:.3g} px from "
            f"where it was held: {share} of its usual fit ≥ {level}, the last of "
            f"{plural(self.frames, 'frame')}{sure}; {otherwise}"
        )


@dataclass(frozen=True)
class Regained:
    """Agents and verifiers agree on one place: a poor fit to references of before no longer limits the score.

    Attributes:
        frame: frame whose numbers caused it.
        target: target id.
        frames: consecutive frames that showed it.
        score: of the last of them, without its bounds.
        score_level: score that was required at this distance from where the target was held.
        score_above: score that is required at no distance.
        turning_score: largest `score_above` with which all of them would have shown it.
        ud_box: UD in the last of them, as a share of the estimate's area.
        ud_level: largest UD that shows it.
        turning_ud: smallest such level with which all of them would have shown it.
        fit: likelihood of the best hypothesis in the last of them.
        full_fit: fit below which the score was limited.
        missing_since: frame since which the target was missing; None when it was not.
    """

    frame: int
    target: str
    frames: int
    score: float
    score_level: float
    score_above: float
    turning_score: float
    ud_box: float
    ud_level: float
    turning_ud: float
    fit: float
    full_fit: float
    missing_since: int | None = None

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        score, level = distinct_texts(self.score, self.score_level)
        ud, ud_level = distinct_texts(self.ud_box, self.ud_level)
        highest = round_away(self.turning_score, decimals(self.turning_score, self.score_above), up=True)
        lowest = round_away(self.turning_ud, decimals(self.turning_ud, self.ud_level), up=False)
        missing = "" if self.missing_since is None else f", missing since frame {self.missing_since},"
        numbers = f"score without its limits {score} ≥ {level}, UD {ud} × box area ≤ {ud_level}"
        effect = f"its fit {self.fit:.3g} of {self.full_fit:.3g} no longer limits the score"
        return (
            f"agents and verifiers agree on where target {self.target}{missing} is for "
            f"{plural(self.frames, 'frame')}: {numbers} → {effect}; would have stayed so at "
            f"regain.score_above > {highest} or regain.ud_box < {lowest}"
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
        return evolve(net, status="lost")


def _by_fit(cause: FitCause, result: str) -> str:
    fit, level = distinct_texts(cause.fit, cause.level)
    span = f"for {plural(cause.frames, 'frame')}"
    evidence = f"the best hypothesis has a fit of {fit} (1: perfect) < fit_below {level} {span}"
    if cause.turning is None:
        return f"{evidence} → {result}; would have been lost by its UD at any fit_below"
    turning = round_away(cause.turning, decimals(cause.turning, cause.level), up=False)
    return f"{evidence} → {result}; would not have been lost at fit_below ≤ {turning}"


def _by_hiding(cause: HiddenCause, result: str) -> str:
    hidden, level = distinct_texts(cause.hidden, cause.level)
    turning = round_away(cause.hidden, decimals(cause.hidden, cause.level), up=True)
    return (
        f"hidden with probability {hidden} > {level} → {result}; would have stayed at lost_above ≥ {turning}"
    )


def _by_score(event: StatusChanged, cause: ScoreCause) -> str:
    score, level = distinct_texts(cause.score, cause.level)
    span = f"for {plural(cause.frames, 'frame')}"
    evidence = (
        f"{(cause.of or 'score').replace('_', ' ')} {score} {'<' if cause.fell else '≥'} {level} {span}"
    )
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
    return f"{evidence} → target {event.target} {status}; {otherwise}"


@dataclass(frozen=True)
class DistractorSeen:
    """Something else is nearly as likely to be the target: the net may follow either from now on.

    Reported when the doubt begins; a distractor that is seen while it lasts prolongs it.

    Attributes:
        frame: the frame.
        target: target id.
        x: centre of the distractor's best hypothesis, px.
        y: the same, row.
        away_box: how far that is from the most probable hypothesis, roots of the estimate's area.
        behind_nats: how much less likely it is, nats.
        within_nats: difference below which it counts as a distractor.
        fit: how well the best hypothesis of all fits.
        hold: frames for which the score is at most one half, unless motion shows which is followed.
        turning_nats: the largest `behind_nats` of the frames in a row that raised the doubt; None in a
            journal that does not say.
    """

    frame: int
    target: str
    x: float
    y: float
    away_box: float
    behind_nats: float
    within_nats: float
    fit: float
    hold: int
    turning_nats: float | None = field(default=None, metadata={"left_out_when_empty": True})

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        behind, limit = distinct_texts(self.behind_nats, self.within_nats)
        likely = f"only {behind} < {limit} nats less likely than the target"
        if self.behind_nats < 0.0:
            likely = f"{behind.removeprefix('-')} nats more likely than the target"
        turning = self.behind_nats if self.turning_nats is None else self.turning_nats
        level = round_away(turning, decimals(turning, self.within_nats), up=False)
        ignored = f"ignored with within_nats ≤ {level}" if float(level) > 0.0 else "no within_nats ignores it"
        hold = plural(self.hold, "frame")
        return (
            f"look-alike at {self.x:.4g}, {self.y:.4g}, {self.away_box:.2g} box sides away, {likely} → score "
            f"at most 0.5 for {hold}, or until motion shows which is followed; {ignored}"
        )


@dataclass(frozen=True)
class DoubtEnded:
    """Motion shows that it is the target that is followed, not the distractor: the score is not limited.

    Attributes:
        frame: the frame.
        target: target id.
        own_box: how far the estimate is from where the target was heading, roots of its area.
        other_box: the same, from where the distractor was heading.
        nearer: share of `other_box` below which `own_box` has to be.
        left: frames for which the score would have stayed limited.
    """

    frame: int
    target: str
    own_box: float
    other_box: float
    nearer: float
    left: int

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        level = self.nearer * self.other_box
        distance = distinct_texts(self.own_box, level)[0]
        turning = round_away(level, decimals(self.own_box, level), up=True)
        duration = plural(self.left, "frame")
        return (
            f"target is {distance} box sides from where it was heading, and {self.other_box:.3g} from where "
            f"the look-alike was heading → score no longer limited; at {turning} it would have stayed so "
            f"for {duration}"
        )


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
        mean, level = distinct_texts(self.mean, self.above)
        sign = ">" if self.assured else "≤"
        evidence = f"mean score of {plural(self.frames, 'frame')} {mean} {sign} {level}"
        turning = round_away(self.mean, decimals(self.mean, self.above), up=self.assured)
        if self.assured:
            effect = f"target {self.target} may be called tracking again"
            return f"{evidence} → {effect}; not at guarantee.above {turning}"
        return (
            f"{evidence} → target {self.target} at most uncertain, for the guarantee of "
            f"{100 * self.share:.3g} %; would have stayed at guarantee.above < {turning}"
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


@dataclass(frozen=True)
class IdentityDoubtful:
    """Targets came close and parted, and one of them may be another one.

    Attributes:
        frame: frame in which they had been apart for long enough.
        target: target id.
        other: whose identity it may have.
        since: frame in which they came close.
        probability: that it is the other one.
        keeps: that it is itself.
        appearance: what looks told for the identities as they are, against the other ones, nats.
        motion: the same of places and velocities.
        mutual: whether the two would have swapped; else the other one is not there any more.
        refused: others that were close, too, and were not asked about.
    """

    frame: int
    target: str
    other: str
    since: int
    probability: float
    keeps: float
    appearance: float
    motion: float
    mutual: bool = True
    refused: tuple[str, ...] = field(default=(), metadata={"left_out_when_empty": True})

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        reason = f"decided by appearance {self.appearance:+.1f}, motion {self.motion:+.1f} nats"
        if self.mutual:
            text = (
                f"identities {self.target} and {self.other} could be swapped since frame {self.since}, "
                f"probability {self.probability:.2f}; {reason}"
            )
        else:
            text = (
                f"target {self.target} could be {self.other} since frame {self.since}, "
                f"probability {self.probability:.2f}; {reason}"
            )
        if self.refused:
            text += f"; also close, and not asked about: {', '.join(self.refused)}"
        return text
