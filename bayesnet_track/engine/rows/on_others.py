"""What the agents of joined targets say of boxes that lie on another target.

Targets whose agents score hypotheses of several targets at once (`CrowdCue`) are asked together, to the same
bytes.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from bayesnet_track.belief.states import hypotheses_of
from bayesnet_track.engine.attachment import particles
from bayesnet_track.engine.filtering import Filtered
from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.engine.rows.particle_rows import ask_together, asks_together
from bayesnet_track.inference.measure_rows import is_flat
from bayesnet_track.inference.messages import Observer, evaluate, join_plain
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.log_weights import LogWeights

ON_SIZE = 8
"""Boxes at which a target's agents are asked what they say of the one in front."""

LEAST = -1e3
"""Less than this counts as this: a likelihood of zero has no mean logarithm."""


def logs_on(
    work: FrameWork, neighbours: Mapping[str, Sequence[str]], of: Mapping[str, Filtered]
) -> dict[str, dict[str, float]]:
    """Target -> other -> mean log-likelihood, by its own agents, of boxes of it wholly on the other's.

    Where its box is the larger one, in the middle of the other's.
    """
    work = replace(work, seconds={})  # what this takes is counted among the joins
    states = {
        name: _places(work, of[name], [of[other] for other in others]) for name, others in neighbours.items()
    }
    alike: dict[Hashable, list[str]] = {}
    for name in neighbours:
        one, compiled = of[name], work.plate_of(name)
        if (
            one.plan.active == one.before.plan.active
            and is_flat(compiled.plate)
            and compiled.modes is None
            and asks_together(work, compiled, one.before)
        ):
            alike.setdefault((compiled.plate.name, one.plan.active), []).append(name)
    logs: dict[str, Floats] = {}
    for names in alike.values():
        if len(names) > 1:  # arrays of one row take longer
            logs |= _ask_together(work, [of[name] for name in names], [states[name] for name in names])
    found: dict[str, dict[str, float]] = {}
    for name, others in neighbours.items():
        log = logs[name] if name in logs else _ask(work, of[name], states[name])
        means = np.maximum(log, LEAST).reshape(len(others), ON_SIZE).mean(axis=1)
        found[name] = dict(zip(others, means.tolist(), strict=True))
    return found


def _places(work: FrameWork, one: Filtered, others: Sequence[Filtered]) -> Floats:
    """(K, D) states of a target, `ON_SIZE` on each of the others."""
    from bayesnet_track.numerics.kernels.resampling_kernels import look_up_even

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


def _ask_together(
    work: FrameWork, targets: Sequence[Filtered], states: Sequence[Floats]
) -> dict[str, Floats]:
    """Target -> (K,) log-likelihoods of its states; of none where an agent fails."""
    boxes = np.concatenate([own[:, :4] for own in states])
    starts = np.cumsum([0, *map(len, states)])
    plan, compiled = replace(targets[0].plan, factors=()), work.plate_of(targets[0].target)
    messages = ask_together(work, compiled, [one.before for one in targets], boxes, starts)
    if messages is None:
        return {}
    log = join_plain(plan, messages, (len(boxes),))[plan.root]
    return {
        one.target: log[first:last]
        for one, first, last in zip(targets, starts[:-1].tolist(), starts[1:].tolist(), strict=True)
    }


def _ask(work: FrameWork, one: Filtered, states: Floats) -> Floats:
    """(K,) log-likelihoods of a target's states."""
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
    return evaluate(plan, observer, seen, LogWeights.uniform(len(states)).log).log_likelihood
