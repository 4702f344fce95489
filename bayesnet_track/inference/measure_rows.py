"""Measure the steps of many targets with one plan: the same numbers as `measure.measure`, as arrays.

Sums run along the hypotheses of one target at a time, in the order in which they run for it alone: no bit
depends on who else is measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from bayesnet_track.adapt.measures import Measures
from bayesnet_track.belief.contract import BOX_FIELDS, Step
from bayesnet_track.belief.particles.particle_set import ParticleSet
from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.inference.compile import Plan
from bayesnet_track.inference.messages import join_plain
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.divergence import select
from bayesnet_track.numerics.tilts import divergences, tilt


@lru_cache(maxsize=64)
def is_flat(target: CheckedTarget) -> bool:
    """Whether the only beliefs of a net are the root's and its agents', and its rules ask for no more."""
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


def is_plain(plan: Plan, step: Step[Any]) -> bool:
    """Whether a step of a flat net is of particles that all of its agents, one at least, scored."""
    evidence = step.evidence
    return (
        isinstance(step.posterior, ParticleSet)
        and step.support is step.posterior
        and not (plan.draws or plan.factors or evidence.latent or evidence.measured or evidence.factors)
        and len(plan.observations) > 0
        and evidence.messages.keys() == plan.active
    )


def measure_rows(
    target: CheckedTarget, plan: Plan, steps: Sequence[Step[Any]], areas_px2: Sequence[float]
) -> list[Measures]:
    """What is measured of plain `steps` of a flat net, with the same number of hypotheses each."""
    agents = [one.agent for one in plan.observations]
    count = len(agents)
    messages = np.array([[step.evidence.messages[agent] for step in steps] for agent in agents])
    prior = np.array([step.prior.log for step in steps])
    root = np.array([step.support.weights.log for step in steps])
    weights = np.array([step.support.weights.weights for step in steps])
    boxes = np.array([step.support.states[:, _columns(target)] for step in steps])
    logs = tilt(prior, np.concatenate([messages, _without_each(plan, agents, messages)]))
    alone = [root] if count == 1 else logs[:count]
    nats = divergences(
        np.concatenate([[root] * (2 * count), logs[:count]]),
        np.concatenate([alone, logs[count:], [prior] * count]),
    )
    best = messages.argmax(axis=2)
    rows = np.arange(len(steps))
    agent_uds = [_uds(boxes, np.exp(logs[k]), boxes[rows, best[k]]) for k in range(count)]
    about = np.array([step.map_state for step in steps])[:, _columns(target)]
    uds = _uds(boxes, weights, about)
    fits = np.exp(np.minimum(sum((own / count for own in messages), np.zeros_like(prior)).max(axis=1), 0.0))
    kl, contribution, strength = (
        [dict(zip(agents, own, strict=True)) for own in nats[k * count : (k + 1) * count].T.tolist()]
        for k in range(3)
    )
    return [
        Measures(
            ud_px2={target.root: uds[t]},
            agent_ud_px2={agent: agent_uds[k][t] for k, agent in enumerate(agents)},
            kl=kl[t],
            contribution=contribution[t],
            strength=strength[t],
            fit=fit,
            area_px2=areas_px2[t],
        )
        for t, fit in enumerate(fits.tolist())
    ]


def _columns(target: CheckedTarget) -> slice | list[int]:
    return select([BOX_FIELDS.index(name) for name in target.inference(target.root).ud_fields])


def _without_each(plan: Plan, agents: Sequence[str], messages: Floats) -> Floats:
    """(A, T, N) the root's message had each agent been switched off; zeros without the only one."""
    if len(agents) == 1:
        return np.zeros_like(messages)
    said = dict(zip(agents, messages, strict=True))
    return np.array(
        [
            join_plain(plan, {name: own for name, own in said.items() if name != agent}, messages.shape[1:])[
                plan.root
            ]
            for agent in agents
        ]
    )


def _uds(boxes: Floats, weights: Floats, centres: Floats) -> list[float]:
    """UD of each target (`numerics.divergence.uncertainty_deviation`): (T, N, K), (T, N) about (T, K)."""
    away = (boxes - centres[:, None]).reshape(-1, boxes.shape[2])
    squares = np.einsum("nk,nk->n", away, away).reshape(weights.shape)
    return [float(np.dot(*pair)) for pair in zip(weights, squares, strict=True)]
