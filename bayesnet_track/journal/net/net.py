"""The live net and the decisions that change it. Decisions are the journal's entries.

`apply` is pure; folding it over the decisions of a journal rebuilds the net of any frame. A decision made
while frame n is processed takes effect on frame n + 1.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import assert_never

from bayesnet_track.journal.net.causes import Cause, Concentration, FitCause, ScoreCause
from bayesnet_track.journal.net.fault_decisions import Quarantined, Readmitted
from bayesnet_track.journal.net.hand_decisions import Released, Toggled
from bayesnet_track.journal.net.join_decisions import Joined, Parted
from bayesnet_track.journal.net.life_decisions import DuplicateEnded, Reacquired, Returned, TargetDied
from bayesnet_track.journal.net.load_decisions import ParticlesLimited, Shed, TakenBack
from bayesnet_track.journal.net.rule_decisions import Activated, Deactivated, StatusChanged
from bayesnet_track.journal.net.self_decisions import LocallyAdapted, SelfStopped

__all__ = [
    "Activated",
    "Cause",
    "Concentration",
    "Deactivated",
    "Decision",
    "Fault",
    "FitCause",
    "LocallyAdapted",
    "Net",
    "ParticlesLimited",
    "Quarantined",
    "Readmitted",
    "Released",
    "ScoreCause",
    "SelfStopped",
    "Shed",
    "StatusChanged",
    "Switch",
    "TakenBack",
    "TargetNet",
    "TargetStarted",
    "Toggled",
    "apply",
    "replay",
]


@dataclass(frozen=True)
class TargetStarted:
    """A net is born: a copy of the plate `template` for the target inside `box`.

    Attributes:
        frame: frame at which it starts.
        target: the new target's id.
        template: name of the plate.
        box: centre box x, y, w, h in px.
        active: agents that are switched on.
    """

    frame: int
    target: str
    template: str
    box: tuple[float, float, float, float]
    active: tuple[str, ...]


Decision = (
    TargetStarted
    | Activated
    | Deactivated
    | LocallyAdapted
    | SelfStopped
    | Quarantined
    | Readmitted
    | Toggled
    | Released
    | Shed
    | TakenBack
    | ParticlesLimited
    | StatusChanged
    | Reacquired
    | Returned
    | DuplicateEnded
    | TargetDied
    | Joined
    | Parted
)


Switch = Activated | Deactivated | SelfStopped | Quarantined | Readmitted | Toggled | Shed | TakenBack
"""A decision that switches an agent."""

Change = Switch | LocallyAdapted | Released | ParticlesLimited | StatusChanged | Reacquired
"""A decision that changes the net of a target that lives, and lives on."""


@dataclass(frozen=True)
class Fault:
    """An agent's last failure.

    Attributes:
        times: how many times in a row it had failed then.
        frame: when it failed.
        until: first frame in which it may work again; None when it never may.
        was_on: whether it was switched on.
    """

    times: int
    frame: int
    until: int | None
    was_on: bool


@dataclass(frozen=True)
class TargetNet:
    """The live net of one target.

    Attributes:
        template: the plate it was copied from.
        active: agents that are switched on.
        rests_until: self-stopped agent -> first frame at which it may be switched on again.
        rest_count: agent -> how many times it stopped itself.
        quarantined: agents that failed and are out.
        by_hand: agent that a person switched -> whether on; no rule switches it until it is released.
        shed: agents that were switched off for want of time, in this order.
        most_particles: most hypotheses for want of time; None without such a limit.
        faults: agent that failed, whether it is still out or not -> its last failure.
        sampled: agent that is switched off but still evaluated -> in frames whose number this divides.
        status: tracking, uncertain or lost.
    """

    template: str
    active: frozenset[str]
    rests_until: Mapping[str, int] = field(default_factory=dict)
    rest_count: Mapping[str, int] = field(default_factory=dict)
    quarantined: frozenset[str] = frozenset()
    status: str = "tracking"
    by_hand: Mapping[str, bool] = field(default_factory=dict)
    faults: Mapping[str, Fault] = field(default_factory=dict)
    shed: tuple[str, ...] = ()
    most_particles: int | None = None
    sampled: Mapping[str, int] = field(default_factory=dict)

    def looking(self, frame: int) -> frozenset[str]:
        """The agents that look at a frame: those switched on, and those whose sample is due."""
        if not self.sampled:
            return self.active
        return self.active | {agent for agent, every in self.sampled.items() if frame % every == 0}


@dataclass(frozen=True)
class Net:
    """The live nets of all targets, and which of them are joined.

    Attributes:
        targets: target id -> its net.
        joins: pair of live target ids -> the decision that joined them.
    """

    targets: Mapping[str, TargetNet] = field(default_factory=dict)
    joins: Mapping[tuple[str, str], Joined] = field(default_factory=dict)


def apply(net: Net, decision: Decision) -> Net:
    """The net after one decision.

    Raises:
        KeyError: the decision names a target that is not alive, or parts two that are not joined.
    """
    if isinstance(decision, TargetDied | DuplicateEnded):
        left = {target: one for target, one in net.targets.items() if target != decision.target}
        if len(left) == len(net.targets):
            raise KeyError(decision.target)
        joins = {pair: join for pair, join in net.joins.items() if decision.target not in pair}
        return Net(MappingProxyType(left), MappingProxyType(joins))
    if isinstance(decision, Joined | Parted):
        return replace(net, joins=MappingProxyType(_joins_after(net, decision)))
    if isinstance(decision, TargetStarted | Returned):
        changed = TargetNet(decision.template, frozenset(decision.active))
    else:
        changed = _without_vain_glances(_change(net.targets[decision.target], decision))
    return replace(net, targets=MappingProxyType({**net.targets, decision.target: changed}))


def replay(decisions: Iterable[Decision], until_frame: int | None = None) -> Net:
    """The net that frame `until_frame` began with (the last one when None).

    `decisions` are in the order of their frames. Those of earlier frames count, and the targets that start in
    this one. An agent that failed in this frame is still in the net: the frame began with it.
    """
    net = Net()
    for decision in decisions:
        if until_frame is not None:
            if decision.frame > until_frame:
                break
            if decision.frame == until_frame and not isinstance(decision, TargetStarted | Returned):
                continue
        net = apply(net, decision)
    return net


def _joins_after(net: Net, decision: Joined | Parted) -> dict[tuple[str, str], Joined]:
    pair = (decision.target, decision.other)
    for target in pair:
        if target not in net.targets:
            raise KeyError(target)
    joins = {known: join for known, join in net.joins.items() if known != pair}
    if isinstance(decision, Joined):
        joins[pair] = decision
    elif len(joins) == len(net.joins):
        raise KeyError(pair)
    return joins


def _change(net: TargetNet, decision: Change) -> TargetNet:
    match decision:
        case Activated() | TakenBack():
            return replace(net, active=net.active | {decision.node}, shed=_other(net.shed, decision.node))
        case Shed():
            shed = (*_other(net.shed, decision.node), decision.node)
            return replace(net, active=net.active - {decision.node}, shed=shed)
        case ParticlesLimited():
            return replace(net, most_particles=decision.most)
        case Deactivated():
            sampled = (
                {**net.sampled, decision.node: decision.sample_every}
                if decision.sample_every
                else net.sampled
            )
            return replace(net, active=net.active - {decision.node}, sampled=sampled)
        case SelfStopped():
            return replace(
                net,
                active=net.active - {decision.node},
                rests_until={**net.rests_until, decision.node: decision.rests_until},
                rest_count={**net.rest_count, decision.node: net.rest_count.get(decision.node, 0) + 1},
            )
        case Quarantined():
            fault = Fault(decision.times, decision.frame, decision.until, decision.node in net.active)
            return replace(
                net,
                active=net.active - {decision.node},
                quarantined=net.quarantined | {decision.node},
                faults={**net.faults, decision.node: fault},
            )
        case Readmitted():
            return replace(
                net,
                active=net.active | {decision.node} if decision.on else net.active,
                quarantined=net.quarantined - {decision.node},
            )
        case Toggled():
            active = net.active | {decision.node} if decision.on else net.active - {decision.node}
            by_hand = {**net.by_hand, decision.node: decision.on}
            return replace(net, active=active, by_hand=by_hand, shed=_other(net.shed, decision.node))
        case Released():
            held = {agent: on for agent, on in net.by_hand.items() if agent != decision.node}
            return replace(net, by_hand=held)
        case StatusChanged():
            return replace(net, status=decision.status)
        case Reacquired():
            return replace(net, status="tracking")
        case LocallyAdapted():
            return net
        case _:
            assert_never(decision)


def _without_vain_glances(net: TargetNet) -> TargetNet:
    """Only agents that a rule switched off are sampled: none that failed, are shed or switched by hand."""
    out = (net.active, net.quarantined, net.by_hand, net.shed)
    sampled = {a: every for a, every in net.sampled.items() if not any(a in agents for agents in out)}
    return net if len(sampled) == len(net.sampled) else replace(net, sampled=sampled)


def _other(agents: tuple[str, ...], agent: str) -> tuple[str, ...]:
    return tuple(one for one in agents if one != agent)
