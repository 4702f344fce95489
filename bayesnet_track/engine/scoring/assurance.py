"""What the score is followed by over frames: whether the guarantee lets `tracking` be said, and the alarm."""

from __future__ import annotations

import math
from dataclasses import replace
from statistics import fmean

from bayesnet_track.engine.scoring.score import Scored
from bayesnet_track.graph.settings.scores import Alarm, Guarantee
from bayesnet_track.journal.events.guarantees import AlarmEnded, AlarmRaised, AssuranceChanged

SHIFT_NATS = 1.0
"""Log odds of being off target above which the alarm's evidence rises: at scores below 0.27."""

MOST_NATS = 1.0
"""What a single frame counts at most, so that one bad frame decides nothing."""


def with_recent(scored: Scored, score: float, rule: Guarantee) -> Scored:
    """With the score of one frame more."""
    return replace(scored, recent=(*scored.recent, score)[-rule.frames :])


def is_assured(scored: Scored, rule: Guarantee | None) -> bool:
    """Whether `tracking` may be said; always without a guarantee, and in the first frame."""
    return rule is None or not scored.recent or fmean(scored.recent) > rule.above


def said_status(status: str, scored: Scored, rule: Guarantee | None) -> str:
    """The status as it is reported: at most uncertain where the guarantee does not hold otherwise."""
    return "uncertain" if status == "tracking" and not is_assured(scored, rule) else status


def next_rise(rise: float, score: float) -> float:
    """The alarm's evidence C after a frame: max(0, C + clip(log((1 - score) / score) - 1, -1, 1)).

    >>> next_rise(0.5, 0.0), next_rise(1.5, 0.9), next_rise(0.5, 0.9)
    (1.5, 0.5, 0.0)
    """
    odds = math.inf if score <= 0.0 else math.log1p(-score) - math.log(score) if score < 1.0 else -math.inf
    return max(0.0, rise + min(max(odds - SHIFT_NATS, -MOST_NATS), MOST_NATS))


def e_value(rise: float, rule: Alarm) -> float:
    """(videos + 1) X / (total + X), X = exp(rise): at most 1 in expectation while the target is held.

    Over a video exchangeable with the calibration videos the largest value has the expectation 1, so that it
    reaches 1 / share with a probability of at most `share`, whatever the dependence of its frames.
    """
    return (rule.videos + 1) / (1.0 + rule.total * math.exp(-rise))


def with_evidence(scored: Scored, score: float, frame: int) -> Scored:
    """With the alarm's evidence after a frame."""
    rise = next_rise(scored.rise, score)
    if rise == 0.0:
        return replace(scored, rise=0.0, since=None, alarmed=False)
    return replace(scored, rise=rise, since=frame if scored.since is None else scored.since)


def judge_alarm(
    before: Scored, scored: Scored, rule: Alarm, frame: int, target: str
) -> tuple[Scored, AlarmRaised | AlarmEnded | None]:
    """Whether the alarm is raised, or ends as its evidence has gone."""
    found = e_value(scored.rise, rule)
    if not scored.alarmed and found >= 1.0 / rule.share and scored.since is not None:
        raised = AlarmRaised(frame, target, found, rule.share, scored.since, rule.videos)
        return replace(scored, alarmed=True), raised
    return scored, AlarmEnded(frame, target) if before.alarmed and not scored.alarmed else None


def judge_assurance(
    before: Scored, scored: Scored, rule: Guarantee, frame: int, target: str
) -> AssuranceChanged | None:
    """What is written down when `tracking` may no longer be said, or may be said again."""
    now = is_assured(scored, rule)
    if now == is_assured(before, rule):
        return None
    return AssuranceChanged(
        frame, target, now, fmean(scored.recent), rule.above, len(scored.recent), rule.share
    )
