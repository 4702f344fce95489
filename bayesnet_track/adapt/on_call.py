"""When agents on call run next: a pure function of what their last run showed."""

from __future__ import annotations

from bayesnet_track.adapt.memory import RuleMemory
from bayesnet_track.adapt.situation import Situation, read_ud
from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.graph.settings.adapt import OnCall
from bayesnet_track.journal.events.switches import Scheduled
from bayesnet_track.journal.net.target_net import TargetNet


def on_call_rule(plate: CheckedTarget) -> OnCall | None:
    """The rule of a plate's root by which agents are on call."""
    rules = plate.inference(plate.root).adapt
    return None if rules is None else rules.on_call


def is_due(net: TargetNet, frame: int) -> bool:
    """Whether agents on call run in a frame, whatever the others say of it."""
    return net.turn is None or frame >= net.turn.due or net.status == "lost"


def schedule(now: Situation, memory: RuleMemory) -> tuple[Scheduled, ...]:
    """When the agents on call run next; nothing where that is as it was."""
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
