"""The maximum a posteriori hypotheses of many targets at once: those of `map.map_index`, one kernel call."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesnet_track.belief.contract import MotionModel, Step
from bayesnet_track.belief.motion.bounds import Confined
from bayesnet_track.belief.motion.models import KinematicMotion
from bayesnet_track.belief.particles.belief import FindMap
from bayesnet_track.numerics.arrays import Floats, Ints


def find_maps(steps: Iterable[Step[Any]]) -> None:
    """Find `map_state` of the steps of particle filters that share a motion, before anybody asks for it.

    Other steps find theirs when they are asked. Every row of states moves by itself, so that the states of
    several targets can stand below each other.
    """
    alike: dict[Hashable, list[tuple[Step[Any], FindMap]]] = {}
    for step in steps:
        find = step.find_map
        if not isinstance(find, FindMap) or "map_state" in step.__dict__:
            continue
        motion = find.inputs.motion
        inner = motion.motion if isinstance(motion, Confined) else motion
        if isinstance(inner, KinematicMotion):
            key = (inner, find.inputs.dt, find.states.shape, find.inputs.prior.states.shape)
            alike.setdefault(key, []).append((step, find))
    for group in alike.values():
        _find(group)


def _find(group: list[tuple[Step[Any], FindMap]]) -> None:
    finds = [find for _, find in group]
    inputs = finds[0].inputs
    before = Before(
        np.array([one.inputs.prior.states for one in finds]),
        np.array([one.inputs.prior.weights.log for one in finds]),
    )
    said, states = np.array([one.log_likelihood for one in finds]), np.array([one.states for one in finds])
    best = find_places(inputs.motion, inputs.dt, before, said, states)
    for (step, find), place in zip(group, best.tolist(), strict=True):
        if place >= 0:  # else all densities are 0 in floating point, and the step looks further
            step.__dict__["map_state"] = find.states[place]


@dataclass(frozen=True, eq=False)
class Before:
    """The beliefs of T targets before they moved: states (T, K, D) and log-weights (T, K)."""

    states: Floats
    log: Floats


def find_places(motion: MotionModel, dt: float, before: Before, said: Floats, states: Floats) -> Ints:
    """(T,) which of the hypotheses (T, N, D), of log-likelihoods `said` (T, N), is each target's MAP.

    -1 where all densities are 0 in floating point. The motion is that of a `KinematicMotion`.
    """
    from bayesnet_track.numerics.compiled import plain
    from bayesnet_track.numerics.density import likeliest_of_each

    (count, own), known = states.shape[:2], before.states.shape[1]
    transition = motion.transition(before.states.reshape(count * known, -1), dt)
    points, log_jacobian = transition.coordinates(states.reshape(count * own, -1))
    components, width = transition.sds.shape[0], points.shape[1]
    log_weights = transition.log_shares[:, None] + before.log[:, None]
    means = np.broadcast_to(
        transition.means.reshape(count, 1, known, width), (count, components, known, width)
    )
    sds = transition.sds.reshape(components, count, known, width).swapaxes(0, 1)
    return likeliest_of_each(
        said + log_jacobian.reshape(count, own),
        np.ascontiguousarray(points).reshape(count, own, width),
        log_weights.reshape(count, -1),
        plain(means).reshape(count, -1, width),
        1.0 / np.ascontiguousarray(sds).reshape(count, -1, width),
    )
