"""What one step says of a net and of its parts: the numbers that rules decide on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from bayesnet_track.adapt.conditions import Inside
from bayesnet_track.journal.net.target_net import Cause
from bayesnet_track.numerics.arrays import Floats

PartStatus = Literal["seen", "hidden", "unwatched"]


@dataclass(frozen=True, eq=False)
class PartMeasure:
    """What one step says of a part.

    Attributes:
        box: (4,) its estimate, the mean of its belief, a centre box in px.
        sd: (4,) sds of its belief, px.
        ud_px2: its UD about the estimate.
        status: seen, hidden (its agents look, and see nothing like it) or unwatched (none of them is active).
    """

    box: Floats
    sd: Floats
    ud_px2: float
    status: PartStatus

    @property
    def area_px2(self) -> float:
        """Area of the estimate."""
        return float(self.box[2] * self.box[3])


@dataclass(frozen=True, eq=False)
class Measures:
    """What one step says of the net.

    Attributes:
        ud_px2: inference node -> UD of its belief; the root's about the MAP, another's about its most
            probable hypothesis (thesis eqs. 2.11-2.13, corrected). A node that hears of no agent believes
            what the node above it does. A part's is of its belief given everything, about its estimate.
        agent_ud_px2: active agent -> UD of its normalised likelihood about its maximum-likelihood hypothesis.
        kl: active agent -> KL(belief || agent) at its governor (or the root), nats (eq. 2.14). Zero by
            construction when it is the only one.
        contribution: active agent -> KL(belief || belief without it), nats.
        strength: node -> KL(prior times its message || prior), nats.
        fit: largest geometric mean of a hypothesis' likelihood over the agents that saw something; 1 is a
            perfect match, 0 says that none saw anything. Agents of a hidden part count only where all parts
            are hidden and no other agent sees anything.
        area_px2: area of the estimate.
        silent: active agents that measure and did not see the target.
        inside: (node, radius in sqrt(w h) of its most probable state) -> what of its belief lies within, for
            the windows that its rules ask about.
        parts: part -> its measures, in nets with parts.
        ud_without_px2: active agent -> UD of its governor's belief had it been switched off, about that
            belief's most probable hypothesis; where a rule asks for it (`most_expensive_redundant`).
    """

    ud_px2: Mapping[str, float]
    agent_ud_px2: Mapping[str, float]
    kl: Mapping[str, float]
    contribution: Mapping[str, float]
    strength: Mapping[str, float]
    fit: float
    area_px2: float
    silent: tuple[str, ...] = ()
    inside: Mapping[tuple[str, float], Inside] = field(default_factory=dict)
    parts: Mapping[str, PartMeasure] = field(default_factory=dict)
    ud_without_px2: Mapping[str, float] = field(default_factory=dict)

    def area_of(self, node: str) -> float:
        """Area of the estimate that a node is about: of the part, or of the whole target."""
        return self.parts[node].area_px2 if node in self.parts else self.area_px2


@dataclass(frozen=True)
class Call:
    """What became of the agents on call in one frame.

    Attributes:
        agents: those that are on call, in the order of the graph.
        ran: whether they ran.
        overlap: overlap (IoU) of the estimate without them and with them; 1 where they did not run.
        cause: UD without them, where that made them run before they were due.
    """

    agents: tuple[str, ...]
    ran: bool
    overlap: float = 1.0
    cause: Cause | None = None
