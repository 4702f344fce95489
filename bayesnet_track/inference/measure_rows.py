"""Measure the steps of targets of a flat net with one plan: what `measure.measure` measures of any net.

Sums run along the hypotheses of one target at a time, in the order in which they run for it alone: no bit
depends on who else is measured.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from typing import Any

import numpy as np

from bayesnet_track.adapt.rule_inputs import GroupMeasures, Measures
from bayesnet_track.belief.contract import BOX_FIELDS, Evidence, Step
from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.inference.compile import Plan
from bayesnet_track.inference.messages import join_plain
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.log_weights import divergences, select, tilt
from bayesnet_track.numerics.records import Found

Rest = tuple[Sequence[Sequence[float]], Sequence[Sequence[float]], Sequence[Sequence[float]]]


@lru_cache(maxsize=64)
def is_flat(target: CheckedTarget) -> bool:
    """True where the only beliefs of a net are the root's and its agents', and its rules ask for no more."""
    root = target.inference(target.root)
    rules = root.adapt
    on, off = (None, None) if rules is None else (rules.activate, rules.deactivate)
    tests = [None if on is None else on.unless, None if off is None else off.when]
    return (
        len(target.children) == 1
        and all((target.governor[agent] or target.root) == target.root for agent in target.agents)
        and all(test is None or test.concentrated is None for test in tests)
        and (off is None or off.drop != "most_expensive_redundant")
        and isinstance(_columns(target), slice)
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
        messages: agent, and factor -> (T, N) log-likelihoods.
        prior: (T, N) log-weights before the evidence.
        log: (T, N) those after it.
        boxes: (T, N, 4) hypotheses of centre boxes, px.
        uds: of each target, UD of its belief about the estimate, px^2.
    """

    agents: Sequence[str]
    silent: tuple[str, ...]
    messages: Mapping[str, Floats]
    prior: Floats
    log: Floats
    boxes: Floats
    uds: Sequence[float]

    @staticmethod
    def key(plan: Plan, step: Step[Any]) -> Hashable:
        """Equal for steps by one plan that can be measured together."""
        evidence = step.evidence
        names = (*evidence.messages,), (*evidence.factors,), silent_of(evidence)
        return plan.active, names, len(step.prior)

    @classmethod
    def of(cls, target: CheckedTarget, plan: Plan, steps: Sequence[Step[Any]]) -> StepArrays:
        """Arrays of steps with the same key."""
        evidence, columns = steps[0].evidence, [BOX_FIELDS.index(name) for name in _ud_fields(target)]
        messages = {
            name: _stack([step.evidence.messages[name] for step in steps]) for name in evidence.messages
        }
        factors = {name: _stack([step.evidence.factors[name] for step in steps]) for name in evidence.factors}
        return cls(
            [one.agent for one in plan.observations if one.agent in messages],
            silent_of(evidence),
            messages | factors,
            _stack([step.prior.log for step in steps]),
            _stack([step.support.weights.log for step in steps]),
            _stack([step.support.boxes for step in steps]),
            [step.posterior.uncertainty(step.map_state, columns) for step in steps],
        )


def _stack(arrays: list[Floats]) -> Floats:
    return arrays[0][None] if len(arrays) == 1 else np.array(arrays)


def silent_of(evidence: Evidence) -> tuple[str, ...]:
    """The agents that measure and did not see the target."""
    return tuple(agent for agent, own in evidence.measured.items() if own is None)


def measure_rows(target: CheckedTarget, plan: Plan, steps: StepArrays, areas_px2: Floats) -> GroupMeasures:
    """Measures of the steps of a flat net; every index is taken on the step's own hypotheses.

    Those that rules seldom ask for are found when one does, for all targets at once.
    """
    agents, messages = steps.agents, steps.messages
    without = steps.prior[None] if is_alone(plan) else tilt(steps.prior, _without_each(plan, steps))
    nats = divergences(np.broadcast_to(steps.log, (len(agents), *steps.log.shape)), without).T
    seeing = [messages[agent] for agent in agents if agent not in steps.silent]
    total = sum((own / len(seeing) for own in seeing), np.zeros_like(steps.prior)).max(axis=1)
    fits = np.exp(np.minimum(total, 0.0)) if seeing else np.zeros(len(areas_px2))
    heard = np.array([messages[agent] for agent in agents]).reshape(len(agents), *steps.prior.shape)
    columns = {target.root: np.array(steps.uds)}, areas_px2, fits, agents, nats
    rest = cache(partial(_find_rest, target, plan, heard, steps))
    uds, areas, fits, agents, nats = columns
    of = partial(_measures_of, columns, target.root, steps.silent, rest)
    return GroupMeasures(uds=uds, areas=areas, fits=fits, agents=agents, nats=nats, of=of)


Columns = tuple[Mapping[str, Floats], Floats, Floats, Sequence[str], Floats]


def _measures_of(
    columns: Columns, root: str, silent: tuple[str, ...], find_rest: Callable[[], Rest], row: int
) -> Measures:
    """All that is measured of one target."""
    uds, areas, fits, agents, nats = columns
    kl, strength, agent_uds = (
        Found(agents, partial(_of_agents, agents, find_rest, row, part)) for part in range(3)
    )
    return Measures(
        ud_px2={root: float(uds[root][row])},
        agent_ud_px2=agent_uds,
        kl=kl,
        contribution=dict(zip(agents, nats[row].tolist(), strict=True)),
        strength=strength,
        fit=float(fits[row]),
        area_px2=float(areas[row]),
        silent=silent,
    )


def _of_agents(agents: Sequence[str], find_rest: Callable[[], Rest], row: int, part: int) -> dict[str, float]:
    return dict(zip(agents, find_rest()[part][row], strict=True))


def _find_rest(target: CheckedTarget, plan: Plan, messages: Floats, steps: StepArrays) -> Rest:
    """KL and strength of each agent's (A, T, N) messages, and UD of what it says by itself."""
    count, prior, root = len(messages), steps.prior, steps.log
    if not count:
        return ([[]] * len(prior),) * 3
    logs, boxes = tilt(prior, messages), steps.boxes[:, :, _columns(target)]
    alone = root[None] if is_alone(plan) else logs
    nats = divergences(np.concatenate([[root] * count, logs]), np.concatenate([alone, [prior] * count]))
    best, rows = messages.argmax(axis=2), np.arange(len(prior))
    uds = [uncertainties(boxes, np.exp(own), boxes[rows, at]) for own, at in zip(logs, best, strict=True)]
    return nats[:count].T.tolist(), nats[count:].T.tolist(), list(zip(*uds, strict=True))


def _ud_fields(target: CheckedTarget) -> Sequence[str]:
    return tuple(target.inference(target.root).ud_fields)


def _columns(target: CheckedTarget) -> slice | list[int]:
    return select([BOX_FIELDS.index(name) for name in _ud_fields(target)])


def _without_each(plan: Plan, steps: StepArrays) -> Floats:
    """(A, T, N) the root's message had each agent been switched off; zeros where nothing is left."""
    shape = steps.prior.shape
    seeing = {name: own for name, own in steps.messages.items() if name not in steps.silent}
    left = [
        join_plain(plan, {name: own for name, own in seeing.items() if name != agent}, shape)
        for agent in steps.agents
    ]
    nothing = np.zeros(shape)
    return np.array([one.get(plan.root, nothing) for one in left]).reshape(len(left), *shape)


def uncertainties(states: Floats, weights: Floats, centres: Floats) -> list[float]:
    """UD of each target (`numerics.log_weights.uncertainty_deviation`): (T, N, K), (T, N) about (T, K)."""
    away = (states - centres[:, None]).reshape(-1, states.shape[2])
    squares = np.einsum("nk,nk->n", away, away).reshape(weights.shape)
    return [float(np.dot(*pair)) for pair in zip(weights, squares, strict=True)]
