"""Compiled kernels for colours of pixels: hue, in the integers of OpenCV's ``COLOR_BGR2HSV_FULL``; cells."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.compiled import compiled

ACHROMATIC = -1

_SHIFT = 12
_CHROMA = np.maximum(np.arange(256), 1)
_SIXTHS = np.rint((256 << _SHIFT) / (6.0 * _CHROMA)).astype(np.int64)


def hue_of_bgr(image: NDArray[np.uint8], min_chroma: int) -> NDArray[np.int16]:
    """Hexcone hue of each pixel in 1/256 of a circle (thesis eq. 3.1, corrected: 60 degrees on every branch).

    Computed here rather than by OpenCV so that the bits do not depend on its version, and so that chroma
    need not be recovered from a rounded saturation.

    Args:
        image: (H, W, 3) BGR.
        min_chroma: pixels whose largest and smallest channel differ by less are `ACHROMATIC`; at least 1.

    Returns:
        (H, W) int16, 0..255 or `ACHROMATIC`.
    """
    hue: NDArray[np.int16] = np.empty(image.shape[:2], np.int16)
    _hue(np.ascontiguousarray(image), min_chroma, _SIXTHS, hue)
    return hue


@compiled
def _hue(
    image: NDArray[np.uint8], min_chroma: int, sixths: NDArray[np.int64], hue: NDArray[np.int16]
) -> None:
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            b, g, r = np.int64(image[y, x, 0]), np.int64(image[y, x, 1]), np.int64(image[y, x, 2])
            top = max(b, g, r)
            chroma = top - min(b, g, r)
            if chroma < min_chroma:
                hue[y, x] = -1
                continue
            if top == r:
                turn = g - b
            elif top == g:
                turn = b - r + 2 * chroma
            else:
                turn = r - g + 4 * chroma
            hue[y, x] = ((turn * sixths[chroma] + 2048) >> 12) & 255


@compiled
def bins_of_hue(hue: NDArray[np.int16], bin_of_hue: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The entry of `bin_of_hue` (257,) for each hue, the last for `ACHROMATIC`."""
    bins = np.empty(hue.shape, np.uint8)
    for y in range(hue.shape[0]):
        for x in range(hue.shape[1]):
            own = hue[y, x]
            bins[y, x] = bin_of_hue[own if own >= 0 else 256]
    return bins


@compiled
def fill_cells(line: NDArray[np.uint8], layout: NDArray[np.uint16], cells: NDArray[np.uint16]) -> None:
    """Write the cell of each pixel of `line` (3 W,) into `cells` (W,).

    Args:
        line: three channels of each pixel.
        layout: (2, 3) of each channel how many levels it has, at most 256, and what one of them adds to the
            number of a cell, which is at most 65535.
        cells: filled.
    """
    one, two, three = layout[0, 0], layout[0, 1], layout[0, 2]
    first, second, third = layout[1, 0], layout[1, 1], layout[1, 2]
    half = np.uint16(8)
    for x in range(len(cells)):  # whole numbers of 16 bits: four times as many at once as of 64
        a = np.uint16(np.uint16(np.uint16(line[3 * x]) * one) >> half) * first
        b = np.uint16(np.uint16(np.uint16(line[3 * x + 1]) * two) >> half) * second
        c = np.uint16(np.uint16(np.uint16(line[3 * x + 2]) * three) >> half) * third
        cells[x] = np.uint16(a) + np.uint16(b) + np.uint16(c)


@compiled
def fill_color_cells(image: NDArray[np.uint8], layout: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """(H, W) cell of each pixel of an (H, W, 3) image; `layout` as of `fill_cells`."""
    height, width = image.shape[0], image.shape[1]
    cells = np.empty((height, width), np.uint16)
    for y in range(height):
        fill_cells(image[y].reshape(3 * width), layout, cells[y])
    return cells
