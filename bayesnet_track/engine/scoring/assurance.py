"""What the score is followed by over frames: whether the guarantee lets `tracking` be said, and the alarm."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from statistics import fmean

import numpy as np

from bayesnet_track.engine.scoring.score import Scored
from bayesnet_track.graph.settings.scores import Alarm, Guarantee
from bayesnet_track.journal.events.statuses import AlarmEnded, AlarmRaised, AssuranceChanged
from bayesnet_track.numerics.arrays import Floats

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
    above = np.sort(means)[::-1]
    kept = (
        float(above[count]) if (count := k * len(above) // len(levels)) < len(above) else 0.0
        for k in range(1, len(levels) + 1)
    )  # the lowest level with at most `count` frames above
    return min(max(level, lowest) for level, lowest in zip(levels, kept, strict=True))


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
