"""Measure the steps of many targets with one plan: the same numbers as `measure.measure`, as arrays.

Sums run along the hypotheses of one target at a time, in the order in which they run for it alone: no bit
depends on who else is measured.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import Any

import numpy as np

from bayesnet_track.adapt.measures import Measures
from bayesnet_track.belief.contract import BOX_FIELDS, Step
from bayesnet_track.belief.particles.particle_set import ParticleSet
from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.inference.compile import Plan
from bayesnet_track.inference.messages import join_plain
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.log_weights import divergences, select, tilt

Rest = tuple[Sequence[Sequence[float]], Sequence[Sequence[float]], Sequence[Sequence[float]]]


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


def is_alone(plan: Plan) -> bool:
    """Whether nobody but one agent says anything: without it the prior is left."""
    return len(plan.observations) == 1 and not plan.factors


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


@dataclass(frozen=True, eq=False)
class RowMeasures:
    """What is measured of T targets; what no rule of a plain net asks for is found with the first `of`.

    Attributes:
        target: the flat net.
        agents: those who said something, A of them.
        uds: of each target, UD of its belief, px^2.
        fits: of each, as in `Measures`.
        areas: of each estimate, px^2.
        nats: (T, A) contributions.
        find_rest: () -> of each target by agent, KL and strength in nats, UD in px^2.
    """

    target: CheckedTarget
    agents: Sequence[str]
    uds: Sequence[float]
    fits: Sequence[float]
    areas: Sequence[float]
    nats: Floats
    find_rest: Callable[[], Rest]

    def __len__(self) -> int:
        return len(self.uds)

    @cached_property
    def _rest(self) -> Rest:
        return self.find_rest()

    def of(self, row: int) -> Measures:
        """What is measured of one."""
        kl, strength, uds = (dict(zip(self.agents, part[row], strict=True)) for part in self._rest)
        return Measures(
            ud_px2={self.target.root: self.uds[row]},
            agent_ud_px2=uds,
            kl=kl,
            contribution=dict(zip(self.agents, self.nats[row].tolist(), strict=True)),
            strength=strength,
            fit=self.fits[row],
            area_px2=self.areas[row],
        )


@dataclass(frozen=True, eq=False)
class Looks:
    """Plain steps of T targets with N hypotheses each, by the same A agents.

    Attributes:
        messages: (A, T, N) log-likelihoods by agent, in the order of the plan's observations.
        prior: (T, N) log-weights before the evidence.
        log: (T, N) those after it.
        weights: (T, N).
        states: (T, N, D).
        best: (T, D) the MAP states.
    """

    messages: Floats
    prior: Floats
    log: Floats
    weights: Floats
    states: Floats
    best: Floats

    @classmethod
    def of(cls, plan: Plan, steps: Sequence[Step[Any]]) -> Looks:
        """Those of steps with the same number of hypotheses each."""
        return cls(
            np.array([[step.evidence.messages[one.agent] for step in steps] for one in plan.observations]),
            np.array([step.prior.log for step in steps]),
            np.array([step.support.weights.log for step in steps]),
            np.array([step.support.weights.weights for step in steps]),
            np.array([step.support.states for step in steps]),
            np.array([step.map_state for step in steps]),
        )


def measure_rows(target: CheckedTarget, plan: Plan, looks: Looks, areas_px2: Sequence[float]) -> RowMeasures:
    """What is measured of plain steps of a flat net."""
    agents, columns, messages = [one.agent for one in plan.observations], _columns(target), looks.messages
    boxes = np.ascontiguousarray(looks.states[:, :, columns])
    without = (
        looks.prior[None] if is_alone(plan) else tilt(looks.prior, _without_each(plan, agents, messages))
    )
    nats = divergences(np.array([looks.log] * len(agents)), without).T
    fits = np.exp(
        np.minimum(sum((own / len(agents) for own in messages), np.zeros_like(looks.prior)).max(axis=1), 0.0)
    )
    return RowMeasures(
        target,
        agents,
        _uds(boxes, looks.weights, looks.best[:, columns]),
        fits.tolist(),
        areas_px2,
        nats,
        partial(_find_rest, messages, looks.prior, looks.log, boxes),
    )


def _find_rest(messages: Floats, prior: Floats, root: Floats, boxes: Floats) -> Rest:
    """KL and strength of each agent (A, T, N), and UD of what it says by itself."""
    count = len(messages)
    logs = tilt(prior, messages)
    alone = root[None] if count == 1 else logs
    nats = divergences(np.concatenate([[root] * count, logs]), np.concatenate([alone, [prior] * count]))
    best, rows = messages.argmax(axis=2), np.arange(len(prior))
    uds = [_uds(boxes, np.exp(own), boxes[rows, at]) for own, at in zip(logs, best, strict=True)]
    return nats[:count].T.tolist(), nats[count:].T.tolist(), list(zip(*uds, strict=True))


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
    """UD of each target (`numerics.log_weights.uncertainty_deviation`): (T, N, K), (T, N) about (T, K)."""
    away = (boxes - centres[:, None]).reshape(-1, boxes.shape[2])
    squares = np.einsum("nk,nk->n", away, away).reshape(weights.shape)
    return [float(np.dot(*pair)) for pair in zip(weights, squares, strict=True)]
