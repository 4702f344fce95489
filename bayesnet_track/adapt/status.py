"""Whether a target is tracked, uncertain or lost: by UD and fit, or by a score that is a probability."""

from __future__ import annotations

import math
from dataclasses import dataclass

from bayesnet_track.adapt.memory import NO_STREAK, Memory
from bayesnet_track.adapt.situation import Situation, read_ud
from bayesnet_track.graph.spec import Lost
from bayesnet_track.journal.events.statuses import StatusChanged
from bayesnet_track.journal.net.causes import Cause, FitCause, ScoreCause
from bayesnet_track.journal.net.net import Decision
from bayesnet_track.numerics.records import changed

USUAL = Lost()


def judge_status(now: Situation, memory: Memory, decisions: list[Decision]) -> Memory:
    """Change the status after as many frames as the rule says; what is remembered of it.

    A target that probably cannot be seen, by its modes, is lost at once: their memory is in that probability.
    """
    rule = now.plate.inference(now.plate.root).lost or USUAL
    if now.hiding is not None and now.hiding.hidden > now.hiding.level:
        if now.net.status != "lost":
            decisions.append(StatusChanged(now.frame, now.target, "lost", hidden=now.hiding))
        return changed(memory, lost=NO_STREAK, seen=NO_STREAK, unsure=NO_STREAK, found=NO_STREAK)
    if now.existence is not None and rule.existence_below is not None:
        return _by_score(
            now, memory, rule, Scale("existence", now.existence, rule.existence_below), decisions
        )
    if now.score is not None and rule.score_below is not None:
        return _by_score(now, memory, rule, Scale("", now.score, rule.score_below), decisions)
    return _by_ud(now, memory, rule, decisions)


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


def _by_score(now: Situation, memory: Memory, rule: Lost, scale: Scale, decisions: list[Decision]) -> Memory:
    """tracking, uncertain and lost by two levels of the score, each passed for `rule.frames` frames.

    Without `uncertain_below` there are only tracking and lost.
    """
    score, low, low_key = scale.score, scale.low, f"{scale.of or 'score'}_below"
    high, high_key = low, low_key
    if rule.uncertain_below is not None:
        high, high_key = rule.uncertain_below, "uncertain_below"
    memory = changed(
        memory,
        lost=memory.lost.then(score < low, score, rule.frames),
        seen=memory.seen.then(score >= low, score, rule.frames),
        unsure=memory.unsure.then(score < high, score, rule.frames),
        found=memory.found.then(score >= high, score, rule.frames),
    )
    before, status, level, key, values = now.net.status, now.net.status, low, low_key, memory.lost.values
    if before != "lost" and memory.lost.count >= rule.frames:
        status = "lost"
    elif before == "tracking" and low < high and memory.unsure.count >= rule.frames:
        status, level, key, values = "uncertain", high, high_key, memory.unsure.values
    elif before != "tracking" and memory.found.count >= rule.frames:
        status, level, key, values = "tracking", high, high_key, memory.found.values
    elif before == "lost" and low < high and memory.seen.count >= rule.frames:
        status, values = "uncertain", memory.seen.values
    if status != before:
        fell = (before, status) in (("tracking", "uncertain"), ("tracking", "lost"), ("uncertain", "lost"))
        turning = max(values) if fell else min(values)
        cause = ScoreCause(level, score, rule.frames, turning, fell, scale.of, key, before)
        decisions.append(StatusChanged(now.frame, now.target, status, cause))
    return memory


def _by_ud(now: Situation, memory: Memory, rule: Lost, decisions: list[Decision]) -> Memory:
    """tracking <-> lost by UD and fit.

    That nothing fits is no reason while half of the target is known to be hidden, nor where its modes say
    whether it is; that UD is high is one.
    """
    reading = read_ud(now, memory, now.plate.root, rule.above)
    too_wide = reading is not None and reading.value > reading.level
    fits = now.measures.fit >= rule.fit_below or now.hidden >= 0.5 or now.hiding is not None
    value = 0.0 if reading is None else reading.value
    # On a frame on which nothing fits, no level of UD would have kept the target from looking lost.
    lost = memory.lost.then(too_wide or not fits, value if fits else math.inf, rule.frames)
    fit = -math.inf if too_wide else now.measures.fit
    unfit = memory.unfit.then(too_wide or not fits, fit, rule.frames)
    found = memory.found.then(fits and not too_wide, value, rule.frames)
    status, turning = now.net.status, math.inf
    if status != "lost" and lost.count >= rule.frames:
        status, turning = "lost", min(lost.values) if too_wide else math.inf
    elif status == "lost" and found.count >= rule.frames:
        status, turning = "tracking", max(found.values)
    if status != now.net.status:
        by_ud = reading is not None and turning < math.inf
        cause: Cause | FitCause | None = None
        reason = ""
        if by_ud and reading is not None:
            cause = reading.cause(rule.frames, turning)
        elif blind := _blind(now):
            reason = blind
        elif status == "lost":
            best = max(unfit.values)
            cause = FitCause(rule.fit_below, now.measures.fit, rule.frames, best if best >= 0.0 else None)
        if status == "tracking" and now.measures.fit >= rule.fit_below and not reason:
            fitting = f"{now.measures.fit:.3g} of a perfect match ≥ fit_below {rule.fit_below:.3g}"
            reason = f"the best hypothesis has a likelihood of {fitting}"
        decisions.append(StatusChanged(now.frame, now.target, status, cause, reason))
    return changed(memory, lost=lost, found=found, unfit=unfit)


def _blind(now: Situation) -> str:
    """Why nothing can fit, where nobody looked; else empty."""
    if not now.net.active:
        return "no agent is active, so the belief is prediction only"
    return "no active agent saw it" if now.net.active <= set(now.measures.silent) else ""
