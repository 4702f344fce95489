"""Unknown constants beside particles: kernel shrinkage keeps hypotheses about them (Liu and West 2001).

A field that neither drifts nor has noise is only ever resampled: after a few frames all hypotheses share a
few of its first values. So each frame begins with new parents, whose values are drawn towards their mean and
spread anew, with the weighted mean and covariance V of the hypotheses, in each mode on its own, and the
discount d::

    theta_i <- a theta_i + (1 - a) mean + N(0, V / (1 - sum w^2) - a^2 V),  a = (3 d - 1) / (2 d)

The mean is kept. So is the covariance, by its unbiased estimate V / (1 - sum w^2): V itself is too small by a
share of 1 / ESS, and kernels that kept it would narrow in each frame.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from bayesnet_track.belief.contract import MotionModel, Stream
from bayesnet_track.belief.motion.formulas import FormulaMotion
from bayesnet_track.belief.motion.modes import FIELD
from bayesnet_track.belief.motion.start_prior import StartPrior
from bayesnet_track.belief.particles.particle_set import ParticleSet
from bayesnet_track.numerics.gaussian import root, weighted_moments
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.numerics.resampling import systematic

LEAST = 0.1
"""Covariances are enlarged tenfold at most, where one hypothesis has nearly all of the weight."""


def shrink_constants(prior: ParticleSet, motion: MotionModel, stream: Stream) -> ParticleSet:
    """The belief resampled, with its unknown constants spread anew; itself where there is no discount.

    Mean and covariance of the constants are kept, and with them what was learnt. They are spread after new
    parents are drawn, so that the frame's evidence compares as many values as there are hypotheses.
    """
    motions = list(formulas_in(motion))
    discounts = [one.static_discount for one in motions if one.static_discount is not None]
    names = static_fields(motion)
    if not discounts or not names:
        return prior
    kept = (3.0 * min(discounts) - 1.0) / (2.0 * min(discounts))
    columns = np.array([prior.fields.index(name) for name in names])
    weights, size = prior.weights.weights, len(prior)
    parents = systematic(weights, size, stream("constants of parents"))
    states, rng = prior.states[parents], stream("constants")
    has_modes = prior.fields[-1] == FIELD
    modes, before = (one[:, -1] if has_modes else np.zeros(size) for one in (states, prior.states))
    for mode in np.unique(modes):
        chosen, own = np.flatnonzero(modes == mode), weights * (before == mode)
        own = own / own.sum()
        mean, covariance = weighted_moments(prior.states[:, columns], own)
        unbiased = 1.0 / max(1.0 - float(own @ own), LEAST)
        lower = root(covariance * (unbiased - kept**2))
        spread = rng.standard_normal((len(chosen), lower.shape[1])) @ lower.T
        at = np.ix_(chosen, columns)
        states[at] = kept * states[at] + (1.0 - kept) * mean + spread
    return replace(prior, states=states, weights=LogWeights.uniform(size))


def static_fields(motion: MotionModel) -> tuple[str, ...]:
    """Fields that are uncertain when the target starts and that no motion changes, in any mode."""
    motions = list(formulas_in(motion))
    constants = [one.static(_prior_in(motion)) for one in motions]
    names = dict.fromkeys(name for own in constants for name in own)
    return tuple(name for name in names if all(name in own for own in constants))


def _prior_in(motion: object) -> StartPrior | None:
    """The start prior of a motion, confined or not."""
    while motion is not None and getattr(motion, "prior", None) is None:
        motion = getattr(motion, "motion", None)
    return getattr(motion, "prior", None)


def formulas_in(motion: object) -> Iterator[FormulaMotion]:
    """The motions by expressions in a motion: of each mode, confined or not."""
    if isinstance(motion, FormulaMotion):
        yield motion
        return
    parts = getattr(motion, "parts", None)
    inside = parts if parts is not None else (getattr(motion, "motion", None),)
    for one in inside:
        if one is not None:
            yield from formulas_in(one)
