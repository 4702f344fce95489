"""What the rules of one target see in one frame, and how they read UD."""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field

from bayesnet_track.adapt.conditions import Reading, read_level
from bayesnet_track.adapt.measures import Call, Measures
from bayesnet_track.adapt.memory import RuleMemory
from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.graph.spec import Level
from bayesnet_track.journal.net.target_net import HiddenCause, TargetNet


@dataclass(frozen=True, eq=False)
class Situation:
    """All that the rules of one target see in one frame.

    Attributes:
        frame: frame index.
        target: target id.
        plate: the checked plate.
        net: the live net, agents that failed or gave no answer in this frame already taken out.
        measures: what was measured.
        costs_ms: agent -> declared cost.
        adaptable: agents that can act locally before they stop.
        hidden: expected share of it that a target it is joined with hides.
        score: probability of being on target, or None where the graph does not say how it comes about.
        missed: agent that gave no answer for a reason outside of it -> that reason.
        existence: probability that it exists, or None where the plate has none.
        hiding: probability that it cannot be seen, and above which it counts as lost; None where its modes do
            not say.
        call: what became of the agents on call; None without any.
        stride: of the source's frames every so many-th is tracked.
    """

    frame: int
    target: str
    plate: CheckedTarget
    net: TargetNet
    measures: Measures
    costs_ms: Mapping[str, float]
    adaptable: frozenset[str]
    hidden: float = 0.0
    score: float | None = None
    missed: Mapping[str, str] = field(default_factory=dict)
    existence: float | None = None
    hiding: HiddenCause | None = None
    call: Call | None = None
    stride: int = 1


def quiet_level(plate: CheckedTarget, active: frozenset[str], memory: RuleMemory, node: str) -> float | None:
    """The measured baseline of a node's UD in px^2 with the agents that are `active`; None while unknown."""
    return memory.level_px2(node, plate.below[node] & active)


def read_ud(now: Situation, memory: RuleMemory, node: str, level: Level) -> Reading | None:
    """The UD of an inference node in the level's unit."""
    quiet = quiet_level(now.plate, now.net.active, memory, node) if level.kind == "ud_baseline" else None
    return read_level(level, now.measures.ud_px2[node], now.measures.area_of(node), quiet)


def read_ud_beside_more(now: Situation, memory: RuleMemory, node: str, level: Level) -> Reading | None:
    """As `read_ud`, by the baseline of more agents than are on where that of so few is unknown.

    It is the lower one, so that help is called early; for a target that is lost, of which no baseline is
    measured.
    """
    quiet = memory.level_px2(node, frozenset())
    return read_level(level, now.measures.ud_px2[node], now.measures.area_of(node), quiet)


def count_left_out(plate: CheckedTarget, active: AbstractSet[str], node: str) -> int:
    """How many of the active agents below an inference node its `adapt.agents` leaves out."""
    adapt = plate.inference(node).adapt
    if adapt is None or adapt.agents is None:
        return 0
    below = plate.below[node]
    return sum(plate.governor[agent] not in (node, *below) for agent in active & below)
