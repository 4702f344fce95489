"""What most cues do with a distance: a likelihood, a penalty for another size, a floor, a blended reference.

How a cue sharpens itself is in `bayesnet_track.numerics.log_weights`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats

Reference = Mapping[str, NDArray[Any]]
"""What a cue remembers of its target, as arrays by name, so that it can be stored and compared."""

FLOOR = 0.02
"""Likelihood of an outlier as a share of the best possible one, where nothing else is said."""

SD_LOG_AREA, SD_LOG_ASPECT = 0.5, 0.4
"""Standard deviations of the logs of area ratio and aspect ratio, where nothing else is said."""

LOG_LOGISTIC_AT_ZERO = np.logaddexp(0.0, -4.0)


def floored(log_likelihood: Floats, floor: float = FLOOR) -> Floats:
    """log(floor + (1 - floor) L), at most 0: a mixture with an outlier of likelihood `floor`.

    >>> floored(np.array([0.0, -np.inf]), 0.5).round(3).tolist()
    [0.0, -0.693]
    """
    # Nothing overflows, so that np.logaddexp is not needed, which takes three times as long.
    mixed = np.log(floor + (1.0 - floor) * np.exp(log_likelihood))
    return np.asarray(np.minimum(mixed, 0.0))  # rounding may exceed a perfect 0


def log_logistic(distances: Floats, halved_at: float) -> Floats:
    """(N,) log-likelihood that falls with a distance as a logistic function, 0 at distance 0.

    -log(1 + exp(4 (d - a) / a)), divided by its value 1 / (1 + e^-4) at distance 0: thesis eq. 3.3,
    corrected. At the distance a = `halved_at` the likelihood is about half of the best.

    >>> np.exp(log_logistic(np.array([0.0, 0.2, 1.0]), 0.2)).round(3).tolist()
    [1.0, 0.509, 0.0]
    """
    return np.asarray(LOG_LOGISTIC_AT_ZERO - np.logaddexp(0.0, 4.0 * (distances - halved_at) / halved_at))


def log_size_penalty(
    boxes: Floats,
    reference_size: Floats,
    sd_log_area: float = SD_LOG_AREA,
    sd_log_aspect: float = SD_LOG_ASPECT,
) -> Floats:
    """(N,) Gaussian penalty in the logs of the area ratio and of the aspect ratio (0 when they agree).

    Thesis 3.1.1 names a Gaussian in area and aspect ratio; here in their logarithms, so that half and twice
    the size cost the same. `boxes` are centre boxes (N, 4), `reference_size` (2,) width and height in pixels.
    """
    width = np.log(boxes[:, 2] / reference_size[0])
    height = np.log(boxes[:, 3] / reference_size[1])
    return np.asarray(
        -0.5 * (((width + height) / sd_log_area) ** 2 + ((width - height) / sd_log_aspect) ** 2)
    )


def blend_arrays(old: Reference, new: Reference, rate: float) -> dict[str, NDArray[Any]]:
    """Name by name ``rate * new + (1 - rate) * old`` (eq. 2.15): the `blend` of a cue without one."""
    return {name: np.asarray(rate * new[name] + (1.0 - rate) * old[name]) for name in old}


def blend_sizes(old: Reference, new: Reference, rate: float | Floats) -> Floats:
    """The array ``size`` of two references blended in its logarithm: half and twice are equally far."""
    return np.asarray(old["size"] * (new["size"] / old["size"]) ** rate)
