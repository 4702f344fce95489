"""Decisions of a person who watches a run."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Toggled:
    """A person switched an agent on or off. It stays so until it is released: no rule switches it.

    Attributes:
        frame: frame with which it was said; it works from the next frame on.
        target: target id.
        node: the agent.
        on: true when it was switched on.
    """

    frame: int
    target: str
    node: str
    on: bool


@dataclass(frozen=True)
class Released:
    """A person gave an agent back to the rules. It stays as it is until one of them switches it.

    Attributes:
        frame: frame with which it was said; rules may switch it in the next frame.
        target: target id.
        node: the agent.
    """

    frame: int
    target: str
    node: str
