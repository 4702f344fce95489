"""Local action of cues: how much sharper a likelihood is than as learnt, and how that is taken back.

A cue that is uncertain of itself multiplies a width or an exponent by its step. The product of all steps
stands in its reference, so that it is bounded over all episodes of uncertainty, not only within one.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bayesnet_track.numerics.arrays import Array, Floats

SHARPER = "sharper"
"""Name, in a reference, of the factor () on the cue's width or exponent; 1 as learnt."""

STEPS = 3
"""How many steps a cue goes, in one episode of uncertainty and in all."""

MOST_BACK = 0.05
"""Largest share of the way back to 1 that a cue goes in one frame: the default of `learn.rate_max`.

References learn only while the belief is certain, so it is learning that takes the factor back. Flow and
depth are learnt so fast that it would be gone within a frame.
"""


def factor_of(reference: Mapping[str, Array]) -> float:
    """The factor on the width or exponent; 1 in a reference that was stored before there was one."""
    return float(reference.get(SHARPER, 1.0))


def sharpen(reference: Mapping[str, Array], attempt: int, step: float) -> dict[str, Array] | None:
    """The reference one step sharper, at most `STEPS` steps from 1; None when nothing is left to try.

    `attempt` counts from 1 within an episode; `step` is below 1 for a width, above 1 for an exponent.

    >>> reference = {"sharper": np.array(1.0)}
    >>> for attempt in (1, 2, 3):
    ...     reference = sharpen(reference, attempt, 0.5)
    >>> factor_of(reference), sharpen(reference, 1, 0.5)
    (0.125, None)
    """
    factor, most = factor_of(reference), step**STEPS
    if attempt > STEPS or np.isclose(factor, most):
        return None
    bound = max if step < 1.0 else min
    return {**reference, SHARPER: np.array(bound(factor * step, most))}


def relax(old: Mapping[str, Array], new: Mapping[str, Array], rate: float) -> dict[str, Array]:
    """`SHARPER` alone, moved from `old` toward `new` by `rate`, but by `MOST_BACK` at most.

    >>> old, new = {"sharper": np.array(0.5)}, {"sharper": np.array(1.0)}
    >>> [round(factor_of(relax(old, new, rate)), 4) for rate in (0.0, 0.02, 0.3)]
    [0.5, 0.51, 0.525]
    """
    return {SHARPER: relax_all(np.asarray(factor_of(old)), np.asarray(factor_of(new)), np.asarray(rate))}


def relax_all(old: Floats, new: Floats, rates: Floats) -> Floats:
    """Factors moved from `old` toward `new` in the same way, those of several targets at once."""
    shares = np.minimum(rates, MOST_BACK)
    return np.asarray((1.0 - shares) * old + shares * new)
