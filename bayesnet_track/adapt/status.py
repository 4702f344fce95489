"""Rules beside those of UD: the status of a target, agents that fail or rest, and agents on call."""

from __future__ import annotations

import math
from dataclasses import dataclass

from bayesnet_track.adapt.memory import FOUND, LOST, SEEN, UNFIT, UNSURE, RuleMemory
from bayesnet_track.adapt.rule_inputs import RuleInputs, read_ud
from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.graph.settings.adapt import OnCall
from bayesnet_track.graph.spec import Lost
from bayesnet_track.journal.events.faults import Quarantined
from bayesnet_track.journal.events.statuses import StatusChanged
from bayesnet_track.journal.net import Decision
from bayesnet_track.journal.target_net import Cause, Fault, FitCause, ScoreCause, TargetNet

FIRST_WAIT = 10
"""Frames for which an agent is out at its first failure."""

LONGEST_WAIT = 1280
"""Frames beyond which the time does not double any more."""

STEADY = 10
"""An agent that works so many times as long as it was out has not failed in a row."""


def quarantine(net: TargetNet, frame: int, target: str, agent: str, reason: str) -> Quarantined:
    """The decision that an agent which failed in `frame` is out, and for how long.

    >>> first = quarantine(TargetNet("plate", frozenset("a")), 5, "1", "a", "raised")
    >>> first.until, first.times
    (15, 1)
    """
    next_frame, times = next_try(frame, net.faults.get(agent))
    return Quarantined(frame, target, agent, reason, next_frame, times)


def next_try(frame: int, fault: Fault | None) -> tuple[int, int]:
    """Frame in which what failed in `frame` is tried again, and how many times in a row it has failed.

    >>> next_try(15, Fault(1, 5, 15, True)), next_try(200, Fault(1, 5, 15, True))
    ((35, 2), (210, 1))
    """
    times = 1
    if fault is not None and fault.until is not None:
        worked, waited = frame - fault.until, fault.until - fault.frame
        times = fault.times + 1 if worked < STEADY * waited else 1
    return frame + min(FIRST_WAIT * 2 ** min(times - 1, 20), LONGEST_WAIT), times


def on_call_rule(plate: CheckedTarget) -> OnCall | None:
    """The rule of a plate's root by which agents are on call."""
    rules = plate.inference(plate.root).adapt
    return None if rules is None else rules.on_call


def judge_status(inputs: RuleInputs, memory: RuleMemory, decisions: list[Decision]) -> None:
    """Change the status after as many frames as the rule says.

    A target that probably cannot be seen, by its modes, is lost at once: their memory is in that probability.
    """
    rule = inputs.plate.lost
    if inputs.hiding is not None and inputs.hiding.hidden > inputs.hiding.level:
        if inputs.net.status != "lost":
            decisions.append(StatusChanged(inputs.frame, inputs.target, "lost", hidden=inputs.hiding))
    elif inputs.existence is not None and rule.existence_rule is not None:
        name, level = rule.existence_rule
        _by_score(inputs, memory, rule, Scale(name, inputs.existence, level), decisions)
    elif inputs.score is not None and rule.score_below is not None:
        _by_score(inputs, memory, rule, Scale("", inputs.score, rule.score_below), decisions)
    else:
        _by_ud(inputs, memory, rule, decisions)


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
    inputs: RuleInputs, memory: RuleMemory, rule: Lost, scale: Scale, decisions: list[Decision]
) -> None:
    """tracking, uncertain and lost by two levels of the score, each passed for `rule.frames` frames.

    Without `uncertain_below` there are only tracking and lost.
    """
    score, low, low_key = scale.score, scale.low, f"{scale.of or 'score'}_below"
    high, high_key = low, low_key
    if rule.uncertain_below is not None:
        high, high_key = rule.uncertain_below, "uncertain_below"
    previous, status, level, key, streak = inputs.net.status, inputs.net.status, low, low_key, LOST
    if previous != "lost" and memory.count(LOST) >= rule.frames:
        status = "lost"
    elif previous == "tracking" and low < high and memory.count(UNSURE) >= rule.frames:
        status, level, key, streak = "uncertain", high, high_key, UNSURE
    elif previous != "tracking" and memory.count(FOUND) >= rule.frames:
        status, level, key, streak = "tracking", high, high_key, FOUND
    elif previous == "lost" and low < high and memory.count(SEEN) >= rule.frames:
        status, streak = "uncertain", SEEN
    if status != previous:
        fell = (previous, status) in (("tracking", "uncertain"), ("tracking", "lost"), ("uncertain", "lost"))
        turning = (max if fell else min)(memory.streak_values(streak))
        cause = ScoreCause(level, score, rule.frames, turning, fell, scale.of, key, previous)
        decisions.append(StatusChanged(inputs.frame, inputs.target, status, cause))


def _by_ud(inputs: RuleInputs, memory: RuleMemory, rule: Lost, decisions: list[Decision]) -> None:
    """tracking <-> lost by UD and fit."""
    reading = read_ud(inputs, memory, inputs.plate.root, rule.above)
    too_wide = reading is not None and reading.value > reading.level
    status, turning = inputs.net.status, math.inf
    if status != "lost" and memory.count(LOST) >= rule.frames:
        status, turning = "lost", min(memory.streak_values(LOST)) if too_wide else math.inf
    elif status == "lost" and memory.count(FOUND) >= rule.frames:
        status, turning = "tracking", max(memory.streak_values(FOUND))
    if status != inputs.net.status:
        by_ud = reading is not None and turning < math.inf
        cause: Cause | FitCause | None = None
        reason = ""
        if by_ud and reading is not None:
            cause = reading.cause(rule.frames, turning)
        elif blind := _blind(inputs):
            reason = blind
        elif status == "lost":
            best_fit = max(memory.streak_values(UNFIT))
            cause = FitCause(
                rule.fit_below, inputs.measures.fit, rule.frames, best_fit if best_fit >= 0.0 else None
            )
        if status == "tracking" and inputs.measures.fit >= rule.fit_below and not reason:
            fitting = f"{inputs.measures.fit:.3g} (1: perfect) ≥ fit_below {rule.fit_below:.3g}"
            reason = f"the best hypothesis has a fit of {fitting}"
        decisions.append(StatusChanged(inputs.frame, inputs.target, status, cause, reason))


def _blind(inputs: RuleInputs) -> str:
    """The reason that nothing can fit, where nobody looked; else empty."""
    if not inputs.net.active:
        return "no agent is active, so the belief is prediction only"
    return "no active agent saw it" if inputs.net.active <= set(inputs.measures.silent) else ""
