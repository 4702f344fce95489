"""Arrays that are no frames as they stand, transparent pixels, and values that are not finite, in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.observation.settings import setting

ValueRange = tuple[float, float]
"""The values that become 0 and 255; what lies beyond becomes one of them."""

CHANNELS = (1, 3, 4)
MIDDLE = (0.1, 99.9)
"""Percentiles between which the values lie that a range should cover: a broken pixel is beyond."""


def explain_pixels(image: NDArray[Any], known: bool) -> str:
    """How an array that is no frame can become one; `known` if its shape is that of a frame.

    >>> explain_pixels(np.zeros((3, 48, 64), np.uint8), False)
    '; its channels stand first, as PyTorch has them: frame.transpose(1, 2, 0), in the order blue, green, red'
    """
    if image.size == 0:
        return "; it holds no pixel: could the image be read?"
    if image.ndim == 4 and image.shape[-1] in CHANNELS:
        return f"; {len(image)} images: give them one by one, frame[0] first"
    if image.ndim == 3 and image.shape[0] in CHANNELS and not known:
        first = "; its channels stand first, as PyTorch has them"
        return f"{first}: frame.transpose(1, 2, 0), in the order blue, green, red"
    if image.ndim == 3 and image.shape[-1] == 2:
        return "; two channels: frame[..., 0] is the first one, gray where the second is alpha"
    if not known and image.ndim in (2, 3):
        return "; frame[..., [2, 1, 0]] takes three channels, blue, green and red, of several"
    if image.dtype.kind == "b":
        return "; a mask of True and False: frame.astype(numpy.uint8) * 255"
    if image.dtype.kind not in "fiu":
        return "; frame.astype(numpy.uint8) makes 8 bits of numbers from 0 to 255"
    low, high = middle_of(image)
    is_small = image.dtype.kind in "iu" and image.min() >= 0 and image.max() <= 255
    other = ", or, where 0 to 255 are black to white, frame.astype(numpy.uint8)" if is_small else ""
    if image.dtype.kind == "f" and low >= 0 and high <= 1:
        low, high = 0.0, 1.0
    return f"; values of another type need a range: {flag_of((low, high))}{other}"


def explain_alpha(image: NDArray[Any]) -> str | None:
    """A sentence where pixels are transparent, and what becomes of them; None where none is."""
    if image.ndim != 3 or image.shape[2] != 4:
        return None
    full = 65535 if image.dtype == np.uint16 else 255
    clear = int((image[..., 3] < full - full // 256).sum())  # 10 bits of video are 65472 of 65535 at most
    if not clear:
        return None
    pixels = image.shape[0] * image.shape[1]
    return (
        f"{clear} of {pixels} pixels of a frame are transparent (alpha below {full}): the frame is laid over "
        "black"
    )


def explain_not_finite(image: NDArray[Any]) -> str | None:
    """A sentence where values are not finite, and what becomes of them; None where all are."""
    if image.dtype.kind != "f":
        return None
    wrong = ~np.isfinite(image)
    count = int(wrong.sum())
    if not count:
        return None
    nan = int(np.isnan(image).sum())
    return (
        f"{count} of {image.size} values of a frame are not finite ({nan} NaN): NaN and -inf become black, "
        "inf white"
    )


def middle_of(values: NDArray[Any]) -> ValueRange:
    """Where all finite values lie, or nearly all where a few are far away."""
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return 0.0, 1.0
    low, high = (float(v) for v in np.percentile(finite, MIDDLE))
    least, most = float(finite.min()), float(finite.max())
    if low == high or most - least <= 2.0 * (high - low):
        low, high = least, most
    return low, high if high > low else low + 1.0


def flag_of(value_range: Sequence[float]) -> str:
    """How a range is given."""
    low, high = (text_of(value) for value in value_range)
    return setting("--range", f"{low},{high}", f"({low}, {high})")


def text_of(value: Any) -> str:
    """A number in words, six digits of it."""
    return f"{float(value):.6g}"
