"""Pixels of an input as frames of 8 bits: arrays that are no frames, and levels that are lost."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.observation.image_files import PictureError
from bayesnet_track.observation.settings import setting
from bayesnet_track.sources.entrances.notices import notice

ValueRange = tuple[float, float]
"""The values that become 0 and 255; what lies beyond becomes one of them."""

CHANNELS = (1, 3, 4)
MIDDLE = (0.1, 99.9)
"""Percentiles between which the values lie that a range should cover: a broken pixel is beyond."""


def explain_pixels(image: NDArray[Any], has_frame_shape: bool) -> str:
    """Advice how an array that is no frame can become one; `has_frame_shape` if its shape is that of one.

    >>> explain_pixels(np.zeros((3, 48, 64), np.uint8), False)
    '; its channels stand first, as PyTorch has them: frame.transpose(1, 2, 0), in the order blue, green, red'
    """
    if image.size == 0:
        return "; it holds no pixel: could the image be read?"
    if image.ndim == 4 and image.shape[-1] in CHANNELS:
        return f"; {len(image)} images: give them one by one, frame[0] first"
    if image.ndim == 3 and image.shape[0] in CHANNELS and not has_frame_shape:
        first = "; its channels stand first, as PyTorch has them"
        return f"{first}: frame.transpose(1, 2, 0), in the order blue, green, red"
    if image.ndim == 3 and image.shape[-1] == 2:
        return "; two channels: frame[..., 0] is the first one, gray where the second is alpha"
    if not has_frame_shape and image.ndim in (2, 3):
        return "; frame[..., [2, 1, 0]] takes three channels, blue, green and red, of several"
    if image.dtype.kind == "b":
        return "; a mask of True and False: frame.astype(numpy.uint8) * 255"
    if image.dtype.kind not in "fiu":
        return "; frame.astype(numpy.uint8) makes 8 bits of numbers from 0 to 255"
    low, high = middle_of(image)
    is_small = image.min() >= 0 and (1 if image.dtype.kind == "f" else 0) <= image.max() <= 255
    alternative = ", or, where 0 to 255 are black to white, frame.astype(numpy.uint8)" if is_small else ""
    if image.dtype.kind == "f" and low >= 0 and high <= 1:
        low, high = 0.0, 1.0
    return f"; values of another type need a range: {flag_of((low, high))}{alternative}"


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
    """Range of all finite values, or of nearly all where a few are far away."""
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return 0.0, 1.0
    low, high = (float(v) for v in np.percentile(finite, MIDDLE))
    lowest, highest = float(finite.min()), float(finite.max())
    if low == high or highest - lowest <= 2.0 * (high - low):
        low, high = lowest, highest
    return low, high if high > low else low + 1.0


def flag_of(value_range: Sequence[float]) -> str:
    """Option that gives a range."""
    low, high = (_number_text(value) for value in value_range)
    return setting("--range", f"{low},{high}", f"({low}, {high})")


def _number_text(value: Any) -> str:
    """A number in words, six digits of it."""
    return f"{float(value):.6g}"


__all__ = ["Levels", "ValueRange", "explain_loss", "to_bgr", "value_range_of"]

ROWS_AT_ONCE = 256
FEW_LEVELS = 64
MOST_CLIPPED = 0.5


def value_range_of(bounds: object) -> ValueRange | None:
    """A range as it is given: None, or two finite numbers, the lower one first.

    Raises:
        ValueError: it is something else.
    """
    if bounds is None:
        return None
    try:
        low, high = (float(value) for value in bounds)  # type: ignore[attr-defined]
    except (TypeError, ValueError):
        low, high = math.nan, math.nan
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise ValueError(
            f"value range {bounds!r}: two finite numbers are needed, the value that becomes black and the "
            "higher one that becomes white, such as 8000, 8063"
        )
    return low, high


def to_bgr(image: NDArray[Any], value_range: ValueRange | None = None) -> tuple[NDArray[np.uint8], bool]:
    """Any image as ((H, W, 3) uint8 BGR, has_color).

    - By a range LOW, HIGH: ``round(255 * (value - LOW) / (HIGH - LOW))``, kept within 0..255; NaN becomes 0.
    - Without one, 16 bit to 8: ``round(value / 257)``, so that 0 stays 0 and 65535 becomes 255.
    - Gray (H, W) or (H, W, 1): three equal channels, has_color False.
    - Alpha (H, W, 4): laid over black, ``round(value * alpha / 255)``, since the colour below a transparent
      pixel is arbitrary.

    Raises:
        PictureError: values of another type, another number of channels, or no pixel.
    """
    channels = image.shape[-1] if image.ndim == 3 else 1
    deep = image.dtype.kind in "fiu" if value_range is not None else image.dtype == np.uint16
    has_frame_shape = image.ndim in (2, 3) and channels in (1, 3, 4)
    if channels == 4 and image.dtype not in (np.uint8, np.uint16):
        has_frame_shape = False
    if not ((image.dtype == np.uint8 or deep) and has_frame_shape) or image.size == 0:
        raise PictureError(
            f"{image.dtype} values of shape {image.shape}; allowed: 8 or 16 bit, 1, 3 or 4 channels"
            + explain_pixels(image, has_frame_shape)
        )
    if image.dtype == np.uint8 and channels == 3 and value_range is None:
        return np.ascontiguousarray(image), True
    bgr = np.empty((*image.shape[:2], 3), np.uint8)
    for top in range(0, len(bgr), ROWS_AT_ONCE):  # the steps between need several times its memory
        rows = slice(top, top + ROWS_AT_ONCE)
        bgr[rows] = _to_bgr(image[rows].reshape(-1, image.shape[1], channels), value_range)
    return bgr, channels != 1


def _to_bgr(rows: NDArray[Any], value_range: ValueRange | None) -> NDArray[np.uint8]:
    alpha = _eight_bits(rows[..., 3:], None).astype(np.uint16) if rows.shape[2] == 4 else None
    rows = _eight_bits(rows[..., :3], value_range)
    if alpha is not None:
        rows = ((rows * alpha + 127) // 255).astype(np.uint8)
    return rows


def _eight_bits(values: NDArray[Any], value_range: ValueRange | None) -> NDArray[np.uint8]:
    if value_range is not None:
        low, high = value_range
        shares = (np.nan_to_num(values.astype(np.float64), nan=low) - low) / (high - low)
        return np.asarray(np.rint(np.clip(shares, 0.0, 1.0) * 255.0), np.uint8)
    if values.dtype == np.uint16:
        return np.asarray((values.astype(np.uint32) + 128) // 257, np.uint8)
    return np.asarray(values, np.uint8)


class Levels:
    """Makes 8 bits of the images of a source by one range, and says once what is lost in the first of them.

    Attributes:
        value_range: the range; None for all that the type of the values holds.
    """

    def __init__(self, name: str, value_range: ValueRange | None = None) -> None:
        self.value_range, self._name, self._is_said = value_range, name, False
        self._unsaid = [explain_alpha, explain_not_finite]
        self._dtype: np.dtype[Any] | None = None

    @property
    def dtype(self) -> str | None:
        """Type of the values of the first image; None before it."""
        return None if self._dtype is None else self._dtype.str

    def go_on(self, dtype: str | None) -> None:
        """Go on after a first image of this type, of which all was said; before it with None."""
        if dtype is not None:
            self._dtype, self._is_said, self._unsaid = np.dtype(dtype), True, []

    def __call__(self, image: NDArray[Any]) -> tuple[NDArray[np.uint8], bool]:
        """Convert as `to_bgr`; a range holds for values of one type. Raises PictureError.

        Once it is said where pixels are transparent, and where values are not finite.
        """
        if isinstance(image, np.ma.MaskedArray):
            if np.ma.is_masked(image):
                raise PictureError(
                    f"a masked array, {np.ma.getmaskarray(image).sum()} of {image.size} values masked; give "
                    "the values that are to stand there: frame.filled(0)"
                )
            image = image.data
        self._dtype = image.dtype if self._dtype is None else self._dtype
        if self.value_range is not None and image.dtype != self._dtype:
            raise PictureError(f"{image.dtype} values, and a range that counts those of {self._dtype}")
        converted = to_bgr(image, self.value_range)
        if converted[0] is image:  # the usual case: nothing is lost
            self._is_said = True
            return converted
        self.look(image, converted[0])
        for explain in tuple(self._unsaid):
            reason = explain(image)
            if reason is not None:
                self._unsaid.remove(explain)
                notice(f"{self._name}: {reason}")
        return converted

    def look(self, original: NDArray[Any], converted: NDArray[np.uint8]) -> None:
        """Say what the first image lost; the values before may be of one channel of several."""
        if self._is_said:
            return
        self._is_said = True
        reason = explain_loss(original, converted, self.value_range)
        if reason is not None:
            notice(f"{self._name}: {reason}")


def explain_loss(
    original: NDArray[Any], converted: NDArray[np.uint8], value_range: ValueRange | None = None
) -> str | None:
    """A sentence on the gray levels that are lost where values become 8 bits; None where they are not.

    >>> print(explain_loss(np.arange(8000, 8064, dtype=np.uint16), np.full(64, 31, np.uint8)).split(";")[0])
    the values of the first frame lie in 8000..8063, 64 levels, of which 1 is left in 8 bits
    """
    if original.dtype == np.uint8 and value_range is None:
        return None
    colors = original[..., :3] if original.ndim == 3 else original
    finite = colors[np.isfinite(colors)] if colors.dtype.kind == "f" else colors
    if finite.size == 0:
        return "no value of the first frame is a finite number"
    extent = f"{_number_text(finite.min())}..{_number_text(finite.max())}"
    if value_range is not None:
        clipped = float(np.mean((finite < value_range[0]) | (finite > value_range[1])))
        if clipped > MOST_CLIPPED:
            return (
                f"{100 * clipped:.0f} % of the values of the first frame lie outside of the range "
                f"{_number_text(value_range[0])}..{_number_text(value_range[1])} and become black or white: "
                f"they lie in {extent}"
            )
    levels, remaining = len(np.unique(finite)), len(np.unique(converted))
    if remaining > FEW_LEVELS or levels < 2 * remaining or levels == 1:
        return None
    return (
        f"the values of the first frame lie in {extent}, {levels} levels, of which {remaining} "
        f"{'is' if remaining == 1 else 'are'} left in 8 bits; give the range that counts: "
        f"{flag_of(middle_of(finite))}"
    )
