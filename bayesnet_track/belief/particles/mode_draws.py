"""Modes of hypotheses, drawn so that each mode has some however improbable it is, and weighted for it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.belief.motion.bounds import Confined
from bayesnet_track.belief.motion.jumps import Jumping, modal_of
from bayesnet_track.belief.motion.modal import Modal, draw
from bayesnet_track.belief.particles.particle_set import Inputs
from bayesnet_track.numerics.arrays import Floats

EVENLY = 0.2
"""Share of the hypotheses that draw their mode evenly among those that can follow: weights are at most
1 / (1 - EVENLY)."""


@dataclass(frozen=True, eq=False)
class DrawnModes:
    """Hypotheses that have drawn the modes in which they are about to move.

    Attributes:
        inputs: with them as the belief before, and a motion that draws no modes any more.
        prior_log: (N,) log-weights that make them a sample of the prior.
    """

    inputs: Inputs
    prior_log: Floats


def draw_modes(inputs: Inputs, ancestors: NDArray[np.intp], beta_log: Floats) -> DrawnModes | None:
    """The modes of hypotheses that move from `ancestors`; None for a motion without modes.

    A mode that the chain enters once in a hundred frames would have a few hypotheses, and when it is entered
    the belief would be what those few are. So a mode is drawn from q = (1 - EVENLY) P + EVENLY U, U even
    among those that can follow, and the hypothesis is weighted by P / q.
    """
    modal = modal_of(inputs.motion)
    if modal is None:
        return None
    prior, rng = inputs.prior, inputs.stream("modes")
    states = prior.states[ancestors]
    chain = modal.chain.over(inputs.dt)
    can_follow = chain > 0
    drawn_by = (1.0 - EVENLY) * chain + EVENLY * can_follow / can_follow.sum(axis=1, keepdims=True)
    before, size = states[:, -1].astype(np.intp), len(states)
    modes = draw(drawn_by[before], (rng.permutation(size) + rng.random(size)) / size)
    states[:, -1] = modes
    prior_log = beta_log + np.log(chain[before, modes] / drawn_by[before, modes])
    moved = replace(inputs, prior=replace(prior, states=states), motion=_settle(inputs.motion))
    return DrawnModes(moved, prior_log)


def _settle(motion: MotionModel) -> MotionModel:
    """The motion, drawing no modes."""
    match motion:
        case Modal():
            return replace(motion, settled=True)
        case Confined() | Jumping():
            return replace(motion, motion=_settle(motion.motion))
    return motion
