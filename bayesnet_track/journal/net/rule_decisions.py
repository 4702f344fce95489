"""Decisions of the rules: agents on and off, and what is said of a target."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from bayesnet_track.journal.net.causes import Cause, Concentration, FitCause, ScoreCause


@dataclass(frozen=True)
class Activated:
    """An inference node switched an agent on.

    Attributes:
        frame: frame whose numbers caused it; it works from the next frame on.
        target: target id.
        node: the agent.
        governor: the inference node whose rule fired.
        cause: the numbers; None when it was switched on because no agent was active.
        helpfulness: mean contribution (nats) over the frames in which it was active; None when never measured
            or when the rule does not go by it.
        expected: agent -> expected information per declared cost, nats per ms, for every inactive agent it
            was chosen among by `information_per_ms`; infinite for one that was never active; else empty.
    """

    frame: int
    target: str
    node: str
    governor: str
    cause: Cause | Concentration | None
    helpfulness: float | None = None
    expected: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Deactivated:
    """An inference node switched an agent off.

    Attributes:
        frame: frame whose numbers caused it.
        target: target id.
        node: the agent.
        governor: the inference node whose rule fired.
        cause: the numbers.
        drop: which index chose it: largest_kl, min_contribution_per_ms, min_information_per_ms or
            most_expensive_redundant, most_expensive.
        index: agent -> that index, for every active agent it was chosen among.
        sample_every: it is still evaluated in frames whose number this divides; 0 when it is not.
    """

    frame: int
    target: str
    node: str
    governor: str
    cause: Cause | Concentration
    drop: str
    index: Mapping[str, float] = field(default_factory=dict)
    sample_every: int = 0


@dataclass(frozen=True)
class StatusChanged:
    """A target was lost or found again, or is held uncertainly (the net stays as it is).

    Attributes:
        frame: frame whose numbers caused it.
        target: target id.
        status: tracking, uncertain or lost, from now on.
        cause: the numbers; None when every agent is off, or none saw it.
        reason: why, when there is no cause; what else had to be when it was found again.
    """

    frame: int
    target: str
    status: str
    cause: Cause | ScoreCause | FitCause | None = None
    reason: str = ""
