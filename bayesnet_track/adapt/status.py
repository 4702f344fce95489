"""Whether a target is tracked, uncertain or lost: by UD and fit, or by a score that is a probability."""

from __future__ import annotations

import math
from dataclasses import dataclass

from bayesnet_track.adapt.memory import FOUND, LOST, SEEN, UNFIT, UNSURE, USUAL, RuleMemory
from bayesnet_track.adapt.situation import Situation, read_ud
from bayesnet_track.graph.spec import Lost
from bayesnet_track.journal.events.statuses import StatusChanged
from bayesnet_track.journal.net.causes import Cause, FitCause, ScoreCause
from bayesnet_track.journal.net.net import Decision


def judge_status(now: Situation, memory: RuleMemory, decisions: list[Decision]) -> None:
    """Change the status after as many frames as the rule says.

    A target that probably cannot be seen, by its modes, is lost at once: their memory is in that probability.
    """
    rule = now.plate.inference(now.plate.root).lost or USUAL
    if now.hiding is not None and now.hiding.hidden > now.hiding.level:
        if now.net.status != "lost":
            decisions.append(StatusChanged(now.frame, now.target, "lost", hidden=now.hiding))
    elif now.existence is not None and rule.existence_below is not None:
        scale = Scale("existence", now.existence, rule.existence_below)
        _by_score(now, memory, rule, scale, decisions)
    elif now.score is not None and rule.score_below is not None:
        _by_score(now, memory, rule, Scale("", now.score, rule.score_below), decisions)
    else:
        _by_ud(now, memory, rule, decisions)


@dataclass(frozen=True)
class Scale:
    """A probability that a status is judged by.

    Attributes:
        of: what it is, as `ScoreCause.of`.
        score: its value.
        low: the target is lost below it.
    """

    of: str
    score: float
    low: float


def _by_score(
    now: Situation, memory: RuleMemory, rule: Lost, scale: Scale, decisions: list[Decision]
) -> None:
    """tracking, uncertain and lost by two levels of the score, each passed for `rule.frames` frames.

    Without `uncertain_below` there are only tracking and lost.
    """
    score, low, low_key = scale.score, scale.low, f"{scale.of or 'score'}_below"
    high, high_key = low, low_key
    if rule.uncertain_below is not None:
        high, high_key = rule.uncertain_below, "uncertain_below"
    before, status, level, key, streak = now.net.status, now.net.status, low, low_key, LOST
    if before != "lost" and memory.count(LOST) >= rule.frames:
        status = "lost"
    elif before == "tracking" and low < high and memory.count(UNSURE) >= rule.frames:
        status, level, key, streak = "uncertain", high, high_key, UNSURE
    elif before != "tracking" and memory.count(FOUND) >= rule.frames:
        status, level, key, streak = "tracking", high, high_key, FOUND
    elif before == "lost" and low < high and memory.count(SEEN) >= rule.frames:
        status, streak = "uncertain", SEEN
    if status != before:
        fell = (before, status) in (("tracking", "uncertain"), ("tracking", "lost"), ("uncertain", "lost"))
        turning = (max if fell else min)(memory.streak_values(streak))
        cause = ScoreCause(level, score, rule.frames, turning, fell, scale.of, key, before)
        decisions.append(StatusChanged(now.frame, now.target, status, cause))


def _by_ud(now: Situation, memory: RuleMemory, rule: Lost, decisions: list[Decision]) -> None:
    """tracking <-> lost by UD and fit."""
    reading = read_ud(now, memory, now.plate.root, rule.above)
    too_wide = reading is not None and reading.value > reading.level
    status, turning = now.net.status, math.inf
    if status != "lost" and memory.count(LOST) >= rule.frames:
        status, turning = "lost", min(memory.streak_values(LOST)) if too_wide else math.inf
    elif status == "lost" and memory.count(FOUND) >= rule.frames:
        status, turning = "tracking", max(memory.streak_values(FOUND))
    if status != now.net.status:
        by_ud = reading is not None and turning < math.inf
        cause: Cause | FitCause | None = None
        reason = ""
        if by_ud and reading is not None:
            cause = reading.cause(rule.frames, turning)
        elif blind := _blind(now):
            reason = blind
        elif status == "lost":
            best = max(memory.streak_values(UNFIT))
            cause = FitCause(rule.fit_below, now.measures.fit, rule.frames, best if best >= 0.0 else None)
        if status == "tracking" and now.measures.fit >= rule.fit_below and not reason:
            fitting = f"{now.measures.fit:.3g} of a perfect match ≥ fit_below {rule.fit_below:.3g}"
            reason = f"the best hypothesis has a likelihood of {fitting}"
        decisions.append(StatusChanged(now.frame, now.target, status, cause, reason))


def _blind(now: Situation) -> str:
    """Why nothing can fit, where nobody looked; else empty."""
    if not now.net.active:
        return "no agent is active, so the belief is prediction only"
    return "no active agent saw it" if now.net.active <= set(now.measures.silent) else ""
