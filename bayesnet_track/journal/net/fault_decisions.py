"""Decisions about agents that fail: out, and tried again."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Quarantined:
    """An agent failed: it is out, and tried again after a while that doubles with each failure in a row.

    Attributes:
        frame: frame at which it failed (its evidence is not used in this frame either).
        target: target id.
        node: the agent.
        reason: what it returned or raised.
        until: first frame in which it may work again; null when it is out for the rest of the run, since it
            could not learn its first reference or needs colour where the source is gray.
        times: how many times in a row it has failed, this one included; an agent that then works ten times as
            long as it was out begins anew.
    """

    frame: int
    target: str
    node: str
    reason: str
    until: int | None = None
    times: int = 1


@dataclass(frozen=True)
class Readmitted:
    """An agent that failed is tried again.

    Attributes:
        frame: frame at which its time was over; it works from the next frame on.
        target: target id.
        node: the agent.
        on: whether it is switched on: it was when it failed, or a person wants it so.
        times: how many times in a row it had failed.
        waited: for how many frames it was out.
    """

    frame: int
    target: str
    node: str
    on: bool
    times: int
    waited: int
