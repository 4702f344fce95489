"""One frame of joined targets: carriers before what they carry, then the joint belief of all that are near.

Between the two halves of a target's frame (`target.weigh`, `target.conclude`) the hypotheses of joined
targets are weighed together. Each target keeps its own hypotheses; they get the weights of the joint belief's
marginal, so that all that follows sees it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.adapt.joins import (
    LEVEL_HIDDEN,
    Carried,
    JoinMemory,
    Level,
    PairMemory,
    Reach,
    spanning_tree,
)
from bayesnet_track.belief.contract import Posterior, Step
from bayesnet_track.belief.motion.attached import Attached, with_carried, without_carried
from bayesnet_track.belief.particles.belief import reweighted
from bayesnet_track.belief.particles.particle_set import ParticleSet
from bayesnet_track.belief.states import hypotheses_of
from bayesnet_track.engine.compiled import Engine
from bayesnet_track.engine.state import TargetState
from bayesnet_track.engine.target import Weighed, weigh
from bayesnet_track.graph.settings.joins import Attachment, Join
from bayesnet_track.inference.joint import Edge, Marginal, Member, Pair, joint_marginals
from bayesnet_track.inference.messages import Observer, evaluate
from bayesnet_track.journal.events.basic import Event
from bayesnet_track.journal.events.join_events import (
    AttachmentChanged,
    JoinMetrics,
    OcclusionChanged,
    RingChanged,
)
from bayesnet_track.journal.net.net import Net
from bayesnet_track.numerics.log_weights import DegenerateWeights, LogWeights
from bayesnet_track.numerics.resampling import resample
from bayesnet_track.observation.planes import Frame, PlaneCache

Floats = NDArray[np.float64]

HIDDEN, SEEN = 0.5, 0.3
"""Hidden share above which a target is told to be hidden, and at or below which to be seen again."""

DEEPEST = 20.0
"""Nats below the best hypothesis at which the worst one counts at most."""

ON_SIZE = 8
"""Boxes at which a target's agents are asked what they say of the one in front."""

CARRIED, FREE = 0.5, 0.3
"""Probability above which a target is told to be carried, and at or below which no longer."""


@dataclass(frozen=True, eq=False)
class Together:
    """What the joint beliefs of one frame gave.

    Attributes:
        weighed: every target's first half, joined ones with the weights of the joint belief.
        metrics: joined target -> what is written down of it.
        told: what else is written down.
        memory: what is remembered.
    """

    weighed: tuple[Weighed, ...]
    metrics: Mapping[str, JoinMetrics]
    told: tuple[Event, ...]
    memory: JoinMemory


def weigh_all(
    engine: Engine,
    net: Net,
    targets: Mapping[str, TargetState],
    memory: JoinMemory,
    frame: Frame,
    cache: PlaneCache,
    seconds: dict[str, float],
) -> tuple[Weighed, ...]:
    """Every target weighed, in their order; one that may be carried comes after its carrier."""
    carriers = _carriers(engine, net, memory)
    done: dict[str, Weighed] = {}

    def weighed(target: str) -> Weighed:
        if target not in done:
            before = targets[target]
            if target not in carriers:
                done[target] = weigh(engine, net, before, target, frame, cache, seconds)
            else:
                carrier, settings = carriers[target]
                moved = _displacement(weighed(carrier), memory.centres.get(carrier))
                motion = Attached(
                    engine.machinery[net.targets[target].template].motion,
                    moved,
                    settings.start,
                    settings.stay,
                    settings.sd_px,
                )
                known = memory.carried.get(target)
                column = known.hypotheses if known is not None and known.belief is before.belief else None
                glued = replace(before, belief=with_carried(_particles(before.belief), column))
                own = weigh(engine, net, glued, target, frame, cache, seconds, motion)
                done[target] = replace(own, before=before)
        return done[target]

    return tuple(weighed(target) for target in targets)


def join_all(
    engine: Engine,
    net: Net,
    memory: JoinMemory,
    weighed: Sequence[Weighed],
    frame: Frame,
    cache: PlaneCache,
) -> Together:
    """The joint belief of all joined targets, and what follows from it for each."""
    of = {one.target: one for one in weighed}
    levels = {name: _level(memory.levels.get(name), one) for name, one in of.items()}
    pairs = {pair: memory.pairs.get(pair, PairMemory()) for pair in net.joins}
    rules = {pair: engine.joins[join.rule] for pair, join in net.joins.items()}
    pairs = {pair: replace(one, first_in_front=_carried_on(one, rules[pair])) for pair, one in pairs.items()}
    sharing = {pair: one.overlap for pair, one in pairs.items() if rules[pair].shares_pixels}
    tree, left_out = spanning_tree(sharing)

    edges, closing = (
        [
            Edge(pair, pairs[pair].first_in_front, rules[pair].nats, rules[pair].pairings)
            for pair in chosen
            if pairs[pair].overlap > 0 and all(of[name].step.degenerate is None for name in pair)
        ]
        for chosen in (tree, left_out)
    )
    members = {
        name: Member(
            np.ascontiguousarray(one.step.support.boxes),
            one.step.prior,
            one.step.evidence.log_likelihood,
            levels[name].log,
            _logs_on(engine, net, one, [of[other] for other in others], frame, cache),
            max(len(one.plan.observations), 1),
            levels[name].best,
        )
        for name, others in _neighbours((*edges, *closing)).items()
        for one in (of[name],)
    }
    marginals, orders = joint_marginals(
        members,
        edges,
        lambda speaker, hearer: engine.streams.of(speaker, hearer, frame.index, "partners"),
        closing,
    )
    told: list[Event] = []
    for pair, one in pairs.items():
        if one.left_out != (pair in left_out):
            group = left_out.get(pair, pair)
            told.append(RingChanged(frame.index, *pair, pair in left_out, one.overlap, group))
        front = orders.get(pair, one.first_in_front)
        pairs[pair] = replace(one, first_in_front=front, left_out=pair in left_out)

    steps = {name: _reweighted(one.step, marginals.get(name)) for name, one in of.items()}
    carriers = _carriers(engine, net, memory)
    carried: dict[str, Carried] = {}
    metrics: dict[str, JoinMetrics] = {}
    for name in dict.fromkeys(name for pair in pairs for name in pair):
        probability = None
        if name in carriers:
            steps[name], carried[name] = _split(steps[name])
            probability = float(steps[name].support.weights.weights @ carried[name].hypotheses)
        hidden = marginals[name].hidden if name in marginals else {}
        metrics[name] = _metrics(name, pairs, hidden, probability, of[name].step.support.weights.ess)
    after = replace(
        memory,
        pairs=pairs,
        levels=_levels_after(memory.levels, levels, metrics, of),
        carried=carried,
        centres={carrier: of[carrier].step.posterior.mean[:2] for carrier, _ in carriers.values()},
    )
    after = _tell_hidden(frame.index, metrics, after, told)
    after = _tell_carried(frame.index, metrics, carriers, after, told)
    return Together(
        tuple(replace(one, step=steps[one.target]) for one in weighed), metrics, tuple(told), after
    )


def reach_of(posterior: Posterior, covariance: Floats | None) -> Reach:
    """Where a belief says that its target is; its covariance (D, D) is taken where it is known already."""
    covariance = posterior.covariance if covariance is None else covariance
    return Reach(posterior.mean[:4], np.sqrt(np.clip(np.diag(covariance)[:2], 0.0, None)))


# ------------------------------------------------------------------------------------ being carried


def _carriers(engine: Engine, net: Net, memory: JoinMemory) -> dict[str, tuple[str, Attachment]]:
    """Target that may be carried -> by whom: the one that carries it, else the one that overlaps it most."""
    found: dict[str, tuple[tuple[bool, float], str, Attachment]] = {}
    for (carrier, target), join in net.joins.items():
        settings = engine.joins[join.rule].attachment
        if settings is None:
            continue
        known = memory.pairs.get((carrier, target), PairMemory())
        rank = (memory.carriers.get(target, ("", 0))[0] == carrier, known.overlap)
        if target not in found or rank > found[target][0]:
            found[target] = (rank, carrier, settings)
    return {target: (carrier, settings) for target, (_, carrier, settings) in found.items()}


def _displacement(carrier: Weighed, before: Floats | None) -> Floats:
    """(2,) how far the carrier's centre went, by its own evidence in both frames: so errors cancel out."""
    start = carrier.before.belief.mean[:2] if before is None else before
    return np.asarray(carrier.step.posterior.mean[:2] - start)


def _particles(belief: Posterior) -> ParticleSet:
    if not isinstance(belief, ParticleSet):
        raise TypeError(f"only particles can be joined, not {type(belief).__name__}")
    return belief


def _split(step: Step[Posterior]) -> tuple[Step[Posterior], Carried]:
    """The step of the target's own state, and which of its hypotheses are carried."""
    posterior, column = without_carried(_particles(step.posterior))
    find = partial(_without_last, step)
    return replace(step, posterior=posterior, support=posterior, find_map=find), Carried(posterior, column)


def _without_last(step: Step[Posterior]) -> Floats:
    return step.map_state[:-1]


# ------------------------------------------------------------------------------------ the joint belief


def _neighbours(edges: Sequence[Edge]) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for first, second in (edge.pair for edge in edges):
        found.setdefault(first, []).append(second)
        found.setdefault(second, []).append(first)
    return found


def _logs_on(
    engine: Engine, net: Net, one: Weighed, others: Sequence[Weighed], frame: Frame, cache: PlaneCache
) -> dict[str, float]:
    """Other -> mean log-likelihood, by a target's own agents, of boxes of it that lie wholly on the other's.

    Where its box is the larger one, in the middle of the other's.
    """
    machine = engine.machinery[net.targets[one.target].template]
    stream = partial(engine.streams.of, one.target, "on", frame.index)
    rng = stream("places")
    size = ON_SIZE * len(others)
    own = one.step.support
    states = own.states[resample("systematic", own.weights.weights, size, rng)].copy()
    drawn = [
        other.step.support.boxes[resample("systematic", other.step.support.weights.weights, ON_SIZE, rng)]
        for other in others
    ]
    boxes = np.concatenate(drawn)
    room = np.clip(boxes[:, 2:] - states[:, 2:4], 0.0, None)
    states[:, :2] = boxes[:, :2] + room * (rng.random((size, 2)) - 0.5)
    observer = Observer(
        cache,
        machine.cues,
        one.before.references,
        stream,
        engine.clock,
        {},
        roll=engine.absent.roll(one.target, "joining"),
    )
    seen = hypotheses_of(states, _particles(one.step.posterior).fields)
    log = evaluate(one.plan, observer, seen, LogWeights.uniform(size).log).log_likelihood
    means = np.maximum(log, -1e3).reshape(len(others), ON_SIZE).mean(axis=1)
    return {other.target: float(mean) for other, mean in zip(others, means, strict=True)}


def _carried_on(one: PairMemory, rule: Join) -> float:
    """P(first in front) before this frame's evidence: the chain's prediction."""
    return one.first_in_front * rule.stay + (1.0 - one.first_in_front) * (1.0 - rule.stay)


def _reweighted(step: Step[Posterior], marginal: Marginal | None) -> Step[Posterior]:
    """The step with the weights of the joint belief; as it was where this leaves no hypothesis."""
    if marginal is None:
        return step
    _particles(step.posterior)
    try:
        return reweighted(step, marginal.log_likelihood)  # type: ignore[arg-type]
    except DegenerateWeights:
        return step


def _level(known: Level | None, one: Weighed) -> Level:
    """The level with the agents that are active: as measured, else that of this very frame."""
    if known is not None and known.active == one.plan.active:
        return known
    return Level(one.plan.active, *_half_way(one.step), 0)


def _half_way(step: Step[Posterior]) -> tuple[float, float]:
    """Log-likelihood half way between the best and the worst hypothesis, and that of the best."""
    log = step.evidence.log_likelihood
    best = float(np.max(log))
    return (best + max(float(np.min(log)) - best, -DEEPEST) / 2, best) if np.isfinite(best) else (0.0, 0.0)


def _levels_after(
    before: Mapping[str, Level],
    levels: Mapping[str, Level],
    metrics: Mapping[str, JoinMetrics],
    of: Mapping[str, Weighed],
) -> dict[str, Level]:
    """The levels of all targets, those measured in this frame that were seen."""
    after = dict(before)
    for name, one in of.items():
        hidden = metrics[name].hidden if name in metrics else 0.0
        if hidden <= LEVEL_HIDDEN and one.step.degenerate is None:
            after[name] = levels[name].then(one.plan.active, *_half_way(one.step))
    return after


def _metrics(
    name: str,
    pairs: Mapping[Pair, PairMemory],
    hidden: Mapping[str, float],
    attached: float | None,
    ess_own: float,
) -> JoinMetrics:
    in_front = {}
    for (first, second), one in pairs.items():
        if name == first:
            in_front[second] = one.first_in_front
        elif name == second:
            in_front[first] = 1.0 - one.first_in_front
    share = min(sum(hidden.values()), 1.0)
    behind = max(hidden, key=lambda other: hidden[other]) if share > 0.01 else ""
    return JoinMetrics(tuple(in_front), share, behind, in_front, attached, ess_own)


# ------------------------------------------------------------------------------------ what is told


def _tell_hidden(
    frame: int, metrics: Mapping[str, JoinMetrics], memory: JoinMemory, told: list[Event]
) -> JoinMemory:
    hidden = dict(memory.hidden)
    for name, one in metrics.items():
        if name not in hidden and one.hidden > HIDDEN:
            hidden[name] = (one.behind, frame)
            front = 1.0 - one.in_front[one.behind]
            told.append(OcclusionChanged(frame, name, one.behind, True, one.hidden, HIDDEN, front, 0))
        elif name in hidden and one.hidden <= SEEN:
            other, since = hidden.pop(name)
            front = 1.0 - one.in_front.get(other, 1.0)
            told.append(OcclusionChanged(frame, name, other, False, one.hidden, SEEN, front, frame - since))
    return replace(memory, hidden=hidden)


def _tell_carried(
    frame: int,
    metrics: Mapping[str, JoinMetrics],
    carriers: Mapping[str, tuple[str, Attachment]],
    memory: JoinMemory,
    told: list[Event],
) -> JoinMemory:
    known = dict(memory.carriers)
    for name, (carrier, _) in carriers.items():
        probability = metrics[name].attached or 0.0
        if name not in known and probability > CARRIED:
            known[name] = (carrier, frame)
            told.append(AttachmentChanged(frame, name, carrier, True, probability, 0))
        elif name in known and probability <= FREE:
            before, since = known.pop(name)
            told.append(AttachmentChanged(frame, name, before, False, probability, frame - since))
    return replace(memory, carriers=known)
