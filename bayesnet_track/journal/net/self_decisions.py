"""Decisions of agents about themselves."""

from __future__ import annotations

from dataclasses import dataclass

from bayesnet_track.journal.net.causes import Cause


@dataclass(frozen=True)
class LocallyAdapted:
    """An agent uncertain of itself tuned its own reference before stopping.

    Attributes:
        frame: frame whose numbers caused it.
        target: target id.
        node: the agent.
        attempt: how often it has tried in this episode, from 1.
        cause: the numbers (the agent's own UD).
    """

    frame: int
    target: str
    node: str
    attempt: int
    cause: Cause


@dataclass(frozen=True)
class SelfStopped:
    """An agent that stayed uncertain of itself stopped.

    Attributes:
        frame: frame whose numbers caused it.
        target: target id.
        node: the agent.
        cause: the numbers (the agent's own UD).
        rests_until: first frame at which it may be switched on again.
    """

    frame: int
    target: str
    node: str
    cause: Cause
    rests_until: int
