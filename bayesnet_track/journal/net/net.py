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

STARTS = (births.TargetStarted, reidentification.Returned)
"""Decisions that a net starts with."""

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
        if isinstance(decision, endings.Decisions):
            del targets[decision.target]
            for pair in [pair for pair in joined if decision.target in pair]:
                del joined[pair]
        elif isinstance(decision, joins.Decisions):
            _join(targets, joined, decision)
        elif isinstance(decision, STARTS):
            targets[decision.target] = TargetNet(decision.template, frozenset(decision.active))
        else:
            after = decision.change(targets[decision.target])
            targets[decision.target] = _without_vain_samples(after) if after.sampled else after
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
    targets: Mapping[str, TargetNet], joined: dict[tuple[str, str], joins.Joined], decision: joins.Decisions
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
    out = (net.active, net.quarantined, net.by_hand, net.shed)
    sampled = {a: every for a, every in net.sampled.items() if not any(a in agents for agents in out)}
    return net if len(sampled) == len(net.sampled) else replace(net, sampled=sampled)
