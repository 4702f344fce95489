"""The net of all targets, and the decisions that change it.

`apply` is pure; folding it over the decisions of a journal rebuilds the net of any frame. A decision made
while frame n is processed takes effect on frame n + 1.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from bayesnet_track.journal.events import faults, joins, lives, load, statuses, switches
from bayesnet_track.journal.events.faults import Readmitted
from bayesnet_track.journal.events.load import TakenBack, Toggled
from bayesnet_track.journal.events.switches import Activated
from bayesnet_track.journal.target_net import TargetNet

Switch = (
    switches.Activated
    | switches.Deactivated
    | switches.SelfStopped
    | faults.Quarantined
    | faults.Readmitted
    | load.Toggled
    | load.Shed
    | load.TakenBack
)
"""A decision that switches an agent."""

Decision = (
    lives.TargetStarted
    | Switch
    | switches.Scheduled
    | switches.LocallyAdapted
    | load.Released
    | load.ParticlesLimited
    | statuses.StatusChanged
    | statuses.SceneCut
    | lives.Returned
    | lives.Reacquired
    | lives.Continued
    | lives.TargetDied
    | lives.DuplicateEnded
    | joins.Joined
    | joins.Parted
)

STARTS = (lives.TargetStarted, lives.Returned)
"""Decisions that a net starts with."""

ENDS = (lives.TargetDied, lives.DuplicateEnded)
"""Decisions that a net ends with."""

BEFORE_ITS_FRAME = (*STARTS, statuses.SceneCut)
"""Decisions that hold in their own frame."""


@dataclass(frozen=True)
class Net:
    """The live nets of all targets, and which of them are joined.

    Attributes:
        targets: target id -> its net.
        joins: pair of live target ids -> the decision that joined them.
    """

    targets: Mapping[str, TargetNet] = field(default_factory=dict)
    joins: Mapping[tuple[str, str], joins.Joined] = field(default_factory=dict)


def apply(net: Net, decision: Decision) -> Net:
    """The net after one decision.

    Raises:
        KeyError: the decision names a target that is not alive, or parts two that are not joined.
    """
    return apply_decisions(net, (decision,))


def apply_decisions(net: Net, decisions: Iterable[Decision]) -> Net:
    """The net after decisions, in their order; a net of many targets is copied once for all of them.

    Raises:
        KeyError: as `apply`.
    """
    decisions = tuple(decisions)
    if not decisions:
        return net
    targets, joined = dict(net.targets), dict(net.joins)
    for decision in decisions:
        if isinstance(decision, ENDS):
            del targets[decision.target]
            for pair in [pair for pair in joined if decision.target in pair]:
                del joined[pair]
        elif isinstance(decision, joins.Joined | joins.Parted):
            _join(targets, joined, decision)
        elif isinstance(decision, STARTS):
            targets[decision.target] = TargetNet(decision.template, frozenset(decision.active))
        else:
            target_net = decision.change(targets[decision.target])
            targets[decision.target] = _without_vain_samples(target_net) if target_net.sampled else target_net
    return Net(MappingProxyType(targets), MappingProxyType(joined))


def replay(decisions: Iterable[Decision], until_frame: int | None = None) -> Net:
    """The net that frame `until_frame` began with (the last one when None).

    `decisions` are in the order of their frames. Those of earlier frames count, and the targets that start in
    this one and the cut before it. An agent that failed in this frame is still in the net: the frame began
    with it.
    """
    net = Net()
    for decision in decisions:
        if until_frame is not None:
            if decision.frame > until_frame:
                break
            if decision.frame == until_frame and not isinstance(decision, BEFORE_ITS_FRAME):
                continue
        net = apply(net, decision)
    return net


def _join(
    targets: Mapping[str, TargetNet],
    joined: dict[tuple[str, str], joins.Joined],
    decision: joins.Joined | joins.Parted,
) -> None:
    pair = (decision.target, decision.other)
    for target in pair:
        if target not in targets:
            raise KeyError(target)
    if isinstance(decision, joins.Joined):
        joined.pop(pair, None)
        joined[pair] = decision
    else:
        del joined[pair]


def _without_vain_samples(net: TargetNet) -> TargetNet:
    """Only agents that a rule switched off are sampled: none that failed, are shed or switched by hand."""
    unavailable = (net.active, net.quarantined, net.by_hand, net.shed)
    sampled = {
        a: interval for a, interval in net.sampled.items() if not any(a in agents for agents in unavailable)
    }
    return net if len(sampled) == len(net.sampled) else replace(net, sampled=sampled)


def turns_on(event: Switch) -> bool:
    """True if the agent is on after it.

    >>> turns_on(Toggled(3, "1", "motion", False))
    False
    """
    if isinstance(event, Toggled | Readmitted):
        return event.on
    return isinstance(event, Activated | TakenBack)
