"""The joint belief of joined targets, between the two halves of their frame.

The hypotheses of joined targets are weighed together. Each target keeps its own hypotheses; they get the
weights of the joint belief's marginal, so that all that follows sees it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.adapt.joins import (
    LEVEL_HIDDEN,
    CarriedHypotheses,
    JoinMemory,
    Level,
    PairMemory,
    Reaches,
    spanning_tree,
)
from bayesnet_track.belief.contract import Evidence, Posterior, Step
from bayesnet_track.belief.gaussian.belief import GaussianPosterior
from bayesnet_track.belief.motion.modes import FIELD
from bayesnet_track.belief.particles.belief import reweight_step
from bayesnet_track.engine.attachment import Carriers, carriers_of, particles, report_carried, without_ride
from bayesnet_track.engine.filtering import Filtered
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.rows.filtered_rows import FilteredTargets
from bayesnet_track.engine.rows.on_others import logs_on
from bayesnet_track.engine.stacked import relate_gaussians
from bayesnet_track.graph.expressions.distributions import LinearNormal, linear_normals_of
from bayesnet_track.graph.expressions.parse import parse
from bayesnet_track.graph.settings.lifecycle import Join
from bayesnet_track.inference.factors import PairFlaw, Weigh, pair_factor
from bayesnet_track.inference.joint import Edge, Marginal, Member, Pair, joint_marginals
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.faults import PairFactorChanged
from bayesnet_track.journal.events.joins import OcclusionChanged, RingChanged
from bayesnet_track.journal.metrics import JoinMetrics
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.log_weights import DegenerateWeights, LogWeights
from bayesnet_track.numerics.records import evolve

Steps = dict[str, Step[Posterior]]

HIDDEN, SEEN = 0.5, 0.3
"""Hidden share above which a target is reported as hidden, and at or below which to be seen again."""

DEEPEST = 20.0
"""Nats below the best hypothesis at which the worst one counts at most."""


@dataclass(frozen=True, eq=False)
class JointBelief:
    """Results of the joint beliefs of one frame.

    Attributes:
        filtered: target -> the first half of its frame, with the weights of the joint belief.
        memory: what is remembered.
        events: what is written down.
    """

    filtered: FilteredTargets
    memory: JoinMemory
    events: tuple[Event, ...] = ()


@dataclass(frozen=True, eq=False)
class _Tree:
    """Along which pairs the joint belief is computed.

    Attributes:
        pairs: joined pair -> what was remembered of it, predicted to this frame.
        left_out: pair that would close a ring -> the targets of that ring.
        edges: the tree's.
        closing: those that are left out.
        flaws: pair with a factor -> what is wrong with it, once the joint belief is computed.
        gaussian: pairs of Gaussian beliefs, which are related by one Gaussian of all, rings included.
    """

    pairs: Mapping[Pair, PairMemory]
    left_out: Mapping[Pair, tuple[str, ...]]
    edges: tuple[Edge, ...]
    closing: tuple[Edge, ...]
    flaws: Mapping[Pair, PairFlaw] = field(default_factory=dict)
    gaussian: Sequence[Pair] = ()


def join_targets(work: FrameContext, memory: JoinMemory, filtered: FilteredTargets) -> JointBelief:
    """The joint belief of all joined targets, and what follows from it for each."""
    if not work.engine.joins:
        return JointBelief(filtered, memory)
    start = work.engine.clock()
    levels, measured = levels_of(memory.levels, filtered)
    tree = _tree(work, memory, filtered)
    marginals, orders = _marginals(work, tree, levels, filtered)
    stacked, crosses = relate_gaussians(work, _linear_factors(work, tree), memory.crosses, filtered)
    pairs, events = _update_pairs(work.frame.index, tree, orders)
    carriers = carriers_of(work, memory)
    steps, metrics, carried = _split_joint(carriers, marginals, pairs, filtered)
    steps |= stacked
    centres = {carrier: filtered[carrier].step.posterior.mean[:2] for carrier, _ in carriers.values()}
    levels = levels_after(memory.levels, measured, metrics, filtered)
    joined = replace(memory, pairs=pairs, levels=levels, carried=carried, centres=centres, crosses=crosses)
    joined = report_hidden(work.frame.index, metrics, joined, events)
    joined = report_carried(work.frame.index, metrics, carriers, joined, events)
    work.charge("joins", start)
    targets = {
        name: _joined(target, steps[name], metrics[name]) if name in metrics else target
        for name, target in filtered.others.items()
    }
    messages = {name: marginal.log_likelihood for name, marginal in marginals.items()}
    groups = [group.reweighted(messages, metrics) for group in filtered.groups]
    return JointBelief(FilteredTargets(groups, targets, filtered.order), joined, tuple(events))


def reaches_of(names: Sequence[str], boxes: Floats, variances: Floats) -> Reaches:
    """Places of targets by their beliefs, with mean boxes (T, 4) and variances (T, 4) of them."""
    return Reaches(names, boxes, np.sqrt(np.clip(variances[:, :2], 0.0, None)))


# ------------------------------------------------------------------------------------ the joint belief


def _joined(target: Filtered, step: Step[Posterior], metrics: JoinMetrics) -> Filtered:
    modes = None if target.modes is None else target.modes.joined(step.posterior)
    return evolve(target, step=step, join=metrics, modes=modes)


def _tree(work: FrameContext, memory: JoinMemory, filtered: FilteredTargets) -> _Tree:
    """The pairs of this frame, and along which of them evidence is shared."""
    rules = {pair: work.engine.joins[join.rule] for pair, join in work.net.joins.items()}
    pairs: dict[Pair, PairMemory] = {}
    for pair in work.net.joins:
        remembered = memory.pairs.get(pair, PairMemory())
        pairs[pair] = evolve(remembered, first_in_front=_predict_order(remembered, rules[pair]))
    gaussian = [
        pair
        for pair in pairs
        if filtered.row(pair[0]) is None and isinstance(filtered[pair[0]].step.posterior, GaussianPosterior)
    ]
    sharing = {
        pair: memory_of_pair.overlap
        for pair, memory_of_pair in pairs.items()
        if rules[pair].reweights and pair not in gaussian
    }
    tree, left_out = spanning_tree(sharing)
    flaws = {pair: PairFlaw() for pair in pairs if rules[pair].factor is not None}
    edges, closing = (
        tuple(
            Edge(
                pair,
                pairs[pair].first_in_front,
                rules[pair].nats,
                rules[pair].pairings,
                pair_factor(rules[pair], _constants(work, pair), work.inputs, flaws.get(pair)),
            )
            for pair in links
            if pair not in gaussian
            and (pairs[pair].overlap > 0 or rules[pair].factor is not None)
            and not any(is_degenerate(filtered, name) for name in pair)
        )
        for links in (tree, left_out)
    )
    return _Tree(pairs, left_out, edges, closing, flaws, gaussian)


def _linear_factors(work: FrameContext, tree: _Tree) -> dict[Pair, tuple[LinearNormal, ...]]:
    """The densities of Gaussian pairs; none of a pair whose factor has no value in the frame."""
    factors: dict[Pair, tuple[LinearNormal, ...]] = {}
    for pair in tree.gaussian:
        rule = work.engine.joins[work.net.joins[pair].rule]
        normals = linear_normals_of(parse(rule.factor or ""), {**work.inputs, **_constants(work, pair)})
        tree.flaws[pair].ignored = normals is None
        factors[pair] = normals or ()
    return factors


def _constants(work: FrameContext, pair: Pair) -> Mapping[str, float]:
    """Names of numbers in the factor of a pair: constants, modes, and values of categories."""
    kinds = tuple(work.net.targets[target].template for target in pair)
    return work.engine.numbers_of(kinds)


def _marginals(
    work: FrameContext, tree: _Tree, levels: Mapping[str, Level], filtered: FilteredTargets
) -> tuple[dict[str, Marginal], dict[Pair, float]]:
    """The joint belief's marginals, and of each edge the probability that its first target is in front."""
    relates = any(edge.factor is not None for edge in (*tree.edges, *tree.closing))
    neighbours = _neighbours((*tree.edges, *tree.closing))
    on_others = logs_on(work, neighbours, filtered)
    members = {
        name: _member(
            filtered, name, levels[name], on_others[name], _states_of(filtered[name]) if relates else {}
        )
        for name in neighbours
    }

    def keys(pairs: Sequence[Pair]) -> NDArray[np.uint64]:
        births = [(work.births[speaker], work.births[hearer]) for speaker, hearer in pairs]
        return work.engine.streams.keys(births, work.moment, "partners")

    return joint_marginals(members, tree.edges, keys, tree.closing)


def _member(
    filtered: FilteredTargets,
    name: str,
    level: Level,
    on_others: Mapping[str, float],
    states: Mapping[str, Floats],
) -> Member:
    """A target's hypotheses."""
    place = filtered.row(name)
    if place is None:
        target = filtered[name]
        boxes, prior = np.ascontiguousarray(target.step.support.boxes), _prior_of(target)
        log, plan = log_seen(target.plan.factors, target.step.evidence), target.plan
    else:
        group, row = place
        boxes, prior, log, plan = group.boxes[row], group.prior, group.own[row], group.plan
    return Member(boxes, prior, log, level.log, on_others, max(len(plan.observations), 1), level.best, states)


def _update_pairs(
    frame: int, tree: _Tree, orders: Mapping[Pair, float]
) -> tuple[dict[Pair, PairMemory], list[Event]]:
    """Memory of each pair; events of those left out of a ring, or with a flawed factor, from now on."""
    pairs: dict[Pair, PairMemory] = {}
    events: list[Event] = []
    for pair, memory in tree.pairs.items():
        is_out = pair in tree.left_out
        if memory.left_out != is_out:
            events.append(RingChanged(frame, *pair, is_out, memory.overlap, tree.left_out.get(pair, pair)))
        flaw = tree.flaws.get(pair, PairFlaw())
        if memory.flawed != bool(flaw):
            events.append(PairFactorChanged(frame, *pair, flaw.undefined, flaw.pairs, flaw.ignored))
        in_front = orders.get(pair, memory.first_in_front)
        pairs[pair] = evolve(memory, first_in_front=in_front, left_out=is_out, flawed=bool(flaw))
    return pairs, events


def _split_joint(
    carriers: Carriers,
    marginals: Mapping[str, Marginal],
    pairs: Mapping[Pair, PairMemory],
    filtered: FilteredTargets,
) -> tuple[Steps, dict[str, JoinMetrics], dict[str, CarriedHypotheses]]:
    """Each target's own step of the joint belief, what is written down, and which hypotheses are carried."""
    steps = {name: _reweight(target, marginals.get(name)) for name, target in filtered.others.items()}
    carried: dict[str, CarriedHypotheses] = {}
    metrics: dict[str, JoinMetrics] = {}
    in_front: dict[str, dict[str, float]] = {}
    for (first, second), memory in pairs.items():
        in_front.setdefault(first, {})[second] = memory.first_in_front
        in_front.setdefault(second, {})[first] = 1.0 - memory.first_in_front
    for name, fronts in in_front.items():
        probability, place = None, filtered.row(name)
        if name in carriers:
            steps[name], carried[name] = without_ride(steps[name])
            probability = float(steps[name].support.weights.weights @ carried[name].hypotheses)
        hidden = marginals[name].hidden if name in marginals else {}
        ess = filtered[name].step.support.weights.ess if place is None else place[0].ess[place[1]]
        metrics[name] = _metrics(fronts, hidden, probability, ess)
    return steps, metrics, carried


def _neighbours(edges: Sequence[Edge]) -> dict[str, list[str]]:
    neighbours: dict[str, list[str]] = {}
    for first, second in (edge.pair for edge in edges):
        neighbours.setdefault(first, []).append(second)
        neighbours.setdefault(second, []).append(first)
    return neighbours


def _predict_order(pair: PairMemory, rule: Join) -> float:
    """P(first in front) before this frame's evidence: the chain's prediction."""
    return pair.first_in_front * rule.stay + (1.0 - pair.first_in_front) * (1.0 - rule.stay)


def _states_of(target: Filtered) -> dict[str, Floats]:
    """Field -> its (N,) values at a target's hypotheses, with their modes and what they are."""
    states = dict(zip(target.step.posterior.fields, target.step.support.states.T, strict=True))
    return states if target.modes is None else {**states, **target.modes.modes.fields(states[FIELD])}


def _prior_of(target: Filtered) -> LogWeights:
    """The prior weights of its hypotheses, factors included: they are no evidence of pixels."""
    if not target.plan.factors:
        return target.step.prior
    return target.step.prior.times(log_prior_factor(target.plan.factors, target.step.evidence))[0]


def _reweight(target: Filtered, marginal: Marginal | None) -> Step[Posterior]:
    """The step with the weights of the joint belief; as it was where this leaves no hypothesis."""
    step = target.step
    if marginal is None:
        return step
    particles(step.posterior)
    try:
        message = marginal.log_likelihood + log_prior_factor(target.plan.factors, step.evidence)
        return reweight_step(step, message)  # type: ignore[arg-type]
    except DegenerateWeights:
        return step


def _metrics(
    in_front: Mapping[str, float], hidden: Mapping[str, float], attached: float | None, ess_own: float
) -> JoinMetrics:
    share = min(sum(hidden.values()), 1.0)
    behind = max(hidden, key=lambda target: hidden[target]) if share > 0.01 else ""
    return JoinMetrics(tuple(in_front), share, behind, dict(in_front), attached, ess_own)


def log_prior_factor(steps: tuple[Weigh, ...], evidence: Evidence) -> Floats:
    """(N,) log of the factors that multiply the root's prior; zeros when there are none."""
    log_factors = [
        evidence.factors[step.factor] for step in steps if step.is_prior and step.factor in evidence.factors
    ]
    return np.sum(log_factors, axis=0) if log_factors else np.zeros(len(evidence.log_likelihood))


def log_seen(steps: tuple[Weigh, ...], evidence: Evidence) -> Floats:
    """(N,) log-likelihood of what was seen alone, without the factors that multiply the root's prior."""
    if not steps:
        return evidence.log_likelihood
    log = log_prior_factor(steps, evidence)
    return evidence.log_likelihood - np.where(np.isfinite(log), log, 0.0)


def levels_of(
    remembered: Mapping[str, Level], filtered: FilteredTargets
) -> tuple[dict[str, Level], dict[str, Level]]:
    """Target -> its level with the agents that are active: as measured, else that of this very frame.

    Then those after this frame, were all targets seen in it.
    """
    levels: dict[str, Level] = {}
    updated: dict[str, Level] = {}
    for name in filtered:
        place = filtered.row(name)
        if place is None:
            active, middle, top = filtered[name].plan.active, *_half_way(*_extremes(filtered[name]))
        else:
            active, (middle, top) = place[0].plan.active, _half_way(*place[0].extremes[place[1]])
        level = remembered.get(name)
        if level is None or level.active != active:
            level = Level(active, middle, top, 0)
        levels[name], updated[name] = level, level.then(active, middle, top)
    return levels, updated


def _extremes(target: Filtered) -> tuple[float, float]:
    """Log-likelihood of the best hypothesis and of the worst."""
    log = log_seen(target.plan.factors, target.step.evidence)
    return float(log.max()), float(log.min())


def _half_way(top: float, worst: float) -> tuple[float, float]:
    """Log-likelihood half way between the best and the worst hypothesis, and that of the best."""
    return (top + max(worst - top, -DEEPEST) / 2, top) if math.isfinite(top) else (0.0, 0.0)


def levels_after(
    previous: Mapping[str, Level],
    measured: Mapping[str, Level],
    metrics: Mapping[str, JoinMetrics],
    filtered: FilteredTargets,
) -> dict[str, Level]:
    """The levels of all targets, those measured in this frame, in `measured`, that were seen."""
    levels = dict(previous)
    for name, level in measured.items():
        hidden = metrics[name].hidden if name in metrics else 0.0
        if hidden <= LEVEL_HIDDEN and not is_degenerate(filtered, name):
            levels[name] = level
    return levels


def is_degenerate(filtered: FilteredTargets, name: str) -> bool:
    """True if a target's own evidence could not be used; never of one in a group."""
    return filtered.row(name) is None and filtered[name].step.degenerate is not None


def report_hidden(
    frame: int, metrics: Mapping[str, JoinMetrics], memory: JoinMemory, events: list[Event]
) -> JoinMemory:
    """Add to `events` which targets are hidden now, and which no longer are."""
    hidden = dict(memory.hidden)
    for name, target in metrics.items():
        if name not in hidden and target.hidden > HIDDEN:
            hidden[name] = (target.behind, frame)
            front = 1.0 - target.in_front[target.behind]
            events.append(OcclusionChanged(frame, name, target.behind, True, target.hidden, HIDDEN, front, 0))
        elif name in hidden and target.hidden <= SEEN:
            front_target, first_frame = hidden.pop(name)
            front = 1.0 - target.in_front.get(front_target, 1.0)
            events.append(
                OcclusionChanged(
                    frame, name, front_target, False, target.hidden, SEEN, front, frame - first_frame
                )
            )
    return replace(memory, hidden=hidden)
