"""The net of all targets and the decisions that change it. Decisions are the journal's entries.

`apply` is pure; folding it over the decisions of a journal rebuilds the net of any frame. A decision made
while frame n is processed takes effect on frame n + 1.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from bayesnet_track.journal.events import (
    births,
    by_hand,
    endings,
    faults,
    joins,
    load,
    reidentification,
    self_checks,
    statuses,
    switches,
)
from bayesnet_track.journal.net.target_net import TargetNet

Decision = (
    births.Decisions
    | switches.Decisions
    | self_checks.Decisions
    | faults.Decisions
    | by_hand.Decisions
    | load.Decisions
    | statuses.Decisions
    | reidentification.Decisions
    | endings.Decisions
    | joins.Decisions
)

Switch = switches.Switches | self_checks.Switches | faults.Switches | by_hand.Switches | load.Switches
"""A decision that switches an agent."""

BEFORE_ITS_FRAME = (births.TargetStarted, reidentification.Returned, statuses.SceneCut)
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
    if isinstance(decision, endings.Decisions):
        left = {target: one for target, one in net.targets.items() if target != decision.target}
        if len(left) == len(net.targets):
            raise KeyError(decision.target)
        left_joined = {pair: join for pair, join in net.joins.items() if decision.target not in pair}
        return Net(MappingProxyType(left), MappingProxyType(left_joined))
    if isinstance(decision, joins.Decisions):
        return replace(net, joins=MappingProxyType(_joins_after(net, decision)))
    if isinstance(decision, births.TargetStarted | reidentification.Returned):
        changed = TargetNet(decision.template, frozenset(decision.active))
    else:
        changed = _without_vain_samples(decision.change(net.targets[decision.target]))
    return replace(net, targets=MappingProxyType({**net.targets, decision.target: changed}))


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


def _joins_after(net: Net, decision: joins.Decisions) -> dict[tuple[str, str], joins.Joined]:
    pair = (decision.target, decision.other)
    for target in pair:
        if target not in net.targets:
            raise KeyError(target)
    known_joins = {known: join for known, join in net.joins.items() if known != pair}
    if isinstance(decision, joins.Joined):
        known_joins[pair] = decision
    elif len(known_joins) == len(net.joins):
        raise KeyError(pair)
    return known_joins


def _without_vain_samples(net: TargetNet) -> TargetNet:
    """Only agents that a rule switched off are sampled: none that failed, are shed or switched by hand."""
    out = (net.active, net.quarantined, net.by_hand, net.shed)
    sampled = {a: every for a, every in net.sampled.items() if not any(a in agents for agents in out)}
    return net if len(sampled) == len(net.sampled) else replace(net, sampled=sampled)
