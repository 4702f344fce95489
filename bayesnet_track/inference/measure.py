"""Measure a step: UD of every belief and agent, KL and contribution of every agent, strength of messages.

Sums run along the hypotheses of one target at a time, in the order in which they run for it alone: no bit
depends on who else is measured.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, lru_cache, partial
from typing import Any

import numpy as np

from bayesnet_track.adapt.rule_inputs import GroupMeasures, Inside, Measures, PartMeasure, PartStatus
from bayesnet_track.belief.contract import BOX_FIELDS, Evidence, Posterior, Step
from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.inference.compile import Plan
from bayesnet_track.inference.messages import join_plain, without
from bayesnet_track.inference.parts import PartBelief, part_beliefs, part_of_agents
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.distributions import weighted_mass_in_disc
from bayesnet_track.numerics.log_weights import (
    column_index,
    divergences,
    tilt,
    uncertainties,
    uncertainty_deviation,
)
from bayesnet_track.numerics.records import LazyRecords
from bayesnet_track.observation.cue import Hypotheses

Rest = tuple[Sequence[Sequence[float]], Sequence[Sequence[float]], Sequence[Sequence[float]]]


@lru_cache(maxsize=64)
def is_flat(target: CheckedTarget) -> bool:
    """True where the only beliefs of a net are the root's and its agents', and its rules ask for no more."""
    return len(target.children) == 1 and fits_rows(target)


@lru_cache(maxsize=64)
def fits_rows(target: CheckedTarget) -> bool:
    """True where a net is flat but for the cameras that see its targets (`measure_rows`)."""
    root = target.inference(target.root)
    rules = root.adapt
    activate, deactivate = (None, None) if rules is None else (rules.activate, rules.deactivate)
    tests = [None if activate is None else activate.unless, None if deactivate is None else deactivate.when]
    return (
        target.children.keys() <= {target.root, *target.views}
        and all((target.governor[agent] or target.root) == target.root for agent in target.agents)
        and all(test is None or test.concentrated is None for test in tests)
        and (deactivate is None or deactivate.drop != "most_expensive_redundant")
        and isinstance(state_index(target, target.root), slice)
    )


def is_alone(plan: Plan) -> bool:
    """True where only one agent says anything: without it the prior is left."""
    return len(plan.observations) == 1 and not plan.factors


@dataclass(frozen=True, eq=False)
class StepArrays:
    """Steps of T targets of a flat net, at N hypotheses each, in which the same A agents said something.

    Attributes:
        agents: these, in the order of the plan's observations.
        silent: agents that measure and did not see the targets.
        messages: agent, view and factor -> (T, N) log-likelihoods.
        prior: (T, N) log-weights before the evidence.
        log: (T, N) those after it.
        boxes: (T, N, 4) hypotheses of centre boxes, px.
        uds: the root, and views that nobody looked through -> of each target, UD of its belief about the
            estimate, px^2.
        views: view -> (T, N, 4) hypotheses in its image.
    """

    agents: Sequence[str]
    silent: tuple[str, ...]
    messages: Mapping[str, Floats]
    prior: Floats
    log: Floats
    boxes: Floats
    uds: Mapping[str, Sequence[float]]
    views: Mapping[str, Floats] = field(default_factory=dict)

    @staticmethod
    def key(plan: Plan, step: Step[Any]) -> Hashable:
        """Equal for steps by one plan that can be measured together."""
        evidence = step.evidence
        names = (*evidence.messages,), (*evidence.factors,), silent_of(evidence)
        return plan.active, names, len(step.prior)

    @classmethod
    def of(cls, target: CheckedTarget, plan: Plan, steps: Sequence[Step[Any]]) -> StepArrays:
        """Arrays of steps with the same key."""
        evidence = steps[0].evidence
        nodes = (node for node in target.order if node in target.children and node not in evidence.messages)
        columns = [(node, state_columns(target, node)) for node in nodes]
        messages = {
            name: _stack([step.evidence.messages[name] for step in steps]) for name in evidence.messages
        }
        factors = {name: _stack([step.evidence.factors[name] for step in steps]) for name in evidence.factors}
        return cls(
            [observation.agent for observation in plan.observations if observation.agent in messages],
            silent_of(evidence),
            messages | factors,
            _stack([step.prior.log for step in steps]),
            _stack([step.support.weights.log for step in steps]),
            _stack([step.support.boxes for step in steps]),
            {node: [step.posterior.uncertainty(step.map_state, k) for step in steps] for node, k in columns},
            {
                view.node: _stack([step.evidence.latent[view.node].boxes for step in steps])
                for view in plan.views
            },
        )


def _stack(arrays: list[Floats]) -> Floats:
    return arrays[0][None] if len(arrays) == 1 else np.array(arrays)


def silent_of(evidence: Evidence) -> tuple[str, ...]:
    """The agents that measure and did not see the target."""
    return tuple(agent for agent, measurement in evidence.measured.items() if measurement is None)


def measure_rows(target: CheckedTarget, plan: Plan, steps: StepArrays, areas_px2: Floats) -> GroupMeasures:
    """Measures of steps of a net that `fits_rows`; every index is taken on the step's own hypotheses.

    Those that rules seldom ask for are found when one does, for all targets at once.
    """
    agents, messages = steps.agents, steps.messages
    without = steps.prior[None] if is_alone(plan) else tilt(steps.prior, _without_each(plan, steps))
    nats = divergences(steps.log, without[: len(agents)]).T
    seeing = [messages[agent] for agent in agents if agent not in steps.silent]
    total = sum((message / len(seeing) for message in seeing), np.zeros_like(steps.prior)).max(axis=1)
    fits = np.exp(np.minimum(total, 0.0)) if seeing else np.zeros(len(areas_px2))
    names = [*agents, *(view for view in steps.views if view in messages)]
    node_messages = np.array([messages[name] for name in names]).reshape(len(names), *steps.prior.shape)
    uds_of_nodes = {**steps.uds}
    for view, log in zip(names[len(agents) :], tilt(steps.prior, node_messages[len(agents) :]), strict=True):
        boxes = steps.views[view][:, :, state_index(target, view)]
        uds_of_nodes[view] = uncertainties(boxes, np.exp(log), _peaks(boxes, log))
    uds = {node: np.array(uds_of_nodes[node]) for node in target.order if node in uds_of_nodes}
    find_rest = cache(partial(_find_rest, target, plan, node_messages, steps))

    def rest_of(row: int, part: int, nodes: Sequence[str]) -> dict[str, float]:
        return dict(zip(nodes, find_rest()[part][row], strict=True))

    def measures_of(row: int) -> Measures:
        kl, strength, agent_uds = (
            LazyRecords(nodes, partial(rest_of, row, part, nodes))
            for part, nodes in enumerate((agents, names, agents))
        )
        return Measures(
            ud_px2={node: float(values[row]) for node, values in uds.items()},
            agent_ud_px2=agent_uds,
            kl=kl,
            contribution=dict(zip(agents, nats[row].tolist(), strict=True)),
            strength=strength,
            fit=float(fits[row]),
            area_px2=float(areas_px2[row]),
            silent=steps.silent,
        )

    return GroupMeasures(uds=uds, areas=areas_px2, fits=fits, agents=agents, nats=nats, of=measures_of)


def _find_rest(target: CheckedTarget, plan: Plan, messages: Floats, steps: StepArrays) -> Rest:
    """KL of each agent, strength of its and each view's messages (M, T, N), and UD of what agents say."""
    count, prior, root = len(steps.agents), steps.prior, steps.log
    if not len(messages):
        return ([[]] * len(prior),) * 3
    logs, columns = tilt(prior, messages), state_index(target, target.root)
    reference_logs = root[None] if is_alone(plan) else logs[:count]
    nats = divergences(
        np.concatenate([[root] * count, logs]), np.concatenate([reference_logs, [prior] * len(logs)])
    )
    nodes = {observation.agent: observation.at for observation in plan.observations}
    uds = []
    for agent, message, log in zip(steps.agents, messages[:count], logs[:count], strict=True):
        boxes = steps.views.get(nodes[agent], steps.boxes)[:, :, columns]
        uds.append(uncertainties(boxes, np.exp(log), _peaks(boxes, message)))
    return nats[:count].T.tolist(), nats[count:].T.tolist(), list(zip(*uds, strict=True))


def _peaks(boxes: Floats, log: Floats) -> Floats:
    """(T, K) of hypotheses (T, N, K) those with the largest of (T, N)."""
    return np.asarray(boxes[np.arange(len(boxes)), log.argmax(axis=1)])


def _without_each(plan: Plan, steps: StepArrays) -> Floats:
    """(A, T, N) the root's message had each agent been switched off; zeros where nothing is left."""
    shape = steps.prior.shape
    left_out = {*steps.silent, *steps.views}
    seeing = {name: message for name, message in steps.messages.items() if name not in left_out}
    joined = np.zeros((len(steps.agents), *shape))
    for place, agent in enumerate(steps.agents):
        sent = {name: message for name, message in seeing.items() if name != agent}
        joined[place] = join_plain(plan, sent, shape).get(plan.root, 0.0)
    return joined


def measure(target: CheckedTarget, plan: Plan, step: Step[Posterior], area_px2: float) -> Measures:
    """Measure one step of `target`; every index is taken on the step's own hypotheses and prior weights."""
    evidence, prior, root = step.evidence, step.prior.log, step.support.weights
    hypotheses = Hypotheses(step.support.boxes)
    nodes = list(evidence.messages)
    agents = [obs.agent for obs in plan.observations if obs.agent in evidence.messages]
    governors = [target.governor[agent] or target.root for agent in agents]
    without_each = _left(target, plan, step, agents)
    # All beliefs in one matrix: those of the nodes, then what is left without each agent.
    logs = tilt(prior, _rows((*evidence.messages.values(), *without_each), len(prior)))
    beliefs = dict(zip(nodes, logs[: len(nodes)], strict=True))
    beliefs[target.root] = root.log

    agent_ud = {}
    for obs in plan.observations:
        if obs.agent in beliefs:
            boxes, message = evidence.latent.get(obs.at, hypotheses).boxes, evidence.messages[obs.agent]
            peak = boxes[int(np.argmax(message))]
            agent_ud[obs.agent] = _ud(target, target.root, boxes, beliefs[obs.agent], peak)

    governing = [beliefs.get(governor, root.log) for governor in governors]
    references = governing if is_alone(plan) and not plan.draws else [beliefs[agent] for agent in agents]
    nats = divergences(
        _rows((*governing, *governing, *logs[: len(nodes)]), len(prior)),
        _rows((*references, *logs[len(nodes) :], *[prior] * len(nodes)), len(prior)),
    ).tolist()

    parts = part_beliefs(plan, evidence, step.support.weights)
    uds = _node_uds(target, step, beliefs, parts)
    silent = silent_of(evidence)
    at_parts = _measure_parts(target, evidence, parts, uds)
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


def _measure_parts(
    target: CheckedTarget,
    evidence: Evidence,
    beliefs: Mapping[str, PartBelief],
    ud_px2: Mapping[str, float],
) -> dict[str, PartMeasure]:
    """Part -> its measures; `ud_px2` holds the UD of every inference node."""
    part_of = part_of_agents(target) if beliefs else {}
    measures: dict[str, PartMeasure] = {}
    for part, belief in beliefs.items():
        agents = [
            agent for agent in target.agents if part_of.get(agent) == part and agent in evidence.messages
        ]
        status = _status(target, evidence, agents, belief.weights.weights)
        measures[part] = PartMeasure(belief.mean, belief.sd, ud_px2[part], status)
    return measures


def _status(target: CheckedTarget, evidence: Evidence, agents: list[str], weights: Floats) -> PartStatus:
    """Seen when the likelihood of the belief, its geometric mean over draws and agents, is high enough."""
    seeing = [agent for agent in agents if evidence.measured.get(agent, evidence) is not None]
    if not seeing:
        return "hidden" if agents else "unwatched"
    has_weight = weights > 0
    fits = [float(weights[has_weight] @ evidence.messages[agent][has_weight]) for agent in seeing]
    lost = target.lost
    return "seen" if np.exp(np.mean(fits)) >= lost.fit_below else "hidden"


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
    first, *remaining = (message if len(messages) == 1 else message / len(messages) for message in messages)
    return float(np.exp(min(float(sum(remaining, first).max()), 0.0)))


def _asks_for_the_dispensable(target: CheckedTarget, governor: str) -> bool:
    rules = target.inference(governor).adapt
    deactivate = None if rules is None else rules.deactivate
    return deactivate is not None and deactivate.drop == "most_expensive_redundant"


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
    hidden = {part for part, measure in parts.items() if measure.status == "hidden"}
    return [agent for agent in seeing if part_of.get(agent) not in hidden] or seeing


def _rows(arrays: Iterable[Floats], size: int) -> Floats:
    """(M, size) the arrays (size,) as rows, also when there are none."""
    return np.array(list(arrays), dtype=np.float64).reshape(-1, size)


@lru_cache(maxsize=256)
def state_columns(target: CheckedTarget, node: str) -> tuple[int, ...]:
    """The columns of a state over which UD of a node is taken."""
    return tuple(BOX_FIELDS.index(name) for name in target.inference(node).ud_fields)


@lru_cache(maxsize=256)
def state_index(target: CheckedTarget, node: str) -> slice | list[int]:
    """The index of these columns."""
    return column_index(state_columns(target, node))


def _ud(target: CheckedTarget, node: str, boxes: Floats, log: Floats, centre: Floats) -> float:
    columns = state_index(target, node)
    return uncertainty_deviation(boxes[:, columns], np.exp(log), centre[columns])


def _node_uds(
    target: CheckedTarget,
    step: Step[Posterior],
    beliefs: Mapping[str, Floats],
    parts: Mapping[str, PartBelief],
) -> dict[str, float]:
    """UD of every inference node, the root's first."""
    uds = {target.root: step.posterior.uncertainty(step.map_state, state_columns(target, target.root))}
    for node in target.order:
        parent = target.parent[node]
        if parent is None or node not in target.children:
            continue
        if node in parts:
            uds[node] = parts[node].uncertainty(state_columns(target, node))
        elif node in beliefs:
            latent = step.evidence.latent.get(node)
            boxes = step.support.boxes if latent is None else latent.boxes
            peak = boxes[int(np.argmax(beliefs[node]))]
            uds[node] = _ud(target, node, boxes, beliefs[node], peak)
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
    ancestor: str | None = target.parent[node]
    while (
        ancestor is not None and ancestor != target.root and ancestor not in beliefs and ancestor not in parts
    ):
        ancestor = target.parent[ancestor]
    if ancestor is not None and ancestor in parts:
        return parts[ancestor].uncertainty(state_columns(target, node))
    if ancestor is None or ancestor == target.root:
        return step.posterior.uncertainty(step.map_state, state_columns(target, node))
    latent = step.evidence.latent.get(ancestor)
    boxes = step.support.boxes if latent is None else latent.boxes
    return _ud(target, node, boxes, beliefs[ancestor], boxes[int(np.argmax(beliefs[ancestor]))])


def _insides(
    target: CheckedTarget,
    step: Step[Posterior],
    beliefs: Mapping[str, Floats],
    parts: Mapping[str, PartBelief],
) -> dict[tuple[str, float], Inside]:
    """Shares of belief around every node's mode (a part's estimate), in the windows of its rules."""
    insides: dict[tuple[str, float], Inside] = {}
    for node in target.children:
        for within_box in _windows(target, node):
            insides[node, within_box] = _inside(target, node, step, beliefs, parts, within_box)
    return insides


def _windows(target: CheckedTarget, node: str) -> set[float]:
    rules = target.inference(node).adapt
    activate = None if rules is None or rules.activate is None else rules.activate.unless
    deactivate = None if rules is None or rules.deactivate is None else rules.deactivate.when
    tests = [rule.concentrated for rule in (activate, deactivate) if rule is not None]
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
    ancestor: str | None = node
    while ancestor is not None and ancestor not in beliefs and ancestor not in parts:
        ancestor = target.parent[ancestor]
    if ancestor is not None and ancestor in parts:
        boxes, weights_of_part, mode = parts[ancestor].boxes, parts[ancestor].weights, parts[ancestor].mean
        radius = within_box * float(np.sqrt(mode[2] * mode[3]))
        share = weighted_mass_in_disc(boxes[:, :2], weights_of_part.weights, mode[:2], radius)
        return Inside(share, weights_of_part.ess, radius)
    if ancestor is None or ancestor == target.root:
        mode = step.map_state
        radius = within_box * float(np.sqrt(mode[2] * mode[3]))
        share, trials = step.posterior.mass_within(mode[:2], radius)
        return Inside(share, trials, radius)
    latent, log = step.evidence.latent.get(ancestor), beliefs[ancestor]
    boxes = step.support.boxes if latent is None else latent.boxes
    mode, weights = boxes[int(np.argmax(log))], np.exp(log)
    radius = within_box * float(np.sqrt(mode[2] * mode[3]))
    share = weighted_mass_in_disc(boxes[:, :2], weights, mode[:2], radius)
    return Inside(share, float(1.0 / np.sum(weights**2)), radius)
