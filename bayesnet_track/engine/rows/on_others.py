"""What the agents of joined targets say of boxes that lie on another target.

Targets of a group are asked together, to the same bytes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from bayesnet_track.belief.contract import hypotheses_of
from bayesnet_track.engine.attachment import particles
from bayesnet_track.engine.filtering import Filtered
from bayesnet_track.engine.frame_context import FrameContext, ask_together
from bayesnet_track.engine.rows.filtered_rows import FilteredRows, FilteredTargets
from bayesnet_track.inference.messages import Observer, evaluate, join_plain
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.observation.likelihoods import ReferenceRows

ON_SIZE = 8
"""Boxes at which a target's agents are asked what they say of the one in front."""

LEAST = -1e3
"""Less than this counts as this: a likelihood of zero has no mean logarithm."""


def logs_on(
    work: FrameContext, neighbours: Mapping[str, Sequence[str]], filtered: FilteredTargets
) -> dict[str, dict[str, float]]:
    """Target -> other -> mean log-likelihood, by its own agents, of boxes of it wholly on the other's.

    Where its box is the larger one, in the middle of the other's.
    """
    work = replace(work, seconds={})  # what this takes is counted among the joins
    logs: dict[str, dict[str, float]] = {}
    for group in filtered.groups:
        names = [
            name
            for name in group.ids
            if name in neighbours and all(partner in group for partner in neighbours[name])
        ]
        if names:
            logs |= _ask_together(work, group, {name: neighbours[name] for name in names})
    return {
        name: logs[name]
        if name in logs
        else _ask(work, filtered[name], partners, [filtered[partner] for partner in partners])
        for name, partners in neighbours.items()
    }


def _ask_together(
    work: FrameContext, group: FilteredRows, neighbours: Mapping[str, Sequence[str]]
) -> dict[str, dict[str, float]]:
    """Values of `logs_on` for targets and neighbours of one group, without those where an agent fails."""
    from bayesnet_track.numerics.kernels.joint_kernels import put_on_others

    index, counts = group.before.index, [len(partners) for partners in neighbours.values()]
    rows = np.array([index[name] for name in neighbours])
    firsts = np.cumsum([0, *counts])
    places = put_on_others(
        group.clouds.states,
        group.clouds.weights,
        rows,
        firsts,
        np.array([index[partner] for partners in neighbours.values() for partner in partners]),
        _uniforms(work, neighbours),
        ON_SIZE,
    )
    hypotheses = hypotheses_of(places, group.clouds.fields)
    agents = [observation.agent for observation in group.plan.observations]
    references = {agent: ReferenceRows.some(group.references[agent], rows) for agent in agents}
    messages, failed = ask_together(
        work, (group.compiled, group.plan, references), hypotheses, firsts * ON_SIZE
    )
    log = join_plain(group.plan, messages, (len(places),))[group.plan.root]
    means = _means(log)
    return {
        name: dict(zip(partners, means[first : first + len(partners)], strict=True))
        for t, ((name, partners), first) in enumerate(zip(neighbours.items(), firsts.tolist(), strict=False))
        if t not in failed
    }


def _means(log: Floats) -> list[float]:
    """Of (K * ON_SIZE,) log-likelihoods the K means."""
    means: list[float] = np.maximum(log, LEAST).reshape(-1, ON_SIZE).mean(axis=1).tolist()
    return means


def _uniforms(work: FrameContext, neighbours: Mapping[str, Sequence[str]]) -> Floats:
    """The random numbers of all: of each target its own shift, a shift for each other, two for each box."""
    counts = [1 + len(partners) * (1 + 2 * ON_SIZE) for partners in neighbours.values()]
    return work.engine.streams.uniforms(work.births_of(neighbours), "on", work.moment, "places", counts)


def _places(work: FrameContext, target: Filtered, partners: Sequence[Filtered]) -> Floats:
    """(K, D) states of a target, `ON_SIZE` on each of the others."""
    from bayesnet_track.numerics.resampling import look_up_even

    count, size = len(partners), ON_SIZE * len(partners)
    uniforms = work.stream(target.target, "on")("places").random(1 + count + 2 * size)
    support = target.step.support
    states = support.states[look_up_even(support.weights.weights, uniforms[0], size)]
    boxes = np.concatenate(
        [
            partner_support.boxes[look_up_even(partner_support.weights.weights, shift, ON_SIZE)]
            for partner_support, shift in zip(
                (partner.step.support for partner in partners), uniforms[1 : 1 + count], strict=True
            )
        ]
    )
    room = np.maximum(boxes[:, 2:] - states[:, 2:4], 0.0)
    states[:, :2] = boxes[:, :2] + room * (uniforms[1 + count :].reshape(size, 2) - 0.5)
    return states


def _ask(
    work: FrameContext, target: Filtered, names: Sequence[str], partners: Sequence[Filtered]
) -> dict[str, float]:
    """Values of `logs_on` for one target."""
    states = _places(work, target, partners)
    observer = Observer(
        work.cache,
        work.plate_of(target.target).cues,
        target.before.references,
        work.stream(target.target, "on"),
        work.engine.clock,
        work.seconds,
        availability=work.availability_of(target.target, "joining"),
    )
    hypotheses = hypotheses_of(states, particles(target.step.posterior).fields)
    plan = replace(target.plan, factors=())
    log = evaluate(plan, observer, hypotheses, LogWeights.uniform(len(states)).log).log_likelihood
    return dict(zip(names, _means(log), strict=True))
