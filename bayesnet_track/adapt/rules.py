"""The rules that reconfigure nets: pure functions of measures and memory to decisions.

All that is remembered is updated for many targets at once (`rule_columns.remember_frame`). One of them is
looked at by itself only where a condition has held for as many frames as its rule says.

Order within a frame: agents that failed are tried again when their time is over; agents stop themselves;
then each inference node with `adapt` rules activates, or else deactivates one agent; then the target's
status. Decisions take effect on the next frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from bayesnet_track.adapt.memory import InformationRate, RuleMemory, Streak
from bayesnet_track.adapt.rule_columns import RuleColumns, remember_frame
from bayesnet_track.adapt.rule_inputs import (
    AgentColumns,
    Reading,
    RuleInputs,
    Tested,
    apply_test,
    baseline_level,
    count_left_out,
    read_level,
    read_ud,
)
from bayesnet_track.adapt.status import judge_status, on_call_rule, quarantine
from bayesnet_track.graph.rules.agent_rule import AgentRule
from bayesnet_track.graph.spec import Adapt, Condition, Information, Level
from bayesnet_track.journal.events.faults import Readmitted
from bayesnet_track.journal.events.switches import (
    Activated,
    Deactivated,
    LocallyAdapted,
    Scheduled,
    SelfStopped,
)
from bayesnet_track.journal.net import Decision
from bayesnet_track.journal.target_net import Cause, RuleCause
from bayesnet_track.journal.text.wording import UNIT
from bayesnet_track.numerics.records import evolve

MISSED_FRAMES = 3
"""Frames in a row without an answer after which an agent is out for a while: others wait for it."""


def give_up_on_missing(
    inputs: RuleInputs, memory: RuleMemory, decisions: list[Decision]
) -> Mapping[str, int] | None:
    """Put out agents that gave no answer for some frames in a row; how many there were of the others.

    None where all gave one, in the last frame, too.
    """
    if not inputs.missed and not memory.missed.any():
        return None
    columns = memory.layout.agents
    missed = {agent: int(memory.missed[0, columns[agent]]) + 1 for agent in inputs.missed}
    for agent, count in list(missed.items()):
        if count >= MISSED_FRAMES:
            reason = f"gave no answer in {count} frames in a row, the last time: {inputs.missed[agent]}"
            decisions.append(quarantine(inputs.net, inputs.frame, inputs.target, agent, reason))
            del missed[agent]
    return missed


def decide(inputs: RuleColumns, memory: RuleMemory) -> tuple[dict[int, tuple[Decision, ...]], RuleMemory]:
    """Row of a target -> the decisions of a frame, where there are some; what the rules remember of all T."""
    memory, is_due = remember_frame(inputs, memory)
    decided: dict[int, tuple[Decision, ...]] = {}
    for row in np.flatnonzero(is_due).tolist():
        decisions, missed, ended = decide_row(
            inputs.see(row), memory if len(memory) == 1 else memory.take([row])
        )
        if ended or missed is not None:
            memory = memory.replaced(row, ended, missed)
        if decisions:
            decided[row] = decisions
    return decided, memory


def decide_row(
    inputs: RuleInputs, memory: RuleMemory
) -> tuple[tuple[Decision, ...], Mapping[str, int] | None, list[Streak]]:
    """The decisions of one frame for one target, of which `memory` is, this frame counted.

    Also how often its agents gave no answer, None where nothing is to be counted, and the streaks that end
    with the decisions.
    """
    decisions, ended = readmit(inputs), list[Streak]()
    missed = give_up_on_missing(inputs, memory, decisions)
    _check_agents(inputs, memory, decisions, ended)
    for node in memory.layout.nodes:
        rules = inputs.plate.inference(node).adapt
        if rules is not None:
            _govern(inputs, memory, node, rules, (decisions, ended))
    decisions += schedule(inputs, memory)
    _wake(inputs, decisions)
    judge_status(inputs, memory, decisions)
    return tuple(decisions), missed, ended


def _find(
    inputs: RuleInputs, memory: RuleMemory, node: str, level: Level | None, test: Condition | None
) -> Reading | Tested | None:
    """Reading of a rule's condition on the node's belief; None while it cannot be told."""
    if level is not None:
        return read_ud(inputs, memory, node, level)
    if test is None or test.concentrated is None:
        return None
    window = inputs.measures.inside.get((node, test.concentrated.within_box))
    return None if window is None else apply_test(test.concentrated, window, inputs.measures.ud_px2[node])


# ------------------------------------------------------------------------------------ rules of agents


def _check_agents(
    inputs: RuleInputs, memory: RuleMemory, decisions: list[Decision], ended: list[Streak]
) -> None:
    """Agents whose rules say so stop themselves; some try to help themselves on each frame before.

    The last active agent does not stop itself.
    """
    active = set(inputs.net.active)
    for streak in _ordered(memory.layout.rules, inputs):
        key, agent = streak
        rule, count = inputs.plate.agent(agent).rules[key], memory.count(streak)
        if not count or agent not in active:
            continue
        if count >= rule.frames and len(active) > 1:
            pause = rule.rest * 2 ** min(inputs.net.rest_count.get(agent, 0), 20)
            cause = _cause_of(inputs, memory, streak, rule, rule.frames)
            decisions.append(SelfStopped(inputs.frame, inputs.target, agent, cause, inputs.frame + 1 + pause))
            active.discard(agent)
            ended += [streak for streak in memory.layout.rules if streak[1] == agent]
        elif rule.adapts_first and agent in inputs.adaptable and count < rule.frames:
            cause = _cause_of(inputs, memory, streak, rule, 1)
            decisions.append(LocallyAdapted(inputs.frame, inputs.target, agent, count, cause))


def _ordered(streaks: Sequence[Streak], inputs: RuleInputs) -> list[Streak]:
    """The streaks of agents, those first that said something, in the order in which they were measured."""
    places = {agent: place for place, agent in enumerate(inputs.measures.agent_ud_px2)}
    return sorted(streaks, key=lambda streak: places.get(streak[1], len(places)))


def _stopped(decisions: Iterable[Decision]) -> set[str]:
    """Agents that stopped themselves in this frame."""
    return {d.node for d in decisions if isinstance(d, SelfStopped)}


# ------------------------------------------------------------------------------------ inference nodes


def _govern(
    inputs: RuleInputs,
    memory: RuleMemory,
    node: str,
    rules: Adapt,
    outcome: tuple[list[Decision], list[Streak]],
) -> None:
    """Activate above, deactivate below; one kind of decision per node and frame."""
    decisions, ended = outcome
    activation, deactivation, fired = rules.activate, rules.deactivate, False
    on_streak, off_streak = ("activate", node), ("deactivate", node)
    if activation is not None and memory.count(on_streak) >= activation.frames:
        reading = _find(inputs, memory, node, activation.above, activation.unless)
        if reading is None and inputs.net.status == "lost" and activation.above is not None:
            reading = _read_ud_beside_more(inputs, memory, node, activation.above)
        assert reading is not None
        selected = _choose_to_activate(inputs, memory, node, rules)
        cause = reading.cause_above(activation.frames, memory.streak_values(on_streak))
        decisions += [
            Activated(
                inputs.frame, inputs.target, choice.agent, node, cause, choice.helpfulness, choice.expected
            )
            for choice in selected
        ]
        fired = bool(selected)
    if deactivation is not None and memory.count(off_streak) >= deactivation.frames and not fired:
        index = _drop_index(inputs, memory, node, deactivation.drop, decisions)
        remaining = len(index) + _count_held_on(inputs, node) + _count_left_out_on(inputs, node, decisions)
        agent = _choose_drop(inputs, memory, node, rules, index) if index and remaining > rules.keep else None
        if agent is not None:
            reading = _find(inputs, memory, node, deactivation.below, deactivation.when)
            assert reading is not None
            cause = reading.cause_below(deactivation.frames, memory.streak_values(off_streak))
            interval = deactivation.sample_every or 0
            decisions.append(
                Deactivated(
                    inputs.frame, inputs.target, agent, node, cause, deactivation.drop, index, interval
                )
            )
            fired = True
    if fired:
        ended += [streak for streak in (on_streak, off_streak) if streak in memory.layout.streaks]


def _eligible(inputs: RuleInputs) -> list[str]:
    """Inactive agents that may be switched on for the next frame, those shed for want of time, too."""
    return [
        agent
        for agent in inputs.plate.agents
        if agent not in inputs.net.active
        and agent not in inputs.net.quarantined
        and agent not in inputs.net.by_hand
        and agent not in inputs.missed
        and inputs.net.rests_until.get(agent, 0) <= inputs.frame + 1
    ]


@dataclass(frozen=True)
class _Chosen:
    """An agent to switch on, and what spoke for it."""

    agent: str
    helpfulness: float | None = None
    expected: Mapping[str, float] = field(default_factory=dict)


def _choose_to_activate(inputs: RuleInputs, memory: RuleMemory, node: str, rules: Adapt) -> list[_Chosen]:
    """All, or the one that a rule thinks best; one never tried comes first.

    By expected information all are switched on while the target is lost: what it is worth was learnt while it
    was seen.
    """
    agents = [
        agent
        for agent in _eligible(inputs)
        if inputs.plate.governor[agent] == node and agent not in inputs.net.shed
    ]
    policy = "all" if rules.activate is None else rules.activate.which
    if policy == "information_per_ms" and agents and inputs.net.status != "lost":
        rates = memory.worth[0].get(node, InformationRate())
        expected = expected_per_ms(rates, agents, inputs.costs_ms, rules.information)
        selected = max(agents, key=lambda agent: expected[agent])
        return [_Chosen(selected, rates.mean(selected), expected)]
    if policy != "most_helpful" or not agents:
        return [_Chosen(agent) for agent in agents]
    helpfulness = {agent: memory.helpfulness(agent) for agent in agents}
    selected = max(
        agents,
        key=lambda agent: float("inf") if helpfulness[agent] is None else float(helpfulness[agent] or 0.0),
    )
    return [_Chosen(selected, helpfulness[selected])]


def _drop_index(
    inputs: RuleInputs, memory: RuleMemory, node: str, drop: str, decisions: list[Decision]
) -> dict[str, float]:
    """Governed agent -> the index by which one is dropped.

    Those that just stopped themselves are out, and those that a person switched on.
    """
    stopped = _stopped(decisions)
    agents = [
        agent
        for agent in inputs.measures.kl
        if inputs.plate.governor[agent] == node
        and agent in inputs.net.active
        and agent not in stopped
        and agent not in inputs.net.by_hand
    ]
    if drop == "largest_kl":
        return {agent: inputs.measures.kl[agent] for agent in agents}
    if drop == "most_expensive_redundant":
        return {agent: inputs.measures.ud_without_px2[agent] for agent in agents}
    if drop == "most_expensive":
        return {agent: inputs.costs_ms[agent] for agent in agents}
    if drop == "min_information_per_ms":
        return remembered_per_ms(memory.worth[0].get(node, InformationRate()), agents, inputs.costs_ms)
    return divide_by_cost({agent: inputs.measures.contribution[agent] for agent in agents}, inputs.costs_ms)


def _count_held_on(inputs: RuleInputs, node: str) -> int:
    """Number of governed agents that work because a person switched them on."""
    return sum(
        inputs.plate.governor[agent] == node and agent in inputs.net.active for agent in inputs.net.by_hand
    )


def _count_left_out_on(inputs: RuleInputs, node: str, decisions: list[Decision]) -> int:
    """Number of agents that stay on and that the node's rules may not switch."""
    return count_left_out(inputs.plate, inputs.net.active - _stopped(decisions), node)


def _choose_drop(
    inputs: RuleInputs, memory: RuleMemory, node: str, rules: Adapt, index: Mapping[str, float]
) -> str | None:
    """The agent to switch off by its index; None where none can be spared."""
    if rules.deactivate is None or rules.deactivate.drop != "most_expensive_redundant":
        largest = rules.deactivate is not None and rules.deactivate.drop in ("largest_kl", "most_expensive")
        return (max if largest else min)(index, key=lambda name: index[name])
    # Without it the rule that switches agents on would not call it back at once.
    level = rules.deactivate.below if rules.activate is None else rules.activate.above
    assert level is not None
    quiet = baseline_level(inputs.plate, inputs.net.active, memory, node)
    spared = [
        agent
        for agent, ud in index.items()
        if (reading := read_level(level, ud, inputs.measures.area_of(node), quiet)) is not None
        and reading.value < reading.level
    ]
    return max(spared, key=lambda agent: inputs.costs_ms[agent], default=None)


def _wake(inputs: RuleInputs, decisions: list[Decision]) -> None:
    """With no agent active, switch on all that may be: nothing else could bring the net back."""
    stopped = _stopped(decisions) | {d.node for d in decisions if isinstance(d, Deactivated)}
    readmitted = any(isinstance(d, Readmitted) and d.on for d in decisions)
    if inputs.net.active - stopped or readmitted:
        return
    governors = {d.governor for d in decisions if isinstance(d, Activated)}
    if len(governors) == 1:  # at no level would its agents have stayed off: they would have been woken
        decisions[:] = [evolve(d, cause=None) if isinstance(d, Activated) else d for d in decisions]
    if governors:
        return
    for agent in _eligible(inputs):
        governor = inputs.plate.governor[agent] or inputs.plate.root
        decisions.append(Activated(inputs.frame, inputs.target, agent, governor, None))


def readmit(inputs: RuleInputs) -> list[Decision]:
    """The agents whose time is over, in the order of the plate."""
    decisions: list[Decision] = []
    for agent in inputs.plate.agents:
        fault = inputs.net.faults.get(agent)
        if fault is None or agent not in inputs.net.quarantined or fault.until is None:
            continue
        if fault.until <= inputs.frame + 1:
            is_on = inputs.net.by_hand.get(agent, fault.was_on)
            waited = inputs.frame + 1 - fault.frame
            decisions.append(Readmitted(inputs.frame, inputs.target, agent, is_on, fault.times, waited))
    return decisions


def schedule(inputs: RuleInputs, memory: RuleMemory) -> tuple[Scheduled, ...]:
    """Decision when the agents on call run next; nothing where that is as it was."""
    rule, call, turn = on_call_rule(inputs.plate), inputs.call, inputs.net.turn
    if rule is None or call is None or not call.ran:
        return ()
    reading = read_ud(inputs, memory, inputs.plate.root, rule.above)
    doubt = reading.cause(1, reading.value) if reading is not None and reading.above else None
    gap = 1
    if call.overlap >= rule.agree and doubt is None and inputs.net.status != "lost":
        gap = min((1 if turn is None else turn.gap) + 1, rule.every)
    if gap == 1 and turn is None:
        return ()
    scheduled = Scheduled(
        inputs.frame,
        inputs.target,
        call.agents,
        inputs.plate.root,
        call.overlap,
        rule.agree,
        gap,
        inputs.frame + gap * inputs.stride,
        inputs.frame if turn is None else turn.due,
        call.cause,
        doubt,
        inputs.net.status,
    )
    return (scheduled,)


def expected_per_ms(
    rates: InformationRate, agents: Iterable[str], costs_ms: Mapping[str, float], settings: Information
) -> dict[str, float]:
    """Agent -> information that may be expected of it per declared cost, nats per ms.

    >>> worth = InformationRate().after({"a": 0.4, "b": 0.6}, memory=100)
    >>> found = expected_per_ms(worth, "abc", {"a": 0.5, "b": 1.0, "c": 9.0}, Information(exploration=0))
    >>> round(found["a"], 9), round(found["b"], 9), found["c"]
    (0.8, 0.6, inf)
    """
    return divide_by_cost({agent: rates.hope(agent, settings.exploration) for agent in agents}, costs_ms)


def remembered_per_ms(
    rates: InformationRate, agents: Iterable[str], costs_ms: Mapping[str, float]
) -> dict[str, float]:
    """Agent -> mean information that it gave per declared cost, nats per ms; for agents that are active."""
    return divide_by_cost({agent: rates.mean(agent) or 0.0 for agent in agents}, costs_ms)


def divide_by_cost(gains: Mapping[str, float], costs: Mapping[str, float]) -> dict[str, float]:
    """Expected gain per declared cost of each action: by it agents and cameras are switched on or off.

    >>> divide_by_cost({"north": 3.0, "south": 2.0}, {"north": 2.0, "south": 1.0})
    {'north': 1.5, 'south': 2.0}
    """
    return {action: gain / costs[action] for action, gain in gains.items()}


def _read_ud_beside_more(inputs: RuleInputs, memory: RuleMemory, node: str, level: Level) -> Reading | None:
    """Read the UD as `read_ud`, by the baseline of more agents than are on where that of so few is unknown.

    It is the lower one, so that help is called early; for a target that is lost, of which no baseline is
    measured.
    """
    quiet = memory.level_px2(node, frozenset())
    return read_level(level, inputs.measures.ud_px2[node], inputs.measures.area_of(node), quiet)


def _cause_of(
    inputs: RuleInputs, memory: RuleMemory, streak: Streak, rule: AgentRule, frames: int
) -> Cause | RuleCause:
    """The numbers of a rule by which an agent switches itself, whose streak has reached so many frames."""
    key, agent = streak
    value, level, unit = float(rule.values(AgentColumns(agent, (inputs,)))[0]), rule.level, rule.unit
    values = memory.streak_values(streak)[-frames:]
    turning = min(values) if rule.relation == ">" else max(values)
    if isinstance(level, Level):
        quiet = baseline_level(inputs.plate, inputs.net.active, memory, inputs.plate.root)
        reading = read_level(level, value, inputs.measures.area_px2, quiet)
        assert reading is not None
        if rule.cause == "ud":
            return reading.cause(frames, turning)
        value, level, unit = reading.value, reading.level, UNIT[reading.unit]
    return RuleCause(key, rule.quantity, unit, rule.relation, level, value, frames, turning)
