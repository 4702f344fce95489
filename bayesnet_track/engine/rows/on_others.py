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
from bayesnet_track.engine.rows.filtered_rows import FilteredRows, Together
from bayesnet_track.inference.messages import Observer, evaluate, join_plain
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.observation.likelihoods import ReferenceRows

ON_SIZE = 8
"""Boxes at which a target's agents are asked what they say of the one in front."""

LEAST = -1e3
"""Less than this counts as this: a likelihood of zero has no mean logarithm."""


def logs_on(
    work: FrameContext, neighbours: Mapping[str, Sequence[str]], of: Together
) -> dict[str, dict[str, float]]:
    """Target -> other -> mean log-likelihood, by its own agents, of boxes of it wholly on the other's.

    Where its box is the larger one, in the middle of the other's.
    """
    work = replace(work, seconds={})  # what this takes is counted among the joins
    found: dict[str, dict[str, float]] = {}
    for group in of.groups:
        names = [
            name for name in group.ids if name in neighbours and all(one in group for one in neighbours[name])
        ]
        if names:
            found |= _ask_together(work, group, {name: neighbours[name] for name in names})
    return {
        name: found[name] if name in found else _ask(work, of[name], others, [of[other] for other in others])
        for name, others in neighbours.items()
    }


def _ask_together(
    work: FrameContext, group: FilteredRows, neighbours: Mapping[str, Sequence[str]]
) -> dict[str, dict[str, float]]:
    """What `logs_on` gives of targets and neighbours of one group, without those where an agent fails."""
    from bayesnet_track.numerics.kernels.joint_kernels import put_on_others

    index, counts = group.before.index, [len(others) for others in neighbours.values()]
    rows = np.array([index[name] for name in neighbours])
    firsts = np.cumsum([0, *counts])
    places = put_on_others(
        group.clouds.states,
        group.clouds.weights,
        rows,
        firsts,
        np.array([index[other] for others in neighbours.values() for other in others]),
        _uniforms(work, neighbours),
        ON_SIZE,
    )
    hypotheses = hypotheses_of(places, group.clouds.fields)
    asked = [one.agent for one in group.plan.observations]
    known = {agent: ReferenceRows.some(group.references[agent], rows) for agent in asked}
    messages, failed = ask_together(work, (group.compiled, group.plan, known), hypotheses, firsts * ON_SIZE)
    log = join_plain(group.plan, messages, (len(places),))[group.plan.root]
    means = _means(log)
    return {
        name: dict(zip(others, means[first : first + len(others)], strict=True))
        for t, ((name, others), first) in enumerate(zip(neighbours.items(), firsts.tolist(), strict=False))
        if t not in failed
    }


def _means(log: Floats) -> list[float]:
    """Of (K * ON_SIZE,) log-likelihoods the K means."""
    means: list[float] = np.maximum(log, LEAST).reshape(-1, ON_SIZE).mean(axis=1).tolist()
    return means


def _uniforms(work: FrameContext, neighbours: Mapping[str, Sequence[str]]) -> Floats:
    """The random numbers of all: of each target its own shift, a shift for each other, two for each box."""
    counts = [1 + len(others) * (1 + 2 * ON_SIZE) for others in neighbours.values()]
    return work.engine.streams.uniforms(work.births_of(neighbours), "on", work.moment, "places", counts)


def _places(work: FrameContext, one: Filtered, others: Sequence[Filtered]) -> Floats:
    """(K, D) states of a target, `ON_SIZE` on each of the others."""
    from bayesnet_track.numerics.resampling import look_up_even

    count, size = len(others), ON_SIZE * len(others)
    uniforms = work.stream(one.target, "on")("places").random(1 + count + 2 * size)
    own = one.step.support
    states = own.states[look_up_even(own.weights.weights, uniforms[0], size)]
    boxes = np.concatenate(
        [
            there.boxes[look_up_even(there.weights.weights, shift, ON_SIZE)]
            for there, shift in zip(
                (other.step.support for other in others), uniforms[1 : 1 + count], strict=True
            )
        ]
    )
    room = np.maximum(boxes[:, 2:] - states[:, 2:4], 0.0)
    states[:, :2] = boxes[:, :2] + room * (uniforms[1 + count :].reshape(size, 2) - 0.5)
    return states


def _ask(
    work: FrameContext, one: Filtered, names: Sequence[str], others: Sequence[Filtered]
) -> dict[str, float]:
    """What `logs_on` gives of one target."""
    states = _places(work, one, others)
    observer = Observer(
        work.cache,
        work.plate_of(one.target).cues,
        one.before.references,
        work.stream(one.target, "on"),
        work.engine.clock,
        work.seconds,
        availability=work.availability_of(one.target, "joining"),
    )
    seen = hypotheses_of(states, particles(one.step.posterior).fields)
    plan = replace(one.plan, factors=())
    log = evaluate(plan, observer, seen, LogWeights.uniform(len(states)).log).log_likelihood
    return dict(zip(names, _means(log), strict=True))
