"""Move the hypotheses of many targets in one call, each by its own random numbers, with the bits as alone."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from bayesnet_track.belief.contract import Ancestors
from bayesnet_track.belief.motion.kinematics import step_rows
from bayesnet_track.belief.motion.models import KinematicMotion
from bayesnet_track.belief.motion.noise import add_noise, noisy
from bayesnet_track.numerics.arrays import Floats


def propagate_rows(
    motion: KinematicMotion,
    states: Floats,
    dt: float,
    streams: Iterable[np.random.Generator],
    parents: Ancestors,
) -> Floats:
    """(T, N, D) states after `dt` frame intervals of the (T, N) `parents` among the states (T, K, D) of each.

    As `motion.propagate(states[t], dt, streams[t], parents[t])` for every target t. Where `draws_twice` holds
    each stream is an object of its own, else the next may take the last one's place.
    """
    from bayesnet_track.numerics.kernels.kinematic_kernels import driven

    count, known, width = states.shape
    if draws_twice(motion):
        streams = list(streams)
    below = (parents + known * np.arange(count)[:, None]).ravel()
    flat = states.reshape(-1, width)
    if motion.diffusion == 0:
        moved = motion.drift(flat.take(below, axis=0), dt)
    else:
        normals = np.empty((count, parents.shape[1], 2 * motion.order))
        for own, stream in zip(normals, streams, strict=True):
            stream.standard_normal(out=own)
        rows = step_rows(motion.dynamics, motion.diffusion, dt)
        moved = driven(flat, below, *rows, normals.reshape(-1, 2 * motion.order))
    moved = moved.reshape(count, -1, width)
    if any(noisy(motion.noise)):
        for own, stream in zip(moved, streams, strict=True):
            add_noise(motion.noise, own[:, :4], stream, dt)
    return moved


def draws_twice(motion: KinematicMotion) -> bool:
    """Whether a target's numbers are drawn in two turns, for the velocities and for the box."""
    return motion.diffusion != 0 and any(noisy(motion.noise))
