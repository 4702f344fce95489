"""The joint belief of joined targets, between the two halves of their frame.

The hypotheses of joined targets are weighed together. Each target keeps its own hypotheses; they get the
weights of the joint belief's marginal, so that all that follows sees it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.adapt.joins import (
    CarriedHypotheses,
    JoinMemory,
    Level,
    PairMemory,
    Reaches,
    spanning_tree,
)
from bayesnet_track.belief.contract import Posterior, Step
from bayesnet_track.belief.gaussian.belief import GaussianPosterior
from bayesnet_track.belief.motion.modes import FIELD
from bayesnet_track.belief.particles.belief import reweight_step
from bayesnet_track.engine.attachment import Carriers, carriers_of, particles, report_carried, without_ride
from bayesnet_track.engine.filtering import Filtered
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.occlusion import is_degenerate, levels_after, levels_of, report_hidden
from bayesnet_track.engine.rows.filtered_rows import Together
from bayesnet_track.engine.rows.on_others import logs_on
from bayesnet_track.engine.stacked import relate_gaussians
from bayesnet_track.graph.expressions.distributions import LinearNormal, linear_normals_of
from bayesnet_track.graph.expressions.parse import parse
from bayesnet_track.graph.settings.lifecycle import Join
from bayesnet_track.inference.factors import PairFlaw, log_prior_factor, log_seen, pair_factor
from bayesnet_track.inference.joint import Edge, Marginal, Member, Pair, joint_marginals
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.faults import PairFactorChanged
from bayesnet_track.journal.events.joins import RingChanged
from bayesnet_track.journal.metrics import JoinMetrics
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.log_weights import DegenerateWeights, LogWeights
from bayesnet_track.numerics.records import evolve

Steps = dict[str, Step[Posterior]]


@dataclass(frozen=True, eq=False)
class JointBelief:
    """What the joint beliefs of one frame gave.

    Attributes:
        filtered: target -> the first half of its frame, with the weights of the joint belief.
        memory: what is remembered.
        events: what is written down.
    """

    filtered: Together
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


def join_targets(work: FrameContext, memory: JoinMemory, filtered: Together) -> JointBelief:
    """The joint belief of all joined targets, and what follows from it for each."""
    if not work.engine.joins:
        return JointBelief(filtered, memory)
    started = work.engine.clock()
    levels, seen = levels_of(memory.levels, filtered)
    tree = _tree(work, memory, filtered)
    marginals, orders = _marginals(work, tree, levels, filtered)
    stacked, crosses = relate_gaussians(work, _linear_factors(work, tree), memory.crosses, filtered)
    pairs, events = _update_pairs(work.frame.index, tree, orders)
    carriers = carriers_of(work, memory)
    steps, metrics, carried = _split_joint(carriers, marginals, pairs, filtered)
    steps |= stacked
    centres = {carrier: filtered[carrier].step.posterior.mean[:2] for carrier, _ in carriers.values()}
    levels = levels_after(memory.levels, seen, metrics, filtered)
    after = replace(memory, pairs=pairs, levels=levels, carried=carried, centres=centres, crosses=crosses)
    after = report_hidden(work.frame.index, metrics, after, events)
    after = report_carried(work.frame.index, metrics, carriers, after, events)
    work.charge("joins", started)
    others = {
        name: _joined(one, steps[name], metrics[name]) if name in metrics else one
        for name, one in filtered.others.items()
    }
    said = {name: marginal.log_likelihood for name, marginal in marginals.items()}
    groups = [group.reweighted(said, metrics) for group in filtered.groups]
    return JointBelief(Together(groups, others, filtered.order), after, tuple(events))


def reaches_of(names: Sequence[str], boxes: Floats, variances: Floats) -> Reaches:
    """Where beliefs, with mean boxes (T, 4) and variances (T, 4) of them, say that their targets are."""
    return Reaches(names, boxes, np.sqrt(np.clip(variances[:, :2], 0.0, None)))


# ------------------------------------------------------------------------------------ the joint belief


def _joined(one: Filtered, step: Step[Posterior], metrics: JoinMetrics) -> Filtered:
    modes = None if one.modes is None else one.modes.joined(step.posterior)
    return evolve(one, step=step, join=metrics, modes=modes)


def _tree(work: FrameContext, memory: JoinMemory, of: Together) -> _Tree:
    """The pairs of this frame, and along which of them evidence is shared."""
    rules = {pair: work.engine.joins[join.rule] for pair, join in work.net.joins.items()}
    pairs: dict[Pair, PairMemory] = {}
    for pair in work.net.joins:
        known = memory.pairs.get(pair, PairMemory())
        pairs[pair] = evolve(known, first_in_front=_predict_order(known, rules[pair]))
    gaussian = [
        pair
        for pair in pairs
        if of.row(pair[0]) is None and isinstance(of[pair[0]].step.posterior, GaussianPosterior)
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
            for pair in chosen
            if pair not in gaussian
            and (pairs[pair].overlap > 0 or rules[pair].factor is not None)
            and not any(is_degenerate(of, name) for name in pair)
        )
        for chosen in (tree, left_out)
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
    work: FrameContext, tree: _Tree, levels: Mapping[str, Level], of: Together
) -> tuple[dict[str, Marginal], dict[Pair, float]]:
    """The joint belief's marginals, and of each edge the probability that its first target is in front."""
    relates = any(edge.factor is not None for edge in (*tree.edges, *tree.closing))
    neighbours = _neighbours((*tree.edges, *tree.closing))
    on = logs_on(work, neighbours, of)
    members = {
        name: _member(of, name, levels[name], on[name], _states_of(of[name]) if relates else {})
        for name in neighbours
    }

    def keys(pairs: Sequence[Pair]) -> NDArray[np.uint64]:
        births = [(work.births[speaker], work.births[hearer]) for speaker, hearer in pairs]
        return work.engine.streams.keys(births, work.moment, "partners")

    return joint_marginals(members, tree.edges, keys, tree.closing)


def _member(
    of: Together, name: str, level: Level, on: Mapping[str, float], states: Mapping[str, Floats]
) -> Member:
    """A target's hypotheses."""
    at = of.row(name)
    if at is None:
        one = of[name]
        boxes, prior = np.ascontiguousarray(one.step.support.boxes), _prior_of(one)
        log, plan = log_seen(one.plan.factors, one.step.evidence), one.plan
    else:
        group, row = at
        boxes, prior, log, plan = group.boxes[row], group.prior, group.own[row], group.plan
    return Member(boxes, prior, log, level.log, on, max(len(plan.observations), 1), level.best, states)


def _update_pairs(
    frame: int, tree: _Tree, orders: Mapping[Pair, float]
) -> tuple[dict[Pair, PairMemory], list[Event]]:
    """What is remembered of each pair; which are left out of a ring, or have a flawed factor, from now on."""
    pairs: dict[Pair, PairMemory] = {}
    events: list[Event] = []
    for pair, one in tree.pairs.items():
        is_out = pair in tree.left_out
        if one.left_out != is_out:
            events.append(RingChanged(frame, *pair, is_out, one.overlap, tree.left_out.get(pair, pair)))
        flaw = tree.flaws.get(pair, PairFlaw())
        if one.flawed != bool(flaw):
            events.append(PairFactorChanged(frame, *pair, flaw.undefined, flaw.pairs, flaw.ignored))
        in_front = orders.get(pair, one.first_in_front)
        pairs[pair] = evolve(one, first_in_front=in_front, left_out=is_out, flawed=bool(flaw))
    return pairs, events


def _split_joint(
    carriers: Carriers,
    marginals: Mapping[str, Marginal],
    pairs: Mapping[Pair, PairMemory],
    of: Together,
) -> tuple[Steps, dict[str, JoinMetrics], dict[str, CarriedHypotheses]]:
    """Each target's own step of the joint belief, what is written down, and which hypotheses are carried."""
    steps = {name: _reweight(one, marginals.get(name)) for name, one in of.others.items()}
    carried: dict[str, CarriedHypotheses] = {}
    metrics: dict[str, JoinMetrics] = {}
    in_front: dict[str, dict[str, float]] = {}
    for (first, second), one in pairs.items():
        in_front.setdefault(first, {})[second] = one.first_in_front
        in_front.setdefault(second, {})[first] = 1.0 - one.first_in_front
    for name, fronts in in_front.items():
        probability, at = None, of.row(name)
        if name in carriers:
            steps[name], carried[name] = without_ride(steps[name])
            probability = float(steps[name].support.weights.weights @ carried[name].hypotheses)
        hidden = marginals[name].hidden if name in marginals else {}
        ess = of[name].step.support.weights.ess if at is None else at[0].ess[at[1]]
        metrics[name] = _metrics(fronts, hidden, probability, ess)
    return steps, metrics, carried


def _neighbours(edges: Sequence[Edge]) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for first, second in (edge.pair for edge in edges):
        found.setdefault(first, []).append(second)
        found.setdefault(second, []).append(first)
    return found


def _predict_order(one: PairMemory, rule: Join) -> float:
    """P(first in front) before this frame's evidence: the chain's prediction."""
    return one.first_in_front * rule.stay + (1.0 - one.first_in_front) * (1.0 - rule.stay)


def _states_of(one: Filtered) -> dict[str, Floats]:
    """Field -> its (N,) values at a target's hypotheses, with their modes and what they are."""
    states = dict(zip(one.step.posterior.fields, one.step.support.states.T, strict=True))
    return states if one.modes is None else {**states, **one.modes.modes.fields(states[FIELD])}


def _prior_of(one: Filtered) -> LogWeights:
    """The prior weights of its hypotheses, factors included: they are no evidence of pixels."""
    if not one.plan.factors:
        return one.step.prior
    return one.step.prior.times(log_prior_factor(one.plan.factors, one.step.evidence))[0]


def _reweight(one: Filtered, marginal: Marginal | None) -> Step[Posterior]:
    """The step with the weights of the joint belief; as it was where this leaves no hypothesis."""
    step = one.step
    if marginal is None:
        return step
    particles(step.posterior)
    try:
        said = marginal.log_likelihood + log_prior_factor(one.plan.factors, step.evidence)
        return reweight_step(step, said)  # type: ignore[arg-type]
    except DegenerateWeights:
        return step


def _metrics(
    in_front: Mapping[str, float], hidden: Mapping[str, float], attached: float | None, ess_own: float
) -> JoinMetrics:
    share = min(sum(hidden.values()), 1.0)
    behind = max(hidden, key=lambda other: hidden[other]) if share > 0.01 else ""
    return JoinMetrics(tuple(in_front), share, behind, dict(in_front), attached, ess_own)
