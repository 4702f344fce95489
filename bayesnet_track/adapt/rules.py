"""The rules that reconfigure nets: pure functions of measures and memory to decisions.

All that is remembered is updated for many targets at once (`rule_columns.remember`). One of them is looked at
by itself only where a condition has held for as many frames as its rule says.

Order within a frame: agents that failed are tried again when their time is over; agents stop themselves;
then each inference node with `adapt` rules activates, or else deactivates one agent; then the target's
status. Decisions take effect on the next frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from bayesnet_track.adapt.memory import InformationRate, RuleMemory, Streak
from bayesnet_track.adapt.rule_columns import RuleColumns, remember
from bayesnet_track.adapt.rule_inputs import (
    Reading,
    RuleInputs,
    Tested,
    apply_test,
    baseline_level,
    cause_of,
    count_left_out,
    read_level,
    read_ud,
    read_ud_beside_more,
)
from bayesnet_track.adapt.status import judge_status, on_call_rule, quarantine
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
from bayesnet_track.numerics.records import evolve

MISSED_FRAMES = 3
"""Frames in a row without an answer after which an agent is out for a while: others wait for it."""


def give_up_on_missing(
    now: RuleInputs, memory: RuleMemory, decisions: list[Decision]
) -> Mapping[str, int] | None:
    """Put out agents that gave no answer for some frames in a row; how many there were of the others.

    None where all gave one, in the last frame, too.
    """
    if not now.missed and not memory.missed.any():
        return None
    columns = memory.layout.agents
    missed = {agent: int(memory.missed[0, columns[agent]]) + 1 for agent in now.missed}
    for agent, count in list(missed.items()):
        if count >= MISSED_FRAMES:
            reason = f"gave no answer in {count} frames in a row, the last time: {now.missed[agent]}"
            decisions.append(quarantine(now.net, now.frame, now.target, agent, reason))
            del missed[agent]
    return missed


def decide(now: RuleColumns, memory: RuleMemory) -> tuple[dict[int, tuple[Decision, ...]], RuleMemory]:
    """Row of a target -> the decisions of a frame, where there are some; what the rules remember of all T."""
    memory, is_due = remember(now, memory)
    found: dict[int, tuple[Decision, ...]] = {}
    for row in np.flatnonzero(is_due).tolist():
        made, missed, ended = decide_row(now.see(row), memory if len(memory) == 1 else memory.take([row]))
        if ended or missed is not None:
            memory = memory.replaced(row, ended, missed)
        if made:
            found[row] = made
    return found, memory


def decide_row(
    now: RuleInputs, memory: RuleMemory
) -> tuple[tuple[Decision, ...], Mapping[str, int] | None, list[Streak]]:
    """The decisions of one frame for one target, of which `memory` is, this frame counted.

    Also how often its agents gave no answer, None where nothing is to be counted, and the streaks that end
    with the decisions.
    """
    decisions, ended = readmit(now), list[Streak]()
    missed = give_up_on_missing(now, memory, decisions)
    _check_agents(now, memory, decisions, ended)
    for node in memory.layout.nodes:
        rules = now.plate.inference(node).adapt
        if rules is not None:
            _govern(now, memory, node, rules, (decisions, ended))
    decisions += schedule(now, memory)
    _wake(now, decisions)
    judge_status(now, memory, decisions)
    return tuple(decisions), missed, ended


def _find(
    now: RuleInputs, memory: RuleMemory, node: str, level: Level | None, test: Condition | None
) -> Reading | Tested | None:
    """Reading of a rule's condition on the node's belief; None while it cannot be told."""
    if level is not None:
        return read_ud(now, memory, node, level)
    if test is None or test.concentrated is None:
        return None
    inside = now.measures.inside.get((node, test.concentrated.within_box))
    return None if inside is None else apply_test(test.concentrated, inside, now.measures.ud_px2[node])


# ------------------------------------------------------------------------------------ rules of agents


def _check_agents(
    now: RuleInputs, memory: RuleMemory, decisions: list[Decision], ended: list[Streak]
) -> None:
    """Agents whose rules say so stop themselves; some try to help themselves on each frame before.

    The last active agent does not stop itself.
    """
    active = set(now.net.active)
    for streak in _ordered(memory.layout.rules, now):
        key, agent = streak
        rule, count = now.plate.agent(agent).rules[key], memory.count(streak)
        if not count or agent not in active:
            continue
        if count >= rule.frames and len(active) > 1:
            rest = rule.rest * 2 ** min(now.net.rest_count.get(agent, 0), 20)
            cause = cause_of(now, memory, streak, rule, rule.frames)
            decisions.append(SelfStopped(now.frame, now.target, agent, cause, now.frame + 1 + rest))
            active.discard(agent)
            ended += [streak for streak in memory.layout.rules if streak[1] == agent]
        elif rule.adapts_first and agent in now.adaptable and count < rule.frames:
            cause = cause_of(now, memory, streak, rule, 1)
            decisions.append(LocallyAdapted(now.frame, now.target, agent, count, cause))


def _ordered(streaks: Sequence[Streak], now: RuleInputs) -> list[Streak]:
    """The streaks of agents, those first that said something, in the order in which they were measured."""
    places = {agent: place for place, agent in enumerate(now.measures.agent_ud_px2)}
    return sorted(streaks, key=lambda streak: places.get(streak[1], len(places)))


def _stopped(decisions: Iterable[Decision]) -> set[str]:
    """Agents that stopped themselves in this frame."""
    return {d.node for d in decisions if isinstance(d, SelfStopped)}


# ------------------------------------------------------------------------------------ inference nodes


def _govern(
    now: RuleInputs,
    memory: RuleMemory,
    node: str,
    rules: Adapt,
    done: tuple[list[Decision], list[Streak]],
) -> None:
    """Activate above, deactivate below; one kind of decision per node and frame."""
    decisions, ended = done
    on, off, fired = rules.activate, rules.deactivate, False
    up, down = ("activate", node), ("deactivate", node)
    if on is not None and memory.count(up) >= on.frames:
        found = _find(now, memory, node, on.above, on.unless)
        if found is None and now.net.status == "lost" and on.above is not None:
            found = read_ud_beside_more(now, memory, node, on.above)
        assert found is not None
        chosen = _choose_to_activate(now, memory, node, rules)
        cause = found.cause_above(on.frames, memory.streak_values(up))
        decisions += [
            Activated(now.frame, now.target, one.agent, node, cause, one.helpfulness, one.expected)
            for one in chosen
        ]
        fired = bool(chosen)
    if off is not None and memory.count(down) >= off.frames and not fired:
        index = _drop_index(now, memory, node, off.drop, decisions)
        left = len(index) + _count_held_on(now, node) + _count_left_out_on(now, node, decisions)
        agent = _choose_drop(now, memory, node, rules, index) if index and left > rules.keep else None
        if agent is not None:
            found = _find(now, memory, node, off.below, off.when)
            assert found is not None
            cause = found.cause_below(off.frames, memory.streak_values(down))
            every = off.sample_every or 0
            decisions.append(Deactivated(now.frame, now.target, agent, node, cause, off.drop, index, every))
            fired = True
    if fired:
        ended += [streak for streak in (up, down) if streak in memory.layout.streaks]


def _eligible(now: RuleInputs) -> list[str]:
    """Inactive agents that may be switched on for the next frame, those shed for want of time, too."""
    return [
        agent
        for agent in now.plate.agents
        if agent not in now.net.active
        and agent not in now.net.quarantined
        and agent not in now.net.by_hand
        and agent not in now.missed
        and now.net.rests_until.get(agent, 0) <= now.frame + 1
    ]


@dataclass(frozen=True)
class _Chosen:
    """An agent to switch on, and what spoke for it."""

    agent: str
    helpfulness: float | None = None
    expected: Mapping[str, float] = field(default_factory=dict)


def _choose_to_activate(now: RuleInputs, memory: RuleMemory, node: str, rules: Adapt) -> list[_Chosen]:
    """All, or the one that a rule thinks best; one never tried comes first.

    By expected information all are switched on while the target is lost: what it is worth was learnt while it
    was seen.
    """
    agents = [
        agent for agent in _eligible(now) if now.plate.governor[agent] == node and agent not in now.net.shed
    ]
    which = "all" if rules.activate is None else rules.activate.which
    if which == "information_per_ms" and agents and now.net.status != "lost":
        worth = memory.worth[0].get(node, InformationRate())
        expected = expected_per_ms(worth, agents, now.costs_ms, rules.information)
        best = max(agents, key=lambda agent: expected[agent])
        return [_Chosen(best, worth.mean(best), expected)]
    if which != "most_helpful" or not agents:
        return [_Chosen(agent) for agent in agents]
    known = {agent: memory.helpfulness(agent) for agent in agents}
    best = max(agents, key=lambda agent: float("inf") if known[agent] is None else float(known[agent] or 0.0))
    return [_Chosen(best, known[best])]


def _drop_index(
    now: RuleInputs, memory: RuleMemory, node: str, drop: str, decisions: list[Decision]
) -> dict[str, float]:
    """Governed agent -> the index by which one is dropped.

    Those that just stopped themselves are out, and those that a person switched on.
    """
    stopped = _stopped(decisions)
    agents = [
        agent
        for agent in now.measures.kl
        if now.plate.governor[agent] == node
        and agent in now.net.active
        and agent not in stopped
        and agent not in now.net.by_hand
    ]
    if drop == "largest_kl":
        return {agent: now.measures.kl[agent] for agent in agents}
    if drop == "most_expensive_redundant":
        return {agent: now.measures.ud_without_px2[agent] for agent in agents}
    if drop == "most_expensive":
        return {agent: now.costs_ms[agent] for agent in agents}
    if drop == "min_information_per_ms":
        return remembered_per_ms(memory.worth[0].get(node, InformationRate()), agents, now.costs_ms)
    return {agent: now.measures.contribution[agent] / now.costs_ms[agent] for agent in agents}


def _count_held_on(now: RuleInputs, node: str) -> int:
    """Number of governed agents that work because a person switched them on."""
    return sum(now.plate.governor[agent] == node and agent in now.net.active for agent in now.net.by_hand)


def _count_left_out_on(now: RuleInputs, node: str, decisions: list[Decision]) -> int:
    """Number of agents that stay on and that the node's rules may not switch."""
    return count_left_out(now.plate, now.net.active - _stopped(decisions), node)


def _choose_drop(
    now: RuleInputs, memory: RuleMemory, node: str, rules: Adapt, index: Mapping[str, float]
) -> str | None:
    """The agent to switch off by its index; None where none can be spared."""
    if rules.deactivate is None or rules.deactivate.drop != "most_expensive_redundant":
        largest = rules.deactivate is not None and rules.deactivate.drop in ("largest_kl", "most_expensive")
        return (max if largest else min)(index, key=lambda name: index[name])
    # Without it the rule that switches agents on would not call it back at once.
    level = rules.deactivate.below if rules.activate is None else rules.activate.above
    assert level is not None
    quiet = baseline_level(now.plate, now.net.active, memory, node)
    spared = [
        agent
        for agent, ud in index.items()
        if (reading := read_level(level, ud, now.measures.area_of(node), quiet)) is not None
        and reading.value < reading.level
    ]
    return max(spared, key=lambda agent: now.costs_ms[agent], default=None)


def _wake(now: RuleInputs, decisions: list[Decision]) -> None:
    """With no agent active, switch on all that may be: nothing else could bring the net back."""
    stopped = _stopped(decisions) | {d.node for d in decisions if isinstance(d, Deactivated)}
    readmitted = any(isinstance(d, Readmitted) and d.on for d in decisions)
    if now.net.active - stopped or readmitted:
        return
    governors = {d.governor for d in decisions if isinstance(d, Activated)}
    if len(governors) == 1:  # at no level would its agents have stayed off: they would have been woken
        decisions[:] = [evolve(d, cause=None) if isinstance(d, Activated) else d for d in decisions]
    if governors:
        return
    for agent in _eligible(now):
        governor = now.plate.governor[agent] or now.plate.root
        decisions.append(Activated(now.frame, now.target, agent, governor, None))


def readmit(now: RuleInputs) -> list[Decision]:
    """The agents whose time is over, in the order of the plate."""
    decisions: list[Decision] = []
    for agent in now.plate.agents:
        fault = now.net.faults.get(agent)
        if fault is None or agent not in now.net.quarantined or fault.until is None:
            continue
        if fault.until <= now.frame + 1:
            on = now.net.by_hand.get(agent, fault.was_on)
            waited = now.frame + 1 - fault.frame
            decisions.append(Readmitted(now.frame, now.target, agent, on, fault.times, waited))
    return decisions


def schedule(now: RuleInputs, memory: RuleMemory) -> tuple[Scheduled, ...]:
    """Decision when the agents on call run next; nothing where that is as it was."""
    rule, call, turn = on_call_rule(now.plate), now.call, now.net.turn
    if rule is None or call is None or not call.ran:
        return ()
    reading = read_ud(now, memory, now.plate.root, rule.above)
    doubt = reading.cause(1, reading.value) if reading is not None and reading.above else None
    gap = 1
    if call.overlap >= rule.agree and doubt is None and now.net.status != "lost":
        gap = min((1 if turn is None else turn.gap) + 1, rule.every)
    if gap == 1 and turn is None:
        return ()
    scheduled = Scheduled(
        now.frame,
        now.target,
        call.agents,
        now.plate.root,
        call.overlap,
        rule.agree,
        gap,
        now.frame + gap * now.stride,
        now.frame if turn is None else turn.due,
        call.cause,
        doubt,
        now.net.status,
    )
    return (scheduled,)


def expected_per_ms(
    worth: InformationRate, agents: Iterable[str], costs_ms: Mapping[str, float], settings: Information
) -> dict[str, float]:
    """Agent -> information that may be expected of it per declared cost, nats per ms.

    >>> worth = InformationRate().after({"a": 0.4, "b": 0.6}, memory=100)
    >>> found = expected_per_ms(worth, "abc", {"a": 0.5, "b": 1.0, "c": 9.0}, Information(exploration=0))
    >>> round(found["a"], 9), round(found["b"], 9), found["c"]
    (0.8, 0.6, inf)
    """
    return {agent: worth.hope(agent, settings.exploration) / costs_ms[agent] for agent in agents}


def remembered_per_ms(
    worth: InformationRate, agents: Iterable[str], costs_ms: Mapping[str, float]
) -> dict[str, float]:
    """Agent -> mean information that it gave per declared cost, nats per ms; for agents that are active."""
    return {agent: (worth.mean(agent) or 0.0) / costs_ms[agent] for agent in agents}
