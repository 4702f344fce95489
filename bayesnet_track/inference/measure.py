"""Measure a step: UD of every belief and agent, KL and contribution of every agent, strength of messages."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache

import numpy as np

from bayesnet_track.adapt.rule_inputs import Inside, Measures, PartMeasure
from bayesnet_track.belief.contract import BOX_FIELDS, Evidence, Posterior, Step
from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.inference.compile import Plan
from bayesnet_track.inference.measure_rows import is_alone, silent_of
from bayesnet_track.inference.messages import without
from bayesnet_track.inference.part_measures import measure_parts
from bayesnet_track.inference.parts import PartBelief, part_beliefs, part_of_agents
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.distributions import weighted_mass_in_disc
from bayesnet_track.numerics.log_weights import divergences, select, tilt, uncertainty_deviation
from bayesnet_track.observation.cue import Hypotheses


def measure(target: CheckedTarget, plan: Plan, step: Step[Posterior], area_px2: float) -> Measures:
    """Measure one step of `target`; every index is taken on the step's own hypotheses and prior weights."""
    evidence, prior, root = step.evidence, step.prior.log, step.support.weights
    hypotheses = Hypotheses(step.support.boxes)
    nodes = list(evidence.messages)
    agents = [obs.agent for obs in plan.observations if obs.agent in evidence.messages]
    governors = [target.governor[agent] or target.root for agent in agents]
    left = _left(target, plan, step, agents)
    # All beliefs in one matrix: those of the nodes, then what is left without each agent.
    logs = tilt(prior, _rows((*evidence.messages.values(), *left), len(prior)))
    beliefs = dict(zip(nodes, logs[: len(nodes)], strict=True))
    beliefs[target.root] = root.log

    agent_ud = {}
    for obs in plan.observations:
        if obs.agent in beliefs:
            boxes = evidence.latent.get(obs.at, hypotheses).boxes
            agent_ud[obs.agent] = _agent_ud(target, boxes, evidence.messages[obs.agent], beliefs[obs.agent])

    governing = [beliefs.get(governor, root.log) for governor in governors]
    alone = governing if is_alone(plan) and not plan.draws else [beliefs[agent] for agent in agents]
    nats = divergences(
        _rows((*governing, *governing, *logs[: len(nodes)]), len(prior)),
        _rows((*alone, *logs[len(nodes) :], *[prior] * len(nodes)), len(prior)),
    ).tolist()

    parts = part_beliefs(plan, evidence, step.support.weights)
    uds = _node_uds(target, step, beliefs, parts)
    silent = silent_of(evidence)
    at_parts = measure_parts(target, evidence, parts, uds)
    seeing = _that_see(target, agents, silent, at_parts)
    return Measures(
        ud_px2=uds,
        agent_ud_px2=agent_ud,
        kl=dict(zip(agents, nats, strict=False)),
        contribution=dict(zip(agents, nats[len(agents) :], strict=False)),
        strength=dict(zip(nodes, nats[2 * len(agents) :], strict=True)),
        fit=fit_of([evidence.messages[agent] for agent in seeing]),
        area_px2=area_px2,
        silent=silent,
        inside=_insides(target, step, beliefs, parts),
        parts=at_parts,
        ud_without_px2={
            agent: _ud_without(target, governor, evidence, hypotheses, log)
            for agent, governor, log in zip(agents, governors, logs[len(nodes) :], strict=True)
            if _asks_for_the_dispensable(target, governor)
        },
    )


def _left(target: CheckedTarget, plan: Plan, step: Step[Posterior], agents: Sequence[str]) -> list[Floats]:
    """(N,) of each agent: the message that its governor, or the root, would have had without it."""
    evidence, prior = step.evidence, step.prior.log
    nothing = np.zeros(len(prior))
    if is_alone(plan):
        return [nothing] * len(agents)
    hypotheses = Hypotheses(step.support.boxes)
    return [
        without(plan, evidence, agent, hypotheses, prior).get(target.governor[agent] or target.root, nothing)
        for agent in agents
    ]


def fit_of(messages: Sequence[Floats]) -> float:
    """Largest geometric mean of a hypothesis' likelihood over agents, whose messages (N,) these are."""
    if not messages:
        return 0.0
    first, *others = (own if len(messages) == 1 else own / len(messages) for own in messages)
    return float(np.exp(min(float(sum(others, first).max()), 0.0)))


def _asks_for_the_dispensable(target: CheckedTarget, governor: str) -> bool:
    rules = target.inference(governor).adapt
    off = None if rules is None else rules.deactivate
    return off is not None and off.drop == "most_expensive_redundant"


def _ud_without(
    target: CheckedTarget, governor: str, evidence: Evidence, hypotheses: Hypotheses, log: Floats
) -> float:
    boxes = evidence.latent.get(governor, hypotheses).boxes
    return _ud(target, governor, boxes, log, boxes[int(np.argmax(log))])


def _that_see(
    target: CheckedTarget, agents: list[str], silent: tuple[str, ...], parts: Mapping[str, PartMeasure]
) -> list[str]:
    """The agents that saw something, without those of hidden parts where others are left."""
    seeing = [agent for agent in agents if agent not in silent]
    part_of = part_of_agents(target) if parts else {}
    hidden = {part for part, found in parts.items() if found.status == "hidden"}
    return [agent for agent in seeing if part_of.get(agent) not in hidden] or seeing


def _rows(arrays: Iterable[Floats], size: int) -> Floats:
    """(M, size) the arrays (size,) as rows, also when there are none."""
    return np.array(list(arrays), dtype=np.float64).reshape(-1, size)


def columns_of(target: CheckedTarget, node: str) -> tuple[int, ...]:
    """The columns of a state over which UD of a node is taken."""
    return _indices(tuple(target.inference(node).ud_fields))


@lru_cache(maxsize=64)
def _indices(fields: tuple[str, ...]) -> tuple[int, ...]:
    return tuple(BOX_FIELDS.index(name) for name in fields)


def _ud(target: CheckedTarget, node: str, boxes: Floats, log: Floats, centre: Floats) -> float:
    columns = select(columns_of(target, node))
    return uncertainty_deviation(boxes[:, columns], np.exp(log), centre[columns])


def _node_uds(
    target: CheckedTarget,
    step: Step[Posterior],
    beliefs: Mapping[str, Floats],
    parts: Mapping[str, PartBelief],
) -> dict[str, float]:
    """UD of every inference node, the root's first."""
    uds = {target.root: step.posterior.uncertainty(step.map_state, columns_of(target, target.root))}
    for node in target.order:
        above = target.parent[node]
        if above is None or node not in target.children:
            continue
        if node in parts:
            uds[node] = parts[node].uncertainty(columns_of(target, node))
        elif node in beliefs:
            latent = step.evidence.latent.get(node)
            boxes = step.support.boxes if latent is None else latent.boxes
            best = boxes[int(np.argmax(beliefs[node]))]
            uds[node] = _ud(target, node, boxes, beliefs[node], best)
        else:
            uds[node] = _inherit(target, node, step, beliefs, parts)
    return uds


def _inherit(
    target: CheckedTarget,
    node: str,
    step: Step[Posterior],
    beliefs: Mapping[str, Floats],
    parts: Mapping[str, PartBelief],
) -> float:
    """UD, over the node's own fields, of the nearest belief above a node that hears of no agent."""
    above: str | None = target.parent[node]
    while above is not None and above != target.root and above not in beliefs and above not in parts:
        above = target.parent[above]
    if above is not None and above in parts:
        return parts[above].uncertainty(columns_of(target, node))
    if above is None or above == target.root:
        return step.posterior.uncertainty(step.map_state, columns_of(target, node))
    latent = step.evidence.latent.get(above)
    boxes = step.support.boxes if latent is None else latent.boxes
    return _ud(target, node, boxes, beliefs[above], boxes[int(np.argmax(beliefs[above]))])


def _insides(
    target: CheckedTarget,
    step: Step[Posterior],
    beliefs: Mapping[str, Floats],
    parts: Mapping[str, PartBelief],
) -> dict[tuple[str, float], Inside]:
    """Shares of belief around every node's mode (a part's estimate), in the windows of its rules."""
    found: dict[tuple[str, float], Inside] = {}
    for node in target.children:
        for within_box in _windows(target, node):
            found[node, within_box] = _inside(target, node, step, beliefs, parts, within_box)
    return found


def _windows(target: CheckedTarget, node: str) -> set[float]:
    rules = target.inference(node).adapt
    on = None if rules is None or rules.activate is None else rules.activate.unless
    off = None if rules is None or rules.deactivate is None else rules.deactivate.when
    tests = [one.concentrated for one in (on, off) if one is not None]
    return {test.within_box for test in tests if test is not None}


def _inside(
    target: CheckedTarget,
    node: str,
    step: Step[Posterior],
    beliefs: Mapping[str, Floats],
    parts: Mapping[str, PartBelief],
    within_box: float,
) -> Inside:
    """Of the root's posterior about the MAP; of another node's belief about its most probable hypothesis."""
    above: str | None = node
    while above is not None and above not in beliefs and above not in parts:
        above = target.parent[above]
    if above is not None and above in parts:
        boxes, own, mode = parts[above].boxes, parts[above].weights, parts[above].mean
        radius = within_box * float(np.sqrt(mode[2] * mode[3]))
        share = weighted_mass_in_disc(boxes[:, :2], own.weights, mode[:2], radius)
        return Inside(share, own.ess, radius)
    if above is None or above == target.root:
        mode = step.map_state
        radius = within_box * float(np.sqrt(mode[2] * mode[3]))
        share, trials = step.posterior.mass_within(mode[:2], radius)
        return Inside(share, trials, radius)
    latent, log = step.evidence.latent.get(above), beliefs[above]
    boxes = step.support.boxes if latent is None else latent.boxes
    mode, weights = boxes[int(np.argmax(log))], np.exp(log)
    radius = within_box * float(np.sqrt(mode[2] * mode[3]))
    share = weighted_mass_in_disc(boxes[:, :2], weights, mode[:2], radius)
    return Inside(share, float(1.0 / np.sum(weights**2)), radius)


def _agent_ud(target: CheckedTarget, boxes: Floats, message: Floats, belief: Floats) -> float:
    """UD of the agent's normalised likelihood about its own maximum-likelihood hypothesis."""
    return _ud(target, target.root, boxes, belief, boxes[int(np.argmax(message))])
