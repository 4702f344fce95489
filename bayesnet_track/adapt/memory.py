"""Rule memory: columns of what the rules remember of T targets of a plate, and what agents contributed.

Contributions are observed of active agents only, so that one that is off must be tried again to be known: the
upper confidence bound of discounted means (D-UCB; Garivier and Moulines, On upper-confidence bound policies
for switching bandit problems, 2011). It draws nothing, so that a run repeats exactly.

A target by itself is a group of one. All arrays are left as they are: a frame makes new ones.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.numerics.arrays import Bools, Floats, Ints
from bayesnet_track.numerics.records import evolve


@dataclass(frozen=True)
class InformationRate:
    """Contributions of agents, the past fading.

    Attributes:
        nats: agent -> sum of its contributions.
        frames: agent -> how many frames of it are remembered. Both sums count a frame exp(-age / memory).
    """

    nats: Mapping[str, float] = field(default_factory=dict)
    frames: Mapping[str, float] = field(default_factory=dict)

    def after(self, contribution: Mapping[str, float], memory: int) -> InformationRate:
        """With a frame more, in which the active agents contributed so many nats."""
        fade = math.exp(-1.0 / memory)
        nats = {agent: value * fade for agent, value in self.nats.items()}
        frames = {agent: value * fade for agent, value in self.frames.items()}
        for agent, value in contribution.items():
            nats[agent] = nats.get(agent, 0.0) + value
            frames[agent] = frames.get(agent, 0.0) + 1.0
        return InformationRate(nats, frames)

    def mean(self, agent: str) -> float | None:
        """Its remembered mean contribution, nats; None when it was never active."""
        frames = self.frames.get(agent, 0.0)
        return self.nats[agent] / frames if frames > 0.0 else None

    def hope(self, agent: str, exploration: float) -> float:
        """The mean and what its uncertainty lets hope for, nats; inf for an agent that was never active.

        mean + exploration sqrt(ln(1 + sum n) / n), n the remembered frames.
        """
        mean = self.mean(agent)
        if mean is None:
            return math.inf
        total = sum(self.frames.values())
        return mean + exploration * math.sqrt(math.log1p(total) / self.frames[agent])


BASELINE_WINDOW = 50
BASELINE_MINIMUM = 10

Streak = tuple[str, str]
"""A condition whose consecutive frames count: its kind, and the node or agent that it is of."""

LOST, UNFIT, FOUND, SEEN, UNSURE = STATUS_STREAKS = tuple(
    (kind, "") for kind in ("lost", "unfit", "found", "seen", "unsure")
)
"""Frames in a row that look lost; the fits of these, minus infinity where UD is too high; that look found; by
a score those that do not look lost, and those that look uncertain or lost."""


@dataclass(frozen=True, eq=False)
class Layout:
    """The columns that the rules of a plate need.

    Attributes:
        agents: its A agents, and the column of each.
        streaks: its S streaks, and the column of each.
        frames: (S,) how many frames in a row each rule asks for.
        nodes: the nodes below the root, and it, that have `adapt` rules.
        rules: key and agent of each rule by which an agent switches itself: its streak.
    """

    agents: Mapping[str, int]
    streaks: Mapping[Streak, int]
    frames: Ints
    nodes: tuple[str, ...]
    rules: tuple[Streak, ...]


@lru_cache(maxsize=64)
def _layout_of(plate: CheckedTarget) -> Layout:
    """The columns that the rules of a plate need."""
    frames = dict.fromkeys(STATUS_STREAKS, plate.lost.frames)
    nodes = tuple(node for node in plate.children if plate.inference(node).adapt is not None)
    for node in nodes:
        rules = plate.inference(node).adapt
        for kind in ("activate", "deactivate"):
            rule = getattr(rules, kind)
            if rule is not None:
                frames[kind, node] = rule.frames
    agent_rules = {
        (key, agent): rule for agent in plate.agents for key, rule in plate.agent(agent).rules.items()
    }
    frames |= {streak: rule.frames for streak, rule in agent_rules.items()}
    return Layout(
        {agent: column for column, agent in enumerate(plate.agents)},
        {streak: column for column, streak in enumerate(frames)},
        np.array(list(frames.values()), dtype=np.int64),
        nodes,
        tuple(agent_rules),
    )


@dataclass(frozen=True, eq=False)
class Baseline:
    """The last values of UD of a node, seen with one set of active agents.

    Attributes:
        values: (T, W) px^2, filled from the right.
        counts: (T,) how many there are.
        medians: (T,) px^2; NaN while there are fewer than 10.
    """

    values: Floats
    counts: Ints
    medians: Floats

    @classmethod
    def empty(cls, count: int) -> Baseline:
        """Of targets of which nothing was seen."""
        return cls(
            np.zeros((count, BASELINE_WINDOW)), np.zeros(count, dtype=np.int64), np.full(count, np.nan)
        )

    def append(self, ud_px2: Floats, adds: Bools) -> Baseline:
        """With one more value (T,) where it `adds` (T,)."""
        from bayesnet_track.numerics.kernels.row_kernels import append_medians

        return Baseline(*append_medians(self.values, self.counts, ud_px2, adds, BASELINE_MINIMUM))

    @classmethod
    def join(cls, groups: Sequence[Baseline]) -> Baseline:
        """The baselines of several groups of targets, one after the other."""
        return cls(
            np.concatenate([group.values for group in groups]),
            np.concatenate([group.counts for group in groups]),
            np.concatenate([group.medians for group in groups]),
        )

    def take(self, rows: Ints) -> Baseline:
        """The baselines of some targets."""
        return Baseline(self.values[rows], self.counts[rows], self.medians[rows])


@dataclass(frozen=True, eq=False)
class RuleMemory:
    """Memory of the rules for T targets of a plate.

    The baseline of a node's UD is the median of the last 50 values seen with the smallest set of active
    agents below the node that has at least 10 of them: the level of the agents that stay on. Fewer agents are
    less sure, so sets larger than the present one are not asked: until 10 values are seen with so few agents,
    the level is unknown. Values above the node's activation level, of a lost target, or without an active
    agent do not count.

    Attributes:
        layout: which columns there are.
        counts: (T, S) consecutive frames on which conditions held.
        values: (T, S, F) the values of the last of them, filled from the right: the one closest to the level
            is where a rule that fires now would not have fired.
        baselines: node and set of active agents below it -> the last values of UD.
        nats: (T, A) sums of the agents' contributions while active.
        frames: (T, A) frames that count in them.
        missed: (T, A) frames in a row in which agents gave no answer.
        worth: of each target: governor whose rules go by it -> what its agents contributed, the past fading.
    """

    layout: Layout
    counts: Ints
    values: Floats
    baselines: Mapping[tuple[str, frozenset[str]], Baseline]
    nats: Floats
    frames: Ints
    missed: Ints
    worth: tuple[Mapping[str, InformationRate], ...]

    def __len__(self) -> int:
        """T."""
        return len(self.counts)

    @classmethod
    def empty(cls, plate: CheckedTarget, count: int = 1) -> RuleMemory:
        """Of targets that start."""
        layout = _layout_of(plate)
        streaks, agents = (count, len(layout.streaks)), (count, len(layout.agents))
        return cls(
            layout,
            np.zeros(streaks, dtype=np.int64),
            np.zeros((*streaks, int(layout.frames.max()))),
            {},
            np.zeros(agents),
            np.zeros(agents, dtype=np.int64),
            np.zeros(agents, dtype=np.int64),
            ({},) * count,
        )

    @classmethod
    def join(cls, groups: Sequence[RuleMemory]) -> RuleMemory:
        """The memory of several groups of targets of a plate, one after the other."""
        if len(groups) == 1:
            return groups[0]
        keys = dict.fromkeys(key for group in groups for key in group.baselines)
        baselines = {
            key: Baseline.join([group.baselines.get(key) or Baseline.empty(len(group)) for group in groups])
            for key in keys
        }
        return cls(
            groups[0].layout,
            np.concatenate([group.counts for group in groups]),
            np.concatenate([group.values for group in groups]),
            baselines,
            np.concatenate([group.nats for group in groups]),
            np.concatenate([group.frames for group in groups]),
            np.concatenate([group.missed for group in groups]),
            tuple(rates for group in groups for rates in group.worth),
        )

    def take(self, rows: Sequence[int] | Ints | Bools) -> RuleMemory:
        """The memory of some targets."""
        picked = np.arange(len(self))[np.asarray(rows)] if len(rows) else np.empty(0, dtype=np.int64)
        return RuleMemory(
            self.layout,
            self.counts[picked],
            self.values[picked],
            {key: baseline.take(picked) for key, baseline in self.baselines.items()},
            self.nats[picked],
            self.frames[picked],
            self.missed[picked],
            tuple(self.worth[row] for row in picked.tolist()),
        )

    def levels_px2(self, node: str, active: frozenset[str]) -> Floats:
        """(T,) the baselines of a node's UD with `active` switched on below it; NaN while unknown.

        With nobody active, that of the smallest set known.
        """
        sets = [
            agents
            for name, agents in self.baselines
            if name == node and (len(agents) <= len(active) or not active)
        ]
        if len(sets) == 1:
            return self.baselines[node, sets[0]].medians
        levels = np.full(len(self), np.nan)
        for agents in sorted(sets, key=lambda agents: (len(agents), sorted(agents)), reverse=True):
            medians = self.baselines[node, agents].medians
            levels = np.where(np.isnan(medians), levels, medians)
        return levels

    def level_px2(self, node: str, active: frozenset[str]) -> float | None:
        """The first target's baseline of a node's UD (`levels_px2`); None while unknown."""
        level = float(self.levels_px2(node, active)[0])
        return None if level != level else level

    def count(self, streak: Streak) -> int:
        """The first target's frames in a row."""
        return int(self.counts[0, self.layout.streaks[streak]])

    def streak_values(self, streak: Streak) -> tuple[float, ...]:
        """The first target's values of the last of these frames, as many as the rule asks for."""
        column = self.layout.streaks[streak]
        size = min(int(self.counts[0, column]), int(self.layout.frames[column]))
        return tuple(self.values[0, column, self.values.shape[2] - size :].tolist())

    def helpfulness(self, agent: str) -> float | None:
        """The first target's mean contribution of an active agent, nats; None when it never was active."""
        column = self.layout.agents[agent]
        frames = int(self.frames[0, column])
        return float(self.nats[0, column]) / frames if frames else None

    def replaced(self, row: int, ended: Collection[Streak], missed: Mapping[str, int] | None) -> RuleMemory:
        """With streaks of one target at 0, and in how many frames in a row its agents gave no answer."""
        counts, frames = self.counts.copy(), self.missed.copy()
        counts[row, [self.layout.streaks[streak] for streak in ended]] = 0
        if missed is not None:
            frames[row] = [missed.get(agent, 0) for agent in self.layout.agents]
        return evolve(self, counts=counts, missed=frames)

    def without(self, kinds: Collection[str]) -> RuleMemory:
        """With the streaks of these kinds at 0."""
        counts = self.counts.copy()
        counts[:, [column for (kind, _), column in self.layout.streaks.items() if kind in kinds]] = 0
        return evolve(self, counts=counts)
