"""Score of one target in one frame: from what fits, its verifiers and its like, with guarantee and alarm."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import fmean

import numpy as np

from bayesnet_track.adapt.rule_inputs import Measures
from bayesnet_track.engine.filtering import Filtered
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.scoring.rivals import (
    HELD,
    Verification,
    find_distractor,
    follow_distractor,
    with_distractor,
)
from bayesnet_track.engine.scoring.score import (
    SAYS_NOTHING,
    Agreement,
    Place,
    ScoreState,
    Sighting,
    confidences,
    extent_beyond,
    follow_fit,
    most,
    probability,
)
from bayesnet_track.graph.settings.adapt import Regain
from bayesnet_track.graph.settings.scores import Alarm, Guarantee
from bayesnet_track.graph.spec import Distractors, InferenceNode, Logistic
from bayesnet_track.journal.events.beliefs import Reappeared
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.statuses import (
    AlarmEnded,
    AlarmRaised,
    AssuranceChanged,
    DistractorSeen,
    DoubtEnded,
    FoundAgain,
    Regained,
)
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.log_weights import kl
from bayesnet_track.numerics.records import evolve

SHIFT_NATS = 1.0
"""Log odds of being off target above which the alarm's evidence rises: at scores below 0.27."""

MOST_NATS = 1.0
"""What a single frame counts at most, so that one bad frame decides nothing."""


def with_recent(scored: ScoreState, score: float, rule: Guarantee) -> ScoreState:
    """With the score of one frame more."""
    return replace(scored, recent=(*scored.recent, score)[-rule.frames :])


def is_assured(scored: ScoreState, rule: Guarantee | None) -> bool:
    """True where `tracking` may be reported; always without a guarantee, and in the first frame."""
    return rule is None or not scored.recent or fmean(scored.recent) > rule.above


def reported_status(status: str, scored: ScoreState, rule: Guarantee | None) -> str:
    """The status as it is reported: at most uncertain where the guarantee does not hold otherwise."""
    return "uncertain" if status == "tracking" and not is_assured(scored, rule) else status


def means_of(scores: Sequence[float], frames: int) -> Floats:
    """(n,) mean of the last `frames` scores after each of n frames, fewer at the start.

    >>> means_of([0.5, 1.0, 0.0], 2).tolist()
    [0.5, 0.75, 0.5]
    """
    return np.array([fmean(scores[max(0, k + 1 - frames) : k + 1]) for k in range(len(scores))])


def level_afterwards(levels: Sequence[float], means: Floats) -> float:
    """The level of a run that is over: the lowest that is allowed for the share of its frames above.

    `levels` are a guarantee's `afterwards`; `means` (n,) of every frame after the first, 0 where there was no
    target any more.

    >>> level_afterwards([0.2, 0.6], np.array([0.1, 0.5, 0.5, 0.9]))
    0.5
    """
    descending = np.sort(means)[::-1]
    lowest_levels = (
        float(descending[count]) if (count := k * len(descending) // len(levels)) < len(descending) else 0.0
        for k in range(1, len(levels) + 1)
    )  # the lowest level with at most `count` frames above
    return min(max(level, lowest) for level, lowest in zip(levels, lowest_levels, strict=True))


def next_cusum(cusum: float, score: float) -> float:
    """The alarm's evidence C after a frame: max(0, C + clip(log((1 - score) / score) - 1, -1, 1)).

    >>> next_cusum(0.5, 0.0), next_cusum(1.5, 0.9), next_cusum(0.5, 0.9)
    (1.5, 0.5, 0.0)
    """
    odds = math.inf if score <= 0.0 else math.log1p(-score) - math.log(score) if score < 1.0 else -math.inf
    return max(0.0, cusum + min(max(odds - SHIFT_NATS, -MOST_NATS), MOST_NATS))


def e_value(cusum: float, rule: Alarm) -> float:
    """(videos + 1) X / (total + X), X = exp(rise): at most 1 in expectation while the target is held.

    Over a video exchangeable with the calibration videos the largest value has the expectation 1, so that it
    reaches 1 / share with a probability of at most `share`, whatever the dependence of its frames.
    """
    return (rule.videos + 1) / (1.0 + rule.total * math.exp(-cusum))


def with_evidence(scored: ScoreState, score: float, frame: int) -> ScoreState:
    """With the alarm's evidence after a frame."""
    cusum = next_cusum(scored.cusum, score)
    if cusum == 0.0:
        return replace(scored, cusum=0.0, since=None, alarmed=False)
    return replace(scored, cusum=cusum, since=frame if scored.since is None else scored.since)


def judge_alarm(
    previous: ScoreState, scored: ScoreState, rule: Alarm, frame: int, target: str
) -> tuple[ScoreState, AlarmRaised | AlarmEnded | None]:
    """The alarm that is raised, or that ends as its evidence has gone."""
    evidence = e_value(scored.cusum, rule)
    if not scored.alarmed and evidence >= 1.0 / rule.share and scored.since is not None:
        raised = AlarmRaised(frame, target, evidence, rule.share, scored.since, rule.videos)
        return replace(scored, alarmed=True), raised
    return scored, AlarmEnded(frame, target) if previous.alarmed and not scored.alarmed else None


def judge_assurance(
    previous: ScoreState, scored: ScoreState, rule: Guarantee, frame: int, target: str
) -> AssuranceChanged | None:
    """Event for when `tracking` may no longer be said, or may be said again."""
    assured = is_assured(scored, rule)
    if assured == is_assured(previous, rule):
        return None
    return AssuranceChanged(
        frame, target, assured, fmean(scored.recent), rule.above, len(scored.recent), rule.share
    )


@dataclass(frozen=True, eq=False)
class ScoreOutcome:
    """Score of one target in one frame.

    Attributes:
        scored: what the score remembers.
        score: probability of being on target; None where the graph does not say how it comes about.
        bound: the most that the score may be.
        distractor: what looks like the target beside it.
        notices: what guarantee and alarm give to write down.
    """

    scored: ScoreState
    score: float | None = None
    bound: float = 1.0
    distractor: DistractorSeen | None = None
    notices: tuple[Event, ...] = ()


def score_target(work: FrameContext, filtered: Filtered, box: Floats, measures: Measures) -> ScoreOutcome:
    """Score of a target whose estimate is `box` (4,), inside the frame."""
    compiled, scored = work.plate_of(filtered.target), filtered.before.scored
    root = compiled.plate.inference(compiled.plate.root)
    assert root.score is not None
    rule, distractor, ended = root.score.settings, None, None
    unfit = measures.fit < rule.full_fit
    verification = Verification(compiled.verifiers, work.cache, filtered.target, box)
    verified = verification.verify(scored.references, unfit or scored.unfit or not scored.smooth)
    ud_px2 = None if unfit or _is_sought(work, filtered) else measures.ud_px2[compiled.plate.root]
    extras = {**verified.values, **confidences(rule, filtered.step.evidence)}
    extras["border"] = extent_beyond(box, work.frame)
    scored = scored.after(rule, measures, filtered.step, ud_px2, extras)
    if root.distractors is not None:
        scored, distractor, ended = _follow_distractors(
            work, filtered, root.distractors, box, measures, scored
        )
    scored, regained = _follow_agreement(work, filtered, root, box, measures, scored)
    free = root.lost is not None and _is_regained(scored, root.lost.regain)
    bound = most(rule, max(measures.fit, rule.full_fit) if free else measures.fit, scored.doubt)
    if filtered.modes is not None and filtered.modes.hidden is not None:
        bound = min(bound, 1.0 - filtered.modes.hidden)
    score = min(probability(rule, scored.features(rule)), bound)
    regain_event: FoundAgain | None = None
    if root.lost is not None and root.lost.found_fit is not None:
        look = _look(work, filtered, box, score, measures.fit)
        scored, most_now, regain_event = follow_fit(scored, root.lost, look)
        bound = min(bound, most_now)
        score = min(score, bound)
    scored, notices = _follow(root, filtered.before.scored, scored, score, work.frame.index, filtered.target)
    notices = (*notices, *(event for event in (regain_event, regained, ended) if event is not None))
    if score >= HELD and not unfit:
        verified = verification.follow(verified)
    scored, notices = evolve(scored, references=verified.references), (*notices, *verified.failed)
    return ScoreOutcome(scored, score, bound, distractor, notices)


def _is_sought(work: FrameContext, filtered: Filtered) -> bool:
    """True where the target is lost, or found by a search in this frame: its belief is as wide as that."""
    frame, target = work.frame.index, filtered.target
    events = (report(frame, target) for report in filtered.step.reports)
    return work.net.targets[target].status == "lost" or any(isinstance(event, Reappeared) for event in events)


def _follow_distractors(
    work: FrameContext,
    filtered: Filtered,
    rule: Distractors,
    box: Floats,
    measures: Measures,
    scored: ScoreState,
) -> tuple[ScoreState, DistractorSeen | None, DoubtEnded | None]:
    """With what looks like the target beside it, or the end of the doubt that this raised."""
    frame, target = work.frame.index, filtered.target
    able = work.plate_of(target).cues.keys() - work.net.targets[target].quarantined
    if not able <= measures.kl.keys():  # it takes all of them to tell things apart
        return scored, None, None
    distractor = find_distractor(rule, frame, target, filtered.step, measures)
    if measures.fit < rule.fit or _is_sought(work, filtered):  # its estimate shows no motion
        return with_distractor(scored, distractor, rule.frames), distractor, None
    place, side = Place(frame, float(box[0]), float(box[1])), float(np.sqrt(max(measures.area_px2, 1.0)))
    scored, ended = follow_distractor(scored, distractor, rule.frames, target, place, side)
    return scored, distractor, ended


def _look(work: FrameContext, filtered: Filtered, box: Floats, score: float, fit: float) -> Sighting:
    """Appearance of a target whose estimate is `box` (4,)."""
    target, (x, y, w, h) = filtered.target, box.tolist()
    surprise = kl(filtered.step.support.weights.log, filtered.step.prior.log)
    status = work.net.targets[target].status
    return Sighting(work.frame.index, target, status, score, fit, surprise, x, y, float(np.sqrt(w * h)))


def _follow(
    root: InferenceNode, previous: ScoreState, scored: ScoreState, score: float, frame: int, target: str
) -> tuple[ScoreState, tuple[Event, ...]]:
    """Memory of guarantee and alarm after a frame, and their events."""
    notices: list[Event | None] = []
    if root.guarantee is not None:
        scored = with_recent(scored, score, root.guarantee)
        notices.append(judge_assurance(previous, scored, root.guarantee, frame, target))
    if root.alarm is not None:
        scored, notice = judge_alarm(previous, with_evidence(scored, score, frame), root.alarm, frame, target)
        notices.append(notice)
    return scored, tuple(notice for notice in notices if notice is not None)


# ------------------------------------------------------------------------------------ the way back
#
# After an event the references are those of before, so that the target fits worse than usual. The score is
# bounded by the fit then, references do not learn, and the fit stays poor. What agents and verifiers agree on
# for some frames ends that: the bound is gone, the target is missing no longer, and references learn again.

FAR_BOX = 1.0
"""Box sides beyond the first from which on distance asks for no more: the root of the level counts there."""

LEAST_FIT = 0.2
"""Share of `full_fit` below which nothing is there that could be agreed on."""

STEADY_BOX = 0.5
"""Box sides by which the estimate may move from one of these frames to the next."""


@dataclass(frozen=True)
class Localized:
    """A sighting, and how sure the belief is of the place.

    Attributes:
        look: its appearance; its score does not count here.
        ud_box: UD as a share of the estimate's area.
        full_fit: fit below which the score is bounded.
    """

    look: Sighting
    ud_box: float
    full_fit: float


def _is_regained(scored: ScoreState, rule: Regain | None) -> bool:
    """True while the agreement has lasted long enough, so that the fit does not bound the score."""
    return rule is not None and scored.agreement is not None and scored.agreement.frames >= rule.frames


def _unbounded_score(logistic: Logistic, scored: ScoreState, ud_box: float) -> float:
    """The score without its bounds, by the UD of this frame: none of it is kept from before the event."""
    features = scored.features(logistic)
    return probability(logistic, {**features, "log_ud_box": math.log(max(ud_box, 1e-9))})


def follow_agreement(
    scored: ScoreState, rule: Regain, logistic: Logistic, localized: Localized
) -> tuple[ScoreState, Regained | None]:
    """Memory with the agreement of one frame more, and the event of the frame from which on it counts.

    It begins in a frame in which the target is not tracked, and lasts for as long as agents and verifiers
    agree. More than one box side from where a missing target was held a higher score is asked for. Nothing is
    agreed on where the frame shows nothing, or while a look-alike limits the score.
    """
    look, agreement = localized.look, scored.agreement
    share = 1.0 / (1.0 + min(max(_moved_box(scored, look) - 1.0, 0.0), FAR_BOX))
    score, level = _unbounded_score(logistic, scored, localized.ud_box), rule.score_above**share
    shows = look.surprise >= SAYS_NOTHING and look.fit >= LEAST_FIT * localized.full_fit and not scored.doubt
    agrees = shows and score >= level and localized.ud_box <= rule.ud_box
    if not agrees or (agreement is None and look.status == "tracking"):
        return (scored if agreement is None else evolve(scored, agreement=None)), None
    turning, ud_box, frames = score ** (1.0 / share), localized.ud_box, 1
    if (
        agreement is not None
        and math.hypot(look.x - agreement.x, look.y - agreement.y) <= STEADY_BOX * look.side_px
    ):
        turning, ud_box = min(turning, agreement.score_above), max(ud_box, agreement.ud_box)
        frames = agreement.frames + 1
    scored = evolve(scored, agreement=Agreement(look.x, look.y, frames, turning, ud_box))
    if frames < rule.frames:
        return scored, None
    event = None
    if frames == rule.frames and (look.fit < localized.full_fit or scored.missing is not None):
        missing = scored.missing
        levels = (score, level, rule.score_above, turning, localized.ud_box, rule.ud_box, ud_box)
        event = Regained(look.frame, look.target, frames, *levels, look.fit, localized.full_fit, missing)
    return evolve(scored, missing=None, again=(), low=0), event


def _moved_box(scored: ScoreState, look: Sighting) -> float:
    """Distance from where a missing target was held, box sides; 0 of one that is not missing."""
    if scored.missing is None or not scored.place:
        return 0.0
    return math.hypot(look.x - scored.place[0], look.y - scored.place[1]) / look.side_px


def _follow_agreement(
    work: FrameContext,
    filtered: Filtered,
    root: InferenceNode,
    box: Floats,
    measures: Measures,
    scored: ScoreState,
) -> tuple[ScoreState, Regained | None]:
    """With the agreement of agents and verifiers on where the target is, where the graph asks for it."""
    if root.score is None or root.lost is None or root.lost.regain is None:
        return scored, None
    rule, ud_px2 = root.score.settings, measures.ud_px2[filtered.plan.root]
    look = _look(work, filtered, box, 0.0, measures.fit)
    localized = Localized(look, ud_px2 / max(measures.area_px2, 1.0), rule.full_fit)
    return follow_agreement(scored, root.lost.regain, rule, localized)
