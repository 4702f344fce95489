"""Square patches of a frame as cells of oriented gradients, brightness and colour."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesnet_track.numerics.arrays import Bytes, Singles

ORIENTATIONS = 8
"""Orientations of the full circle."""
UNSIGNED_CHANNELS = ORIENTATIONS // 2 + 3
"""Gradients without their sign, brightness, two differences of colours."""
CHANNELS = ORIENTATIONS + UNSIGNED_CHANNELS
"""The same after gradients with their sign, which tell light to dark from dark to light."""
NOISE = 400.0
"""Energy of gradients, gray levels^2, below which a place counts as flat."""


_MIXES = np.array(
    [
        [0.114 / 255, 0.587 / 255, 0.299 / 255, -0.5],
        [1.5 / 255, -1.5 / 255, 0, 0],
        [0, -1.5 / 255, 1.5 / 255, 0],
    ],
    np.float32,
)
"""Brightness about its middle, blue and red against green: of blue, green, red and 1."""


@dataclass(frozen=True, eq=False)
class Patch:
    """A square crop of a frame in cells.

    Attributes:
        x: column of its centre, frame px; likewise `y`.
        cell: side of a cell, frame px.
        features: (C, cells, cells) float32, C = `CHANNELS` or `UNSIGNED_CHANNELS`.
    """

    x: float
    y: float
    cell: float
    features: Singles


def patch_at(image: Bytes, x: float, y: float, cell: float, cells: int, signed: bool = True) -> Patch:
    """The patch of `cells` x `cells` cells of about `cell` px around (x, y) of an (H, W, 3) BGR image.

    With gradients that have their sign too if `signed`.

    Whole pixels are cut out: centre and cell are the nearest to what is asked for that this allows. Beyond
    the image its border is repeated.
    """
    import cv2

    from bayesnet_track.vision.kernels.gradient_kernels import CELL

    around = cells + 2  # a rim for the energy around a cell
    size = CELL * around
    side = max(round(cell * around), 2)
    times = max(side // size, 1)
    side -= side % times
    left, top = round(x - (side - 1) / 2), round(y - (side - 1) / 2)
    crop = _cut_shrunk(image, left, top, side // times, times)
    resized = np.asarray(cv2.resize(crop, (size, size), interpolation=cv2.INTER_LINEAR), np.uint8)
    return Patch(
        left + (side - 1) / 2, top + (side - 1) / 2, side / around, _features(resized, cells, signed)
    )


def turned_patch_at(
    image: Bytes, x: float, y: float, cell: float, cells: int, signed: bool, angle: float
) -> Patch:
    """As `patch_at`, of a square that is turned by `angle` degrees, clockwise: it shows what was upright."""
    import cv2

    from bayesnet_track.vision.kernels.gradient_kernels import CELL

    size = CELL * (cells + 2)
    scale = cell / CELL  # px per pixel of the patch
    times = max(int(scale), 1)
    side = -(-int(np.ceil(1.5 * scale * size)) // times) * times  # a square that holds the turned one
    left, top = round(x - (side - 1) / 2), round(y - (side - 1) / 2)
    crop = _cut_shrunk(image, left, top, side // times, times)
    turn = scale / times * np.array([[_cos(angle), -_sin(angle)], [_sin(angle), _cos(angle)]])
    middle = (np.array([x - left, y - top]) - (times - 1) / 2) / times
    matrix = np.column_stack([turn, middle - turn @ np.full(2, (size - 1) / 2)])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    upright = cv2.warpAffine(crop, matrix, (size, size), flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return Patch(x, y, cell, _features(np.asarray(upright, np.uint8), cells, signed))


def turned_features(features: Singles, angle: float) -> Singles:
    """(C, S, S) features, or a filter over them, of what is turned by `angle` degrees, clockwise.

    Places are bicubic about the middle, with nothing beyond; orientations turn with them, by
    their harmonics.
    """
    import cv2

    side = features.shape[1]
    middle = (side - 1) / 2
    turn = np.array([[_cos(angle), _sin(angle)], [-_sin(angle), _cos(angle)]])
    matrix = np.column_stack([turn, middle - turn @ np.full(2, middle)])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    placed = np.stack([cv2.warpAffine(one, matrix, (side, side), flags=flags) for one in features])
    half = ORIENTATIONS // 2
    signed = ((0, ORIENTATIONS),) if len(features) == CHANNELS else ()
    for first, count in (*signed, (len(features) - UNSIGNED_CHANNELS, half)):
        own = placed[first : first + count].reshape(count, -1)
        placed[first : first + count] = (_shift(count, angle * ORIENTATIONS / 360.0) @ own).reshape(
            -1, side, side
        )
    return placed


def _shift(count: int, steps: float) -> Singles:
    """(count, count) matrix that moves values round a circle by `steps`, by their harmonics."""
    spectrum = np.fft.rfft(np.eye(count), axis=0)
    phases = np.exp(-2j * np.pi * np.arange(count // 2 + 1) * steps / count)
    return np.fft.irfft(spectrum * phases[:, None], n=count, axis=0).astype(np.float32)


def _cos(degrees: float) -> float:
    return float(np.cos(np.radians(degrees)))


def _sin(degrees: float) -> float:
    return float(np.sin(np.radians(degrees)))


def _features(resized: Bytes, cells: int, signed: bool) -> Singles:
    """(C, cells, cells) of a square of `cells` + 2 cells."""
    import cv2

    from bayesnet_track.vision.kernels.gradient_kernels import (
        cell_means,
        normalised_cells,
        oriented_gradients,
    )

    around, half = cells + 2, ORIENTATIONS // 2
    histograms = np.empty((around, around, ORIENTATIONS if signed else half), np.float32)
    oriented_gradients(cv2.cvtColor(resized, cv2.COLOR_BGR2GRAY), half, histograms)
    features = np.empty((CHANNELS if signed else UNSIGNED_CHANNELS, cells, cells), np.float32)
    normalised_cells(histograms, half, NOISE, features)
    means = np.empty((around, around, 3), np.uint8)
    cell_means(resized.reshape(len(resized), -1), means.reshape(around, -1))
    mixed = cv2.transform(means[1:-1, 1:-1].astype(np.float32), _MIXES)
    features[-3:] = mixed.transpose(2, 0, 1)
    return features


def _cut_shrunk(image: Bytes, left: int, top: int, side: int, times: int) -> Bytes:
    """(side, side, 3) means of `times` x `times` px from column `left` and row `top`: nothing aliases.

    What lies farther beyond the image than one of these squares is that square's again.
    """
    if times == 1:
        return _cut(image, left, top, (side, side))
    import cv2

    height, width = image.shape[:2]
    (x0, x1), (y0, y1) = (
        (
            min(max(-first // times - 1, 0), side - 1),
            max(min((size - 1 - first) // times + 2, side), 1),
        )
        for first, size in ((left, width), (top, height))
    )
    part = _cut(image, left + x0 * times, top + y0 * times, ((y1 - y0) * times, (x1 - x0) * times))
    small = cv2.resize(part, (x1 - x0, y1 - y0), interpolation=cv2.INTER_AREA)
    return np.asarray(_bordered(small, y0, x0, (side, side)), np.uint8)


def _cut(image: Bytes, left: int, top: int, size: tuple[int, int]) -> Bytes:
    """(rows, columns, 3) of the image, as many as `size`, from column `left` and row `top`."""
    height, width = image.shape[:2]
    # a crop beside the frame holds one line of its border
    x0, x1 = min(max(left, 0), width - 1), max(min(left + size[1], width), 1)
    y0, y1 = min(max(top, 0), height - 1), max(min(top + size[0], height), 1)
    part = image[y0:y1, x0:x1]
    above, before = min(max(-top, 0), size[0] - (y1 - y0)), min(max(-left, 0), size[1] - (x1 - x0))
    return _bordered(part, above, before, size)


def _bordered(part: Bytes, above: int, before: int, size: tuple[int, int]) -> Bytes:
    """The part below so many rows and beside so many columns like its first, up to `size` like its last."""
    import cv2

    rows, columns = part.shape[:2]
    if (rows, columns) == size:
        return part
    after = size[0] - rows - above, size[1] - columns - before
    kind = cv2.BORDER_REPLICATE
    return np.asarray(cv2.copyMakeBorder(part, above, after[0], before, after[1], kind), np.uint8)
