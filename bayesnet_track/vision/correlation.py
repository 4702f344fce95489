"""A correlation filter: learnt in the Fourier domain, answering over whole patches.

The filter w minimises the ridge regression |sum_c w_c * x_c - y|^2 + ridge |w|^2 over all cyclic shifts of
the windowed features x of the target's patch, y a narrow Gaussian (Danelljan et al. 2014; Henriques et al.
2015): W = X conj(Y) / (sum |X|^2 + ridge), numerator and denominator of which can be blended. Shifts of the
target by whole cells are never learnt from the picture, they come for nothing.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats, Singles

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
    x = np.fft.rfft2(sample).astype(np.complex64)
    numerator = (x * np.conj(np.fft.rfft2(label))).astype(np.complex64)
    return numerator, np.sum(x.real**2 + x.imag**2, axis=0, dtype=np.float64)


def solve(numerator: Spectra, denominator: Floats, ridge: float) -> Singles:
    """(C, S, S) the filter; `ridge` is relative to the mean of the denominator."""
    side = numerator.shape[1]
    whole = denominator + max(ridge * float(denominator.mean()), 1e-9)
    quotient = numerator / whole.astype(np.float32)
    return np.fft.irfft2(quotient, s=(side, side)).astype(np.float32)


def spectra(patch: Singles) -> list[Singles]:
    """The Fourier transform of each channel (F, F), packed as OpenCV does.

    An array each: small ones are memory that was just in use, one large one is new from the system each time.
    """
    import cv2

    return [np.asarray(cv2.dft(one), np.float32) for one in patch]


def scaled_spectra(kernel: Singles, scale: float, around: int) -> list[Singles]:
    """`spectra` of a filter (C, S, S) enlarged by `scale`, in a square of `around` cells."""
    from bayesnet_track.vision.kernels.correlation_kernels import resized_filter

    grown = np.empty((len(kernel), around, around), np.float32)
    resized_filter(kernel, scale, grown)
    return spectra(grown)


def answers(patch: list[Singles], kernel: list[Singles], side: int) -> Singles:
    """(V, V) answers of a filter of `side` cells to a patch of F, both as spectra; V = F - side + 1.

    The answer at [j, i] is that to the target's middle at column i and row j + (side - 1) / 2 of the cells.
    """
    import cv2

    from bayesnet_track.vision.kernels.correlation_kernels import add_product

    total = np.zeros_like(patch[0])
    for one, other in zip(patch, kernel, strict=True):
        add_product(one, other, total)
    valid = len(total) - side + 1
    back = cv2.dft(total, flags=cv2.DFT_INVERSE | cv2.DFT_SCALE)
    return np.asarray(back[:valid, :valid], np.float32)
