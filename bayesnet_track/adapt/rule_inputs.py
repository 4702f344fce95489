"""Rule inputs of one target in one frame: its measures, and the conditions that rules apply to them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from bayesnet_track.adapt.memory import RuleMemory
from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.graph.rules.agent_rule import AgentMeasure
from bayesnet_track.graph.spec import Concentrated, Learn, Level
from bayesnet_track.journal.target_net import Cause, Concentration, HiddenCause, TargetNet
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.distributions import vouched_share


@dataclass(frozen=True)
class Reading:
    """A level applied to one value of UD, both in the level's unit, or to the score."""

    unit: str
    level: float
    value: float
    ud_px2: float
    scale_px2: float

    @property
    def above(self) -> bool:
        """The value lies above the level: of UD, things are not well."""
        return self.value > self.level

    @property
    def below(self) -> bool:
        """The value lies below the level: of UD, all is well."""
        return self.value < self.level

    def cause(self, frames: int, turning: float) -> Cause:
        """The numbers for the journal."""
        return Cause(self.unit, self.level, self.value, frames, turning, self.ud_px2, self.scale_px2)

    def cause_above(self, frames: int, values: tuple[float, ...]) -> Cause:
        """The cause of a rule that asks for UD above the level; `values` are those of its streak."""
        return self.cause(frames, min(values))

    def cause_below(self, frames: int, values: tuple[float, ...]) -> Cause:
        """The cause of a rule that asks for UD below the level."""
        return self.cause(frames, max(values))


def read_level(level: Level, ud_px2: float, area_px2: float, quiet_px2: float | None) -> Reading | None:
    """`ud_px2` in the level's unit; None while the baseline that it needs is unknown."""
    scale = scale_of(level, area_px2, quiet_px2)
    return None if scale is None else Reading(level.kind, level.settings, ud_px2 / scale, ud_px2, scale)


def scale_of(level: Level, area_px2: float, quiet_px2: float | None) -> float | None:
    """The level's unit in px^2; None while the baseline that it needs is unknown."""
    scale = {"ud_px2": 1.0, "ud_box": area_px2, "ud_baseline": quiet_px2}[level.kind]
    return None if scale is None or scale <= 0 else scale


@dataclass(frozen=True)
class Inside:
    """Share of a belief around its mode.

    Attributes:
        share: of the belief, inside the window.
        trials: effective hypotheses that know it; inf when it is exact.
        radius_px: of the window.
    """

    share: float
    trials: float
    radius_px: float


@dataclass(frozen=True)
class Tested:
    """The binomial test applied to one belief.

    `value` is the largest share that the test grants (the lower Clopper-Pearson bound): the belief is
    concentrated when it reaches the share that is asked for, which is the case exactly when
    P(X >= inside | trials, share) <= 1 - confidence.
    """

    test: Concentrated
    inside: Inside
    value: float
    ud_px2: float

    @property
    def above(self) -> bool:
        """The test cannot say that the belief is concentrated: things are not well."""
        return self.value < self.test.share

    @property
    def below(self) -> bool:
        """It can: all is well."""
        return not self.above

    def cause_above(self, frames: int, values: tuple[float, ...]) -> Concentration:
        """The cause of a rule that asks for no concentration; `values` are those of its streak."""
        return self._cause(frames, max(values))

    def cause_below(self, frames: int, values: tuple[float, ...]) -> Concentration:
        """The cause of a rule that asks for concentration."""
        return self._cause(frames, min(values))

    def _cause(self, frames: int, turning: float) -> Concentration:
        test, window = self.test, self.inside
        return Concentration(
            share=test.share,
            within_box=test.within_box,
            confidence=test.confidence,
            inside=window.share,
            trials=window.trials,
            vouched=self.value,
            frames=frames,
            turning=turning,
            radius_px=window.radius_px,
            ud_px2=self.ud_px2,
        )


def apply_test(test: Concentrated, window: Inside, ud_px2: float) -> Tested:
    """The test on what lies inside its window.

    >>> few = apply_test(Concentrated(share=0.9), Inside(1.0, 20.0, 10.0), 25.0)
    >>> more = apply_test(Concentrated(share=0.9), Inside(1.0, 40.0, 10.0), 25.0)
    >>> few.below, more.below
    (False, True)
    """
    return Tested(test, window, vouched_share(window.share, window.trials, test.confidence), ud_px2)


PartStatus = Literal["seen", "hidden", "unwatched"]


@dataclass(frozen=True, eq=False)
class PartMeasure:
    """Measures of a part in one step.

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
    """Measures of the net in one step.

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


@dataclass(frozen=True, eq=False, kw_only=True)
class GroupMeasures:
    """Measures of T targets of a plate, as columns of what rules ask for in every frame.

    Attributes:
        uds: inference node -> (T,) UD of its belief, px^2.
        areas: (T,) of the estimates, px^2.
        fits: (T,) as in `Measures`.
        agents: those who said something, A of them.
        nats: (T, A) contributions.
        of: row -> all that is measured of one target.
        part_areas: part -> (T,) areas of the estimates, px^2.
        insides: (node, radius) -> what of each belief lies within, for the windows that rules ask about.
    """

    uds: Mapping[str, Floats]
    areas: Floats
    fits: Floats
    agents: Sequence[str]
    nats: Floats
    of: Callable[[int], Measures]
    part_areas: Mapping[str, Floats] = field(default_factory=dict)
    insides: Mapping[tuple[str, float], Sequence[Inside]] = field(default_factory=dict)

    @classmethod
    def of_each(cls, measures: Sequence[Measures]) -> GroupMeasures:
        """The columns of targets that were measured one by one, by the same agents."""
        head = measures[0]
        agents = (*head.contribution,)
        nats = [[measured.contribution[agent] for agent in agents] for measured in measures]
        return cls(
            uds={node: np.array([measured.ud_px2[node] for measured in measures]) for node in head.ud_px2},
            areas=np.array([measured.area_px2 for measured in measures]),
            fits=np.array([measured.fit for measured in measures]),
            agents=agents,
            nats=np.array(nats).reshape(len(measures), len(agents)),
            of=measures.__getitem__,
            part_areas={
                part: np.array([measured.parts[part].area_px2 for measured in measures])
                for part in head.parts
            },
            insides={key: [measured.inside[key] for measured in measures] for key in head.inside},
        )


@dataclass(frozen=True)
class OnCallOutcome:
    """Outcome of the agents on call in one frame.

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


@dataclass(frozen=True, eq=False)
class RuleInputs:
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
    call: OnCallOutcome | None = None
    stride: int = 1


@dataclass(frozen=True, eq=False)
class AgentColumns:
    """Measures of one agent for T targets in one frame.

    Attributes:
        agent: the agent.
        rows: what the rules of each target see.
    """

    agent: str
    rows: Sequence[RuleInputs]

    def measured(self, quantity: AgentMeasure) -> Floats:
        """(T,) the quantity; NaN where the agent gave no evidence, is off, or was switched by hand."""
        return np.array([self._measured(row, quantity) for row in self.rows])

    def _measured(self, row: RuleInputs, quantity: AgentMeasure) -> float:
        if self.agent not in row.net.active or self.agent in row.net.by_hand:
            return np.nan
        values: Mapping[str, float] = getattr(row.measures, quantity)
        return values.get(self.agent, np.nan)


def baseline_level(
    plate: CheckedTarget, active: frozenset[str], memory: RuleMemory, node: str
) -> float | None:
    """The measured baseline of a node's UD in px^2 with the agents that are `active`; None while unknown."""
    return memory.level_px2(node, plate.below[node] & active)


def read_ud(inputs: RuleInputs, memory: RuleMemory, node: str, level: Level) -> Reading | None:
    """The UD of an inference node in the level's unit, or the score; None while it cannot be told."""
    if level.kind == "score":
        ud_px2 = inputs.measures.ud_px2[node]
        return None if inputs.score is None else Reading("score", level.settings, inputs.score, ud_px2, 1.0)
    quiet = (
        baseline_level(inputs.plate, inputs.net.active, memory, node) if level.kind == "ud_baseline" else None
    )
    return read_level(level, inputs.measures.ud_px2[node], inputs.measures.area_of(node), quiet)


def count_left_out(plate: CheckedTarget, active: AbstractSet[str], node: str) -> int:
    """Number of the active agents below an inference node its `adapt.agents` leaves out."""
    adapt = plate.inference(node).adapt
    if adapt is None or adapt.agents is None:
        return 0
    descendants = plate.below[node]
    return sum(plate.governor[agent] not in (node, *descendants) for agent in active & descendants)


def learning_rate(rule: Learn | None, ud_px2: float, area_px2: float, quiet_px2: float | None) -> float:
    """Share of the largest rate at this UD: (1 - tanh(2 (UD - theta) / theta)) / 2, 0 from theta upward.

    Thesis eq. 2.16. As printed it applies to every target whose UD is below theta and replaces more than half
    of the reference there, so learning multiplies it by a largest rate (corrected).

    >>> from bayesnet_track.graph.spec import Learn, Level
    >>> rule = Learn(below=Level(ud_px2=100.0))
    >>> round(learning_rate(rule, 50.0, 1.0, None), 4), learning_rate(rule, 100.0, 1.0, None)
    (0.8808, 0.0)
    """
    scale = None if rule is None else scale_of(rule.below, area_px2, quiet_px2)
    if rule is None or scale is None:
        return 0.0
    value, level = ud_px2 / scale, rule.below.settings
    return 0.0 if value >= level else 0.5 * (1.0 - math.tanh(2.0 * (value - level) / level))


def largest_rate(rule: Learn | None, rate: float, frames: int) -> float:
    """The largest rate of an agent whose own is `rate`, so many frames after its target started.

    The reference of the first frame is one sample. At a rate of 1 / n in the n-th frame it becomes the mean
    of n samples; a small constant rate would keep most of the first one for long.

    >>> from bayesnet_track.graph.spec import Learn, Level
    >>> rule = Learn(below=Level(ud_px2=100.0), early_rate=1.0)
    >>> largest_rate(rule, 0.02, 1), largest_rate(rule, 0.02, 99), largest_rate(rule, 0.0, 1)
    (0.5, 0.02, 0.0)
    """
    early = 0.0 if rule is None else rule.early_rate
    return max(rate, early / (frames + 1)) if rate > 0.0 else 0.0
