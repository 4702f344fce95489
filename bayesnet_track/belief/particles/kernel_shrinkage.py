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

from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.belief.motion.formulas import FormulaMotion
from bayesnet_track.belief.motion.start_prior import StartPrior


def static_fields(motion: MotionModel) -> tuple[str, ...]:
    """Fields that are uncertain when the target starts and that no motion changes, in any mode."""
    motions = list(formulas_in(motion))
    constants = [part.static(_prior_in(motion)) for part in motions]
    names = dict.fromkeys(name for fields in constants for name in fields)
    return tuple(name for name in names if all(name in fields for fields in constants))


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
    inner_motions = parts if parts is not None else (getattr(motion, "motion", None),)
    for inner in inner_motions:
        if inner is not None:
            yield from formulas_in(inner)
