"""A correlation filter: patches as cells of features, learnt in the Fourier domain, and its answers on tiles.

The filter w minimises the ridge regression |sum_c w_c * x_c - y|^2 + ridge |w|^2 over all cyclic shifts of
the windowed features x of the target's patch, y a narrow Gaussian (Danelljan et al. 2014; Henriques et al.
2015): W = X conj(Y) / (sum |X|^2 + ridge), numerator and denominator of which can be blended. Shifts of the
target by whole cells are never learnt from the picture, they come for nothing.

A target that is searched for is asked about the same tiles several times in a frame.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Bytes, Floats, Singles
from bayesnet_track.observation.planes import Frame, for_reading

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
class _Patch:
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


def patch_at(image: Bytes, x: float, y: float, cell: float, cells: int, signed: bool = True) -> _Patch:
    """The patch of `cells` x `cells` cells of about `cell` px around (x, y) of an (H, W, 3) BGR image.

    With gradients that have their sign too if `signed`.

    Whole pixels are cut out: centre and cell are the nearest to what is asked for that this allows. Beyond
    the image its border is repeated.
    """
    import cv2

    from bayesnet_track.vision.kernels.correlation_kernels import CELL

    padded = cells + 2  # a rim for the energy around a cell
    size = CELL * padded
    side = max(round(cell * padded), 2)
    times = max(side // size, 1)
    side -= side % times
    left, top = round(x - (side - 1) / 2), round(y - (side - 1) / 2)
    crop = _cut_shrunk(image, left, top, side // times, times)
    resized = np.asarray(cv2.resize(crop, (size, size), interpolation=cv2.INTER_LINEAR), np.uint8)
    return _Patch(
        left + (side - 1) / 2, top + (side - 1) / 2, side / padded, _features(resized, cells, signed)
    )


def turned_patch_at(
    image: Bytes, x: float, y: float, cell: float, cells: int, signed: bool, angle: float
) -> _Patch:
    """Patch of a square turned by `angle` degrees, clockwise: it shows the target upright."""
    import cv2

    from bayesnet_track.vision.kernels.correlation_kernels import CELL

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
    return _Patch(x, y, cell, _features(np.asarray(upright, np.uint8), cells, signed))


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
    placed = np.stack([cv2.warpAffine(channel, matrix, (side, side), flags=flags) for channel in features])
    half = ORIENTATIONS // 2
    signed = ((0, ORIENTATIONS),) if len(features) == CHANNELS else ()
    for first, count in (*signed, (len(features) - UNSIGNED_CHANNELS, half)):
        group = placed[first : first + count].reshape(count, -1)
        placed[first : first + count] = (_shift(count, angle * ORIENTATIONS / 360.0) @ group).reshape(
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

    from bayesnet_track.vision.kernels.correlation_kernels import (
        cell_means,
        normalised_cells,
        oriented_gradients,
    )

    padded, half = cells + 2, ORIENTATIONS // 2
    histograms = np.empty((padded, padded, ORIENTATIONS if signed else half), np.float32)
    oriented_gradients(cv2.cvtColor(resized, cv2.COLOR_BGR2GRAY), half, histograms)
    features = np.empty((CHANNELS if signed else UNSIGNED_CHANNELS, cells, cells), np.float32)
    normalised_cells(histograms, half, NOISE, features)
    means = np.empty((padded, padded, 3), np.uint8)
    cell_means(resized.reshape(len(resized), -1), means.reshape(padded, -1))
    mixed = cv2.transform(means[1:-1, 1:-1].astype(np.float32), _MIXES)
    features[-3:] = mixed.transpose(2, 0, 1)
    return features


def _cut_shrunk(image: Bytes, left: int, top: int, side: int, times: int) -> Bytes:
    """(side, side, 3) colours of squares of `times` x `times` px from column `left` and row `top`.

    The mean of four pixels spread over a square stands for it, so that a large target takes no longer than a
    small one. Beyond the image its border is repeated.
    """
    if times > 1:
        from bayesnet_track.vision.kernels.patch_kernels import sample_squares

        sampled = np.empty((side, side, 3), np.uint8)
        sample_squares(for_reading(image), left, top, times, 2, sampled)
        return sampled
    import cv2

    height, width = image.shape[:2]
    # a crop beside the frame holds one line of its border
    x0, x1 = min(max(left, 0), width - 1), max(min(left + side, width), 1)
    y0, y1 = min(max(top, 0), height - 1), max(min(top + side, height), 1)
    part, rows, columns = image[y0:y1, x0:x1], y1 - y0, x1 - x0
    if rows == columns == side:
        return part
    upper, first = min(max(-top, 0), side - rows), min(max(-left, 0), side - columns)
    borders = upper, side - rows - upper, first, side - columns - first
    return np.asarray(cv2.copyMakeBorder(part, *borders, cv2.BORDER_REPLICATE), np.uint8)


Spectra = NDArray[np.complex64]


@lru_cache(maxsize=8)
def hann(side: int, width: float, height: float) -> Singles:
    """(side, side) window: cos^2 over `width` and `height` cells in the middle, 0 beyond."""
    place = np.arange(side) - 0.5 * (side - 1)

    def line(span: float) -> Floats:
        length = min(span, float(side))
        return np.where(np.abs(place) < length / 2, np.cos(np.pi * place / length) ** 2, 0.0)

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
    regularised = denominator + max(ridge * float(denominator.mean()), 1e-9)
    quotient = numerator / regularised.astype(np.float32)
    return np.fft.irfft(np.fft.ifft(quotient, axis=-2), side).astype(np.float32)


def tile_spectra(patch: Singles, side: int) -> Singles:
    """(H, C, 4, H) the Fourier transform of (C, F, F), H = F / 2 + 1, for filters of `side` cells.

    Phases are counted from the middle of a filter in the first cells, as `scaled_answers` wants them; parts
    are laid out as `centre_spectra` says.
    """
    import cv2

    from bayesnet_track.vision.kernels.correlation_kernels import centre_spectra

    channels, size = patch.shape[:2]
    rows, packed_planes = size // 2 + 1, np.empty(patch.shape, np.float32)
    for plane, packed in zip(patch, packed_planes, strict=True):
        cv2.dft(plane, packed)
    spectra = np.empty((rows, channels, 4, rows), np.float32)
    centre_spectra(packed_planes, _turns(side, size), spectra)
    return spectra


def halves(kernel: Singles) -> Singles:
    """(2, 2, S / 2, C, S / 2) even and odd part of a filter (C, S, S) by column and row about its middle."""
    from bayesnet_track.vision.kernels.correlation_kernels import fill_halves

    channels, side = kernel.shape[:2]
    parts = np.empty((2, 2, side // 2, channels, side // 2), np.float32)
    fill_halves(for_reading(kernel), parts)
    return parts


def scaled_answers(spectra: Singles, parts: Singles, scale: float) -> Singles:
    """(V, V) answers of a filter of S cells, enlarged by `scale`, to a patch of F cells; V = F - S + 1.

    The patch is given by its `tile_spectra`, the filter by its `halves`. The answer at [j, i] is that to the
    target's middle at column i and row j + (S - 1) / 2 of the cells.
    """
    import cv2

    from bayesnet_track.vision.kernels.correlation_kernels import conjugate_product

    side, size = 2 * parts.shape[2], 2 * len(spectra) - 2
    total = np.empty((size, size), np.float32)
    conjugate_product(spectra, spectral_halves(parts, size, scale), total)
    back = cv2.dft(total, flags=cv2.DFT_INVERSE | cv2.DFT_SCALE)
    return np.asarray(back[: size - side + 1, : size - side + 1], np.float32)


def spectral_halves(parts: Singles, size: int, scale: float) -> Singles:
    """(2, 2, H, C, H) the `halves` of a filter enlarged by `scale` and transformed, H = `size` / 2 + 1.

    Resizing and transforming a filter are both linear and both symmetric about its middle. Thus they are
    products of small matrices by column and by row (`waves`), and no image is resized or transformed.
    """
    half, channels, rows = parts.shape[2], parts.shape[3], size // 2 + 1
    added = waves(2 * half, size, scale)
    by_column = (parts.reshape(2, -1, half) @ added).reshape(2, 2, half, channels * rows)
    return np.asarray((added.transpose(0, 2, 1) @ by_column).reshape(2, 2, rows, channels, rows))


@lru_cache(maxsize=128)
def waves(side: int, size: int, scale: float) -> Singles:
    """(2, S / 2, H) what a cell of the even part adds to each frequency's cosine, of the odd to its sine.

    The filter of `side` cells is enlarged about its middle, bicubic, into a square of `size` cells with
    nothing beyond its own; divided by the scale by row and by column, so that a smooth filter's sum stays.
    """
    middle, cells = 0.5 * (side - 1), np.arange(side)
    resize = _resizing(side, scale)
    angles = 2.0 * np.pi / size * np.outer(np.arange(size // 2 + 1), cells - middle)
    half = side // 2
    parts = [(turn(angles) @ resize)[:, :half].T for turn in (np.cos, np.sin)]
    added = np.array(parts, np.float32)
    added.setflags(write=False)  # shared by all who ask for it
    return added


def _resizing(side: int, scale: float) -> Floats:
    """(side, side) weights of the source's cells in each cell enlarged: Catmull and Rom's cubic."""
    middle, cells = 0.5 * (side - 1), np.arange(side)
    place = (cells - middle) / scale + middle
    base = np.floor(place).astype(np.int64)
    t = place - base
    taps = (
        ((-0.5 * t + 1.0) * t - 0.5) * t,
        (1.5 * t - 2.5) * t * t + 1.0,
        ((-1.5 * t + 2.0) * t + 0.5) * t,
        (0.5 * t - 0.5) * t * t,
    )
    weights = np.zeros((side, side + 4))  # two more on either side, which are nothing
    for a, tap in enumerate(taps):
        source = np.clip(base - 1 + a, -2, side + 1)
        weights[cells, source + 2] += tap / scale
    return weights[:, 2:-2]


@lru_cache(maxsize=8)
def _turns(side: int, size: int) -> Singles:
    """(H, 2, 2, H) cosine and sine by which frequencies (j, k) and (-j, k) turn about the filter's middle."""
    steps = np.arange(size // 2 + 1)
    angles = np.pi * (side - 1) / size * np.stack([np.add.outer(steps, steps), steps - steps[:, None]], 1)
    turns = np.stack([np.cos(angles), np.sin(angles)], 2).astype(np.float32)
    turns.setflags(write=False)
    return turns


SCALE_STEP = 0.08
"""Between levels of scale, in the logarithm."""
TURN_STEP = 15.0
"""Between levels of rotation, degrees."""


@dataclass(eq=False)
class Tile:
    """A square of a frame.

    Attributes:
        x: column of its centre, frame px; likewise `y`.
        cell: side of a cell, frame px.
        spectra: of its features, by `tile_spectra`.
        maps: (level of turn, level of scale) -> (V, V) answers of the filter `kernel`.
        kernel: the filter that was last looked for.
    """

    x: float
    y: float
    cell: float
    spectra: Singles
    maps: dict[tuple[int, int], Singles] = field(default_factory=dict)
    kernel: Singles | None = None


@dataclass(frozen=True)
class TileKey:
    """Key of an answer: the tile and the filters.

    Attributes:
        x: column of its centre, frame px; likewise `y`.
        cell: side of a cell, frame px, about.
        around: side of the tile, cells.
        side: that of the filters, cells.
        signed: whether gradients have their sign.
    """

    x: float
    y: float
    cell: float
    around: int
    side: int
    signed: bool


_OF_FRAME: WeakKeyDictionary[Frame, dict[TileKey, Tile]] = WeakKeyDictionary()


def find_tile(frame: Frame, image: Bytes, key: TileKey) -> Tile:
    """The tile of the frame, whose (H, W, 3) BGR `image` is read when it is asked for the first time."""
    tiles = _OF_FRAME.setdefault(frame, {})
    if key not in tiles:
        patch = patch_at(image, key.x, key.y, key.cell, key.around, key.signed)
        tiles[key] = Tile(patch.x, patch.y, patch.cell, tile_spectra(patch.features, key.side))
    return tiles[key]


def find_maps(tile: Tile, kernel: Singles, turn: int, levels: range, parts: dict[int, Singles]) -> Singles:
    """(L, V, V) answers to a tile of a filter (C, S, S) at levels of scale; one array is one filter.

    `parts` are its halves by level of turn, to which those are added that were needed.
    """
    if tile.kernel is not kernel:
        tile.kernel, tile.maps = kernel, {}
    for level in levels:
        if (turn, level) not in tile.maps:
            if turn not in parts:
                parts[turn] = halves(turned_features(kernel, TURN_STEP * turn) if turn else kernel)
            scale = float(np.exp(SCALE_STEP * level))
            tile.maps[turn, level] = scaled_answers(tile.spectra, parts[turn], scale)
    return np.array([tile.maps[turn, level] for level in levels])
