"""How much the measurements of one target vary, as factors on the standard deviations of all targets.

Targets differ by far more than one standard deviation can hold: the flow of a rigid car changes by 0.1 px
from frame to frame, that of a runner by 5 px. A cue that remembers how much its own target varied needs only
a standard deviation to start with.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from bayesnet_track.numerics.arrays import Array, Floats

SPREAD = "spread"
"""Name, in a reference, of the factors (k,) on the cue's k standard deviations."""

BOUNDS = (0.1, 30.0)
"""Least and largest factor: a rendered target does not vary at all, and a wrong match by any amount."""

MEAN_DEVIATION = float(np.sqrt(2.0 / np.pi))
"""Mean absolute deviation of a Gaussian, in standard deviations."""


def spread_of(reference: Mapping[str, Array], count: int) -> Floats:
    """The factors (count,); 1 in a reference without them."""
    return np.asarray(reference.get(SPREAD, np.ones(count)), dtype=np.float64)


def start(count: int, frames: float | None) -> dict[str, Array]:
    """`SPREAD` alone, of a target of which nothing is known yet; nothing where sds do not follow."""
    return {} if frames is None else {SPREAD: np.ones(count)}


def follow(
    reference: Mapping[str, Array], errors: Sequence[Floats], sds: Sequence[float], frames: float | None
) -> dict[str, Array]:
    """`SPREAD` alone, moved toward what the errors (n,) of each standard deviation say, over so many frames.

    Each factor is the mean absolute error of the last frames over that of a Gaussian with the standard
    deviation. One without errors in this frame stays. Nothing where sds do not follow (`frames` is None).

    >>> follow({}, [np.array([-4.0, 4.0]), np.empty(0)], [1.0, 1.0], 5.0)["spread"].round(3).tolist()
    [1.727, 1.0]
    """
    if frames is None:
        return {}
    factors, share = spread_of(reference, len(sds)).copy(), -np.expm1(-1.0 / frames)
    for k, (found, sd) in enumerate(zip(errors, sds, strict=True)):
        if len(found):
            factors[k] += share * (np.abs(found).mean() / (MEAN_DEVIATION * sd) - factors[k])
    return {SPREAD: np.clip(factors, *BOUNDS)}
