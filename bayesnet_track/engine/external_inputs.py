"""What came from outside with a frame, sorted out: missing agents, switches by hand, lateness."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from bayesnet_track.engine.compiled import Engine
from bayesnet_track.inference.asking import Availability
from bayesnet_track.journal.events.event import Input
from bayesnet_track.journal.events.faults import AgentMissed
from bayesnet_track.journal.events.load import InputRefused, LateFrame, Released, SpareTime, Toggled
from bayesnet_track.journal.net import Net

ByHand = Toggled | Released


@dataclass(frozen=True, eq=False)
class ExternalInputs:
    """The inputs of one frame.

    Attributes:
        inputs: all but missing agents, in order, with this frame's index.
        availability: agents that give no answer.
        by_hand: target -> what a person switched.
        refused: what a person asked for that cannot be done.
        timing: what was late, or early.
    """

    inputs: tuple[Input, ...]
    availability: Availability
    by_hand: Mapping[str, tuple[ByHand, ...]]
    refused: tuple[InputRefused, ...]
    timing: tuple[LateFrame | SpareTime, ...]

    @property
    def to_repeat(self) -> tuple[Input, ...]:
        """What has to be given again for the frame to repeat; complete when the frame is done."""
        return (*self.inputs, *self.availability.events)


def route_inputs(engine: Engine, net: Net, frame: int, given: Iterable[Input]) -> ExternalInputs:
    """The inputs that are given with `frame`, by whom they concern in the net that it begins with."""
    inputs = tuple(replace(one, frame=frame) for one in given)
    if not inputs:
        return ExternalInputs((), Availability(frame), {}, (), ())
    by_hand: dict[str, tuple[ByHand, ...]] = {}
    refused: list[InputRefused] = []
    for one in inputs:
        if not isinstance(one, ByHand):
            continue
        reason = _impossible(engine, net, one)
        if reason:
            refused.append(InputRefused(frame, one.target, one.node, reason))
        else:
            by_hand[one.target] = (*by_hand.get(one.target, ()), one)
    return ExternalInputs(
        tuple(one for one in inputs if not isinstance(one, AgentMissed)),
        Availability.of(frame, (one for one in inputs if isinstance(one, AgentMissed))),
        by_hand,
        tuple(refused),
        tuple(one for one in inputs if isinstance(one, LateFrame | SpareTime)),
    )


def _impossible(engine: Engine, net: Net, asked: ByHand) -> str:
    """Why it cannot be done; empty when it can."""
    if asked.target not in net.targets:
        return f"there is no target {asked.target}"
    live = net.targets[asked.target]
    if asked.node not in engine.plates[live.template].plate.agents:
        return f"{live.template} has no agent {asked.node}"
    if isinstance(asked, Toggled) and asked.on and asked.node in live.quarantined:
        until = live.faults[asked.node].until
        return f"{asked.node} failed and is out {'for good' if until is None else f'until frame {until}'}"
    return ""
