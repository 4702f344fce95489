"""Inputs and memory of the rules for T targets of a plate: one update of streaks and baselines for all."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bayesnet_track.adapt.memory import (
    FOUND,
    LOST,
    SEEN,
    STATUS_STREAKS,
    UNFIT,
    UNSURE,
    Baseline,
    InformationRate,
    RuleMemory,
)
from bayesnet_track.adapt.rule_inputs import AgentColumns, GroupMeasures, RuleInputs, apply_test
from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.graph.settings.net import AGENT_RULES
from bayesnet_track.graph.spec import Adapt, Condition, Level, Lost
from bayesnet_track.numerics.arrays import Bools, Floats, Ints
from bayesnet_track.numerics.records import evolve

STATUSES = ("tracking", "uncertain", "lost")
"""By their number in `RuleColumns.statuses`."""


@dataclass(frozen=True, eq=False, kw_only=True)
class RuleColumns:
    """Inputs of the rules in one frame: columns of T targets of a plate with the same active agents.

    Attributes:
        plate: the checked plate.
        active: the agents that are active, without those that failed or gave no answer.
        statuses: (T,) places in `STATUSES`.
        measures: what was measured.
        see: row -> all that the rules of one target see.
        adaptable: agents that can act locally before they stop.
        hidden: (T,) expected shares that others hide; None where nobody does.
        score: (T,) probabilities of being on target, or None.
        existence: (T,) probabilities that they exist, or None.
        is_hidden: (T,) whether they probably cannot be seen, by their modes; None where these do not say.
        is_unasked: (T,) whether all active agents wait for detections and nobody looked; None where somebody
            did.
        pending: (T,) whether something else than a streak asks for a decision; None where nothing does.
    """

    plate: CheckedTarget
    active: frozenset[str]
    statuses: Ints
    measures: GroupMeasures
    see: Callable[[int], RuleInputs]
    adaptable: frozenset[str] = frozenset()
    hidden: Floats | None = None
    score: Floats | None = None
    existence: Floats | None = None
    is_hidden: Bools | None = None
    is_unasked: Bools | None = None
    pending: Bools | None = None

    def __len__(self) -> int:
        """T."""
        return len(self.statuses)

    def area_of(self, node: str) -> Floats:
        """(T,) areas of the estimates that a node is about: of the part, or of the whole target, px^2."""
        return self.measures.part_areas.get(node, self.measures.areas)


def remember_frame(inputs: RuleColumns, memory: RuleMemory) -> tuple[RuleMemory, Bools]:
    """The rules' memory with this frame, and (T,) of which targets something may have to be decided."""
    from bayesnet_track.numerics.kernels.judging_kernels import extend_streaks

    layout, count = memory.layout, len(memory)
    memory = _with_contributions(inputs, memory, _with_uds(inputs, memory))
    shape = memory.counts.shape
    streaks = Streaks(np.zeros(shape, np.bool_), np.zeros(shape), np.zeros(shape, np.bool_))
    if layout.rules:
        _read_agents(inputs, memory, streaks)
    for node in layout.nodes:
        _govern(inputs, memory, node, streaks)
    two_levels = _judge(inputs, memory, streaks)
    counts, values = extend_streaks(
        memory.counts, memory.values, streaks.holds, streaks.values, streaks.keeps
    )
    is_due = _due(inputs, counts, int(layout.frames[0]), two_levels)
    status = len(STATUS_STREAKS)
    if shape[1] > status:
        is_due |= (counts[:, status:] >= layout.frames[status:]).any(axis=1)
    for key, agent in layout.rules:
        if AGENT_RULES[key].adapts_first and agent in inputs.adaptable:
            is_due |= counts[:, layout.streaks[key, agent]] > 0
    if inputs.pending is not None:
        is_due |= inputs.pending
    if memory.missed.any():
        is_due |= memory.missed.any(axis=1)
    if not inputs.active:
        is_due = np.ones(count, np.bool_)
    return evolve(memory, counts=counts, values=values), is_due


@dataclass(frozen=True, eq=False)
class Streaks:
    """S conditions of T targets in one frame, filled in place.

    Attributes:
        holds: (T, S) whether they hold.
        values: (T, S) the frame's values.
        keeps: (T, S) whether the frame says nothing: they stay as they are.
    """

    holds: Bools
    values: Floats
    keeps: Bools


def _with_contributions(
    inputs: RuleColumns, memory: RuleMemory, baselines: Mapping[tuple[str, frozenset[str]], Baseline]
) -> RuleMemory:
    """With what the active agents contributed, and the frame's baselines."""
    layout, agents, contributed = memory.layout, inputs.measures.agents, inputs.measures.nats
    if tuple(agents) == tuple(layout.agents):
        nats, frames = memory.nats + contributed, memory.frames + 1
    else:
        nats, frames = memory.nats.copy(), memory.frames.copy()
        for place, agent in enumerate(agents):
            nats[:, layout.agents[agent]] += contributed[:, place]
            frames[:, layout.agents[agent]] += 1
    rates = memory.worth
    for node in layout.nodes:
        rules = inputs.plate.inference(node).adapt
        if rules is not None and _goes_by_information(rules):
            governed = [k for k, agent in enumerate(agents) if inputs.plate.governor[agent] == node]
            contributions = [{agents[k]: row[k] for k in governed} for row in contributed.tolist()]
            frames_kept = rules.information.memory_frames
            rates = tuple(
                {**rate, node: rate.get(node, InformationRate()).after(contribution, frames_kept)}
                for rate, contribution in zip(rates, contributions, strict=True)
            )
    return evolve(memory, nats=nats, frames=frames, worth=rates, baselines=baselines)


def _with_uds(inputs: RuleColumns, memory: RuleMemory) -> Mapping[tuple[str, frozenset[str]], Baseline]:
    """The baselines with this frame's UD, where it is a quiet one."""
    baselines, is_tracked = dict(memory.baselines), inputs.statuses == 0
    for node, ud in inputs.measures.uds.items():
        agents, adds = inputs.plate.below[node] & inputs.active, is_tracked
        if not agents:
            continue
        rules = inputs.plate.inference(node).adapt
        if rules is not None and rules.activate is not None:
            level, test = rules.activate.above, rules.activate.unless
            if level is None or level.kind != "score":
                adds = adds & ~_read(inputs, memory, node, level, test).is_above
        baseline = baselines.get((node, agents)) or Baseline.empty(len(memory))
        baselines[node, agents] = baseline.append(ud, adds)
    return baselines


class _Reading(NamedTuple):
    """A rule's condition applied to T beliefs: (T,) values, and which lie above and below the level."""

    values: Floats
    is_above: Bools
    is_below: Bools


def _read(
    inputs: RuleColumns, memory: RuleMemory, node: str, level: Level | None, test: Condition | None,
    beside_more: bool = False,
) -> _Reading:  # fmt: skip
    """A condition's reading; neither above nor below while it cannot be told.

    Beside more agents than are on, the baseline of these counts where that of so few is unknown.
    """
    if level is not None and level.kind == "score":
        values = np.full(len(inputs), np.nan) if inputs.score is None else inputs.score
        return _Reading(values, values > level.settings, values < level.settings)
    if level is not None and level.kind == "ud_px2":
        values = inputs.measures.uds[node]
        return _Reading(values, values > level.settings, values < level.settings)
    if level is not None:
        scale = _scale(inputs, memory, node, level)
        if beside_more and level.kind == "ud_baseline":
            is_asked = ~(scale > 0.0) & (inputs.statuses == STATUSES.index("lost"))
            scale = np.where(is_asked, memory.levels_px2(node, frozenset()), scale)
        values = _in_unit(inputs.measures.uds[node], scale)
        return _Reading(values, values > level.settings, values < level.settings)
    insides = None
    if test is not None and test.concentrated is not None:
        insides = inputs.measures.insides.get((node, test.concentrated.within_box))
    if insides is None or test is None or test.concentrated is None:
        nothing = np.zeros(len(inputs), np.bool_)
        return _Reading(np.zeros(len(inputs)), nothing, nothing)
    pairs = zip(insides, inputs.measures.uds[node].tolist(), strict=True)
    shares = np.array([apply_test(test.concentrated, window, ud).value for window, ud in pairs])
    is_above = shares < test.concentrated.share
    return _Reading(shares, is_above, ~is_above)


def _scale(inputs: RuleColumns, memory: RuleMemory, node: str, level: Level) -> Floats:
    """(T,) a level's unit, px^2; not above 0, or NaN, while it is unknown."""
    if level.kind == "ud_px2":
        return np.ones(len(inputs))
    if level.kind == "ud_box":
        return inputs.area_of(node)
    return memory.levels_px2(node, inputs.plate.below[node] & inputs.active)


def _in_unit(ud_px2: Floats, scale: Floats) -> Floats:
    return np.asarray(np.divide(ud_px2, scale, out=np.full(len(scale), np.nan), where=scale > 0.0))


def _read_agents(inputs: RuleColumns, memory: RuleMemory, streaks: Streaks) -> None:
    """Fill in the streaks of the rules by which agents switch themselves.

    A streak ends when its agent gives no evidence, and while the target is lost: nobody can be sure of what
    cannot be seen, and the agents are needed when it comes back.
    """
    rules = memory.layout.rules
    rows = [inputs.see(row) for row in range(len(inputs))]
    is_seen = inputs.statuses < STATUSES.index("lost")
    for key, agent in rules:
        rule, column = inputs.plate.agent(agent).rules[key], memory.layout.streaks[key, agent]
        values, level = rule.values(AgentColumns(agent, rows)), rule.level
        if isinstance(level, Level):
            values = _in_unit(values, _scale(inputs, memory, inputs.plate.root, level))
            level = level.settings
        is_beyond = values > level if rule.relation == ">" else values < level
        streaks.holds[:, column], streaks.values[:, column] = is_beyond & is_seen, values


def _govern(inputs: RuleColumns, memory: RuleMemory, node: str, streaks: Streaks) -> None:
    """UD above the level that activates, and below the one that deactivates."""
    rules = inputs.plate.inference(node).adapt
    assert rules is not None
    if rules.activate is not None:
        column = memory.layout.streaks["activate", node]
        reading = _read(inputs, memory, node, rules.activate.above, rules.activate.unless, beside_more=True)
        streaks.holds[:, column], streaks.values[:, column] = reading.is_above, reading.values
    if rules.deactivate is not None:
        column = memory.layout.streaks["deactivate", node]
        reading = _read(inputs, memory, node, rules.deactivate.below, rules.deactivate.when)
        streaks.holds[:, column], streaks.values[:, column] = reading.is_below, reading.values


def _judge(inputs: RuleColumns, memory: RuleMemory, streaks: Streaks) -> bool:
    """Fill in the streaks of the status; whether it is judged by two levels.

    By a probability where there is one, else by UD and fit. That nothing fits is no reason while half of the
    target is known to be hidden, nor where its modes say whether it is; that UD is high is one.
    """
    rule = inputs.plate.lost
    score, low, columns = inputs.existence, None, memory.layout.streaks
    if score is not None and rule.existence_rule is not None:
        low = rule.existence_rule[1]
    if low is None:
        score, low = inputs.score, rule.score_below
    high = low if rule.uncertain_below is None else rule.uncertain_below
    if score is None or low is None or high is None:
        low = high = 0.0
        _judge_fits(inputs, memory, rule, streaks)
    else:
        is_low, is_doubtful = score < low, score < high
        judged = {LOST: is_low, UNSURE: is_doubtful, SEEN: ~is_low, FOUND: ~is_doubtful}
        for streak, holds in judged.items():
            streaks.holds[:, columns[streak]], streaks.values[:, columns[streak]] = holds, score
        streaks.keeps[:, columns[UNFIT]] = True
    if inputs.is_hidden is not None:
        rows, size = np.flatnonzero(inputs.is_hidden), len(STATUS_STREAKS)
        streaks.holds[rows, :size], streaks.keeps[rows, :size] = False, False
        streaks.keeps[rows, columns[UNFIT]] = True
    return low < high


def _judge_fits(inputs: RuleColumns, memory: RuleMemory, rule: Lost, streaks: Streaks) -> None:
    """Fill in who looks lost by UD and fit.

    On a frame on which nothing fits, no level of UD would have kept the target from looking lost. One in
    which nobody looked says something by UD alone: that it is high.
    """
    reading = _read(inputs, memory, inputs.plate.root, rule.above, None)
    fits, is_wide = inputs.measures.fits >= rule.fit_below, reading.is_above
    if inputs.hidden is not None:
        fits |= inputs.hidden >= 0.5
    if inputs.is_hidden is not None:
        fits[:] = True
    if inputs.is_unasked is not None:
        fits |= inputs.is_unasked
    looks_found, values = fits > is_wide, np.fmax(reading.values, 0.0)  # 0 where it cannot be told
    lost, unfit, recovered, recognised = range(4)  # places in `STATUS_STREAKS`, which come first
    streaks.holds[:, :recovered] = ~looks_found[:, None]
    streaks.holds[:, recovered] = looks_found
    streaks.values[:, lost] = np.where(fits, values, np.inf)
    streaks.values[:, unfit] = np.where(is_wide, -np.inf, inputs.measures.fits)
    streaks.values[:, recovered] = values
    streaks.keeps[:, recognised : len(STATUS_STREAKS)] = True
    if inputs.is_unasked is not None:
        streaks.keeps[inputs.is_unasked & ~is_wide, :recognised] = True


def _due(inputs: RuleColumns, counts: Ints, frames: int, two_levels: bool) -> Bools:
    """(T,) whose status may change."""
    if inputs.is_hidden is None and not two_levels and not inputs.statuses.any():
        return np.asarray(counts[:, 0] >= frames)  # the usual case: all are tracked
    lost, _, recovered, recognised, unsure = (counts[:, : len(STATUS_STREAKS)] >= frames).T
    is_lost = inputs.statuses == STATUSES.index("lost")
    is_due = np.where(is_lost, recovered, lost)
    if two_levels or (inputs.statuses == STATUSES.index("uncertain")).any():
        is_due |= np.where(is_lost, recognised, np.where(inputs.statuses == 0, unsure, recovered))
    if inputs.is_hidden is not None:
        is_due = np.where(inputs.is_hidden, ~is_lost, is_due)
    return np.asarray(is_due)


def _goes_by_information(rules: Adapt) -> bool:
    """True where rules choose agents by what they contributed."""
    activates = rules.activate is not None and rules.activate.which == "information_per_ms"
    return activates or (rules.deactivate is not None and rules.deactivate.drop == "min_information_per_ms")
