"""Decisions that keep a run within its time: what is done without, and what is taken back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Shed:
    """Frames were late: the agent that says least per millisecond is switched off until there is time.

    Attributes:
        frame: frame whose numbers caused it.
        target: target id.
        node: the agent.
        spent_ms: median of what the late frames took.
        budget_ms: what a frame may take.
        late: how many of the last frames were late.
        within: how many frames those were.
        turning_ms: the budget at which it would have stayed on: so few frames would have been late.
        index: agent -> mean contribution per declared cost, nats per ms, for every agent of this target that
            could be done without.
    """

    frame: int
    target: str
    node: str
    spent_ms: float
    budget_ms: float
    late: int
    within: int
    turning_ms: float
    index: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class TakenBack:
    """There is time again: an agent that was switched off for want of it is switched on.

    Attributes:
        frame: frame whose numbers caused it.
        target: target id.
        node: the agent.
        spent_ms: the most that one of the frames in time took.
        expected_ms: the same with the agent, by declared costs.
        budget_ms: what a frame may take.
        frames: how many frames in a row were in time.
    """

    frame: int
    target: str
    node: str
    spent_ms: float
    expected_ms: float
    budget_ms: float
    frames: int


@dataclass(frozen=True)
class ParticlesLimited:
    """Frames were late with no agent left to do without: fewer hypotheses. Or there is time again for more.

    Attributes:
        frame: frame whose numbers caused it.
        target: target id.
        most: most hypotheses from now on; null when there is no limit any more.
        before: how many there were.
        spent_ms: what frames took: the median of the late ones, or the most of those in time.
        budget_ms: what a frame may take.
    """

    frame: int
    target: str
    most: int | None
    before: int
    spent_ms: float
    budget_ms: float
