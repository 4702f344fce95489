"""Sentences for what comes from outside, and for agents that fail."""

from __future__ import annotations

from bayesnet_track.graph.hand_decisions import Released, Toggled
from bayesnet_track.journal.inputs import AgentMissed


def by_hand(event: Toggled | Released) -> str:
    """`a person switched motion off; no rule switches it until it is released`."""
    if isinstance(event, Released):
        return f"a person released {event.node} → the rules may switch it again"
    how = "on" if event.on else "off"
    return f"a person switched {event.node} → {how}; no rule switches it until it is released"


def missed(event: AgentMissed) -> str:
    """`motion gave no answer: its process died → left out of this frame`."""
    asked = "" if event.during == "observing" else f" while {event.during}"
    return f"{event.node} gave no answer{asked}: {event.reason} → left out of this frame"
