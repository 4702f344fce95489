"""What came from outside while a run went on: the lines of ``inputs.jsonl``.

A run is a function of graph, source, starts, seed and these. Each has the frame with which the engine is
given it, so that the same lines give the same run again.
"""

from __future__ import annotations

from dataclasses import dataclass

from bayesnet_track.journal.net.hand_decisions import Released, Toggled

__all__ = ["AgentMissed", "Input", "InputRefused", "LateFrame", "Released", "SpareTime", "Toggled"]


@dataclass(frozen=True)
class AgentMissed:
    """An agent gave no answer for a reason outside of it: its process died or hung, or the answer was late.

    It is left out of this frame as if it were switched off; what the others say does not change.

    Attributes:
        frame: the frame.
        target: target id.
        node: the agent.
        reason: what happened to it.
        during: what it was asked for, which is left out: observing (and then all that follows in the frame),
            guarding, learning, blending or adapting its reference, starting a target, joining, claiming or
            recalling.
    """

    frame: int
    target: str
    node: str
    reason: str
    during: str = "observing"


@dataclass(frozen=True)
class LateFrame:
    """The frame before this one took longer than its budget.

    Attributes:
        frame: the frame whose decisions answer it.
        spent_ms: wall-clock milliseconds that the frame before took.
        budget_ms: milliseconds that it had.
    """

    frame: int
    spent_ms: float
    budget_ms: float


@dataclass(frozen=True)
class SpareTime:
    """The frames before this one were done in time, while something is switched off for want of it.

    Attributes:
        frame: the frame whose decisions answer it.
        spent_ms: the most wall-clock milliseconds that one of them took.
        budget_ms: milliseconds that each had.
        frames: how many they were.
    """

    frame: int
    spent_ms: float
    budget_ms: float
    frames: int


@dataclass(frozen=True)
class InputRefused:
    """What a person asked for cannot be done; the net stays as it is.

    Attributes:
        frame: the frame with which it was asked.
        target: target id.
        node: the agent.
        reason: why not.
    """

    frame: int
    target: str
    node: str
    reason: str


Input = Toggled | Released | AgentMissed | LateFrame | SpareTime
"""A line of ``inputs.jsonl``."""
