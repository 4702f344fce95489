"""A correlation filter: learnt in the Fourier domain, answering over whole patches.

The filter w minimises the ridge regression |sum_c w_c * x_c - y|^2 + ridge |w|^2 over all cyclic shifts of
the windowed features x of the target's patch, y a narrow Gaussian (Danelljan et al. 2014; Henriques et al.
2015): W = X conj(Y) / (sum |X|^2 + ridge), numerator and denominator of which can be blended. Shifts of the
target by whole cells are never learnt from the picture, they come for nothing.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats, Singles
from bayesnet_track.observation.shared import for_reading

Spectra = NDArray[np.complex64]


@lru_cache(maxsize=8)
def hann(side: int, width: float, height: float) -> Singles:
    """(side, side) window: cos^2 over `width` and `height` cells in the middle, 0 beyond."""
    place = np.arange(side) - 0.5 * (side - 1)

    def line(span: float) -> Floats:
        within = min(span, float(side))
        return np.where(np.abs(place) < within / 2, np.cos(np.pi * place / within) ** 2, 0.0)

    window = np.outer(line(height), line(width)).astype(np.float32)
    window.setflags(write=False)  # shared by all who ask for it
    return window


def gaussian_label(side: int, sd: float, x: float = 0.0, y: float = 0.0) -> Floats:
    """(side, side) wanted answers to cyclic shifts: a Gaussian of `sd` cells, 1 at column `x` and row `y`."""

    def line(centre: float) -> Floats:
        shift = np.arange(side) - centre
        shift -= side * np.round(shift / side)
        return np.asarray(np.exp(-0.5 * (shift / sd) ** 2))

    return np.outer(line(y), line(x))


def equations(sample: Singles, label: Floats) -> tuple[Spectra, Floats]:
    """Numerator (C, S, S / 2 + 1) and denominator (S, S / 2 + 1) of windowed features (C, S, S)."""
    x = _spectrum(sample).astype(np.complex64)
    numerator = (x * np.conj(_spectrum(label))).astype(np.complex64)
    return numerator, np.sum(x.real**2 + x.imag**2, axis=0, dtype=np.float64)


def _spectrum(values: NDArray[np.floating[Any]]) -> NDArray[np.complexfloating[Any, Any]]:
    """`rfft2` of (..., S, S), which spends as long on its arguments."""
    return np.fft.fft(np.fft.rfft(values), axis=-2)


def solve(numerator: Spectra, denominator: Floats, ridge: float) -> Singles:
    """(C, S, S) the filter; `ridge` is relative to the mean of the denominator."""
    side = numerator.shape[1]
    whole = denominator + max(ridge * float(denominator.mean()), 1e-9)
    quotient = numerator / whole.astype(np.float32)
    return np.fft.irfft(np.fft.ifft(quotient, axis=-2), side).astype(np.float32)


def tile_spectra(patch: Singles, side: int) -> Singles:
    """(H, C, 4, H) the Fourier transform of (C, F, F), H = F / 2 + 1, for filters of `side` cells.

    Phases are counted from the middle of a filter in the first cells, as `scaled_answers` wants them; parts
    are laid out as `centre_spectra` says.
    """
    import cv2

    from bayesnet_track.vision.kernels.correlation_kernels import centre_spectra

    channels, around = patch.shape[:2]
    rows, every = around // 2 + 1, np.empty(patch.shape, np.float32)
    for one, packed in zip(patch, every, strict=True):
        cv2.dft(one, packed)
    seen = np.empty((rows, channels, 4, rows), np.float32)
    centre_spectra(every, _turns(side, around), seen)
    return seen


def halves(kernel: Singles) -> Singles:
    """(2, 2, S / 2, C, S / 2) even and odd part of a filter (C, S, S) by column and row about its middle."""
    from bayesnet_track.vision.kernels.correlation_kernels import fill_halves

    channels, side = kernel.shape[:2]
    parts = np.empty((2, 2, side // 2, channels, side // 2), np.float32)
    fill_halves(for_reading(kernel), parts)
    return parts


def scaled_answers(seen: Singles, parts: Singles, scale: float) -> Singles:
    """(V, V) answers of a filter of S cells, enlarged by `scale`, to a patch of F cells; V = F - S + 1.

    The patch is given by its `tile_spectra`, the filter by its `halves`. The answer at [j, i] is that to the
    target's middle at column i and row j + (S - 1) / 2 of the cells.
    """
    import cv2

    from bayesnet_track.vision.kernels.correlation_kernels import conjugate_product

    side, around = 2 * parts.shape[2], 2 * len(seen) - 2
    total = np.empty((around, around), np.float32)
    conjugate_product(seen, spectral_halves(parts, around, scale), total)
    back = cv2.dft(total, flags=cv2.DFT_INVERSE | cv2.DFT_SCALE)
    return np.asarray(back[: around - side + 1, : around - side + 1], np.float32)


def spectral_halves(parts: Singles, around: int, scale: float) -> Singles:
    """(2, 2, H, C, H) the `halves` of a filter enlarged by `scale` and transformed, H = `around` / 2 + 1.

    Resizing and transforming a filter are both linear and both symmetric about its middle. Thus they are
    products of small matrices by column and by row (`waves`), and no image is resized or transformed.
    """
    half, channels, rows = parts.shape[2], parts.shape[3], around // 2 + 1
    added = waves(2 * half, around, scale)
    across = (parts.reshape(2, -1, half) @ added).reshape(2, 2, half, channels * rows)
    return np.asarray((added.transpose(0, 2, 1) @ across).reshape(2, 2, rows, channels, rows))


@lru_cache(maxsize=128)
def waves(side: int, around: int, scale: float) -> Singles:
    """(2, S / 2, H) what a cell of the even part adds to each frequency's cosine, of the odd to its sine.

    The filter of `side` cells is enlarged about its middle, bicubic, into a square of `around` cells with
    nothing beyond its own; divided by the scale by row and by column, so that a smooth filter's sum stays.
    """
    middle, cells = 0.5 * (side - 1), np.arange(side)
    resize = _resizing(side, scale)
    angles = 2.0 * np.pi / around * np.outer(np.arange(around // 2 + 1), cells - middle)
    half = side // 2
    parts = [(turn(angles) @ resize)[:, :half].T for turn in (np.cos, np.sin)]
    added = np.array(parts, np.float32)
    added.setflags(write=False)  # shared by all who ask for it
    return added


def _resizing(side: int, scale: float) -> Floats:
    """(side, side) weights of the source's cells in each cell enlarged: Catmull and Rom's cubic."""
    middle, cells = 0.5 * (side - 1), np.arange(side)
    place = (cells - middle) / scale + middle
    below = np.floor(place).astype(np.int64)
    t = place - below
    taps = (
        ((-0.5 * t + 1.0) * t - 0.5) * t,
        (1.5 * t - 2.5) * t * t + 1.0,
        ((-1.5 * t + 2.0) * t + 0.5) * t,
        (0.5 * t - 0.5) * t * t,
    )
    weights = np.zeros((side, side + 4))  # two more on either side, which are nothing
    for a, tap in enumerate(taps):
        source = np.clip(below - 1 + a, -2, side + 1)
        weights[cells, source + 2] += tap / scale
    return weights[:, 2:-2]


@lru_cache(maxsize=8)
def _turns(side: int, around: int) -> Singles:
    """(H, 2, 2, H) cosine and sine by which frequencies (j, k) and (-j, k) turn about the filter's middle."""
    steps = np.arange(around // 2 + 1)
    angles = np.pi * (side - 1) / around * np.stack([np.add.outer(steps, steps), steps - steps[:, None]], 1)
    turns = np.stack([np.cos(angles), np.sin(angles)], 2).astype(np.float32)
    turns.setflags(write=False)
    return turns
