"""Rendering of rectangles and discs with area coverage and sensor noise, on textures of plain arithmetic."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats, Image

ORANGE = (30.0, 135.0, 240.0)
"""BGR; hue 30 degrees, far enough from 0 and 255 that the noise is not cut off."""


def smooth_background(
    width: int, height: int, base: float, swing: float, rng: np.random.Generator, cell: int = 16
) -> Floats:
    """(height, width, 3) gray hills: random values on a grid of `cell` px, bilinear between them.

    Values lie in base - swing .. base + swing; all three channels are equal.
    """
    grid = rng.integers(-1000, 1001, size=(height // cell + 2, width // cell + 2)) * (swing / 1000.0)
    gray = base + _between(width, cell).T @ grid.T @ _between(height, cell)
    return np.repeat(np.ascontiguousarray(gray.T)[:, :, None], 3, axis=2)


def _between(pixels: int, cell: int) -> Floats:
    """(grid points, pixels) bilinear weights."""
    at, share = np.divmod(np.arange(pixels), cell)
    weights = np.zeros((pixels // cell + 2, pixels))
    weights[at, np.arange(pixels)] = 1.0 - share / cell
    weights[at + 1, np.arange(pixels)] += share / cell
    return weights


def flat(colour: tuple[float, float, float]) -> Floats:
    """(1, 1, 3): one colour."""
    return np.array(colour, dtype=np.float64).reshape(1, 1, 3)


def gray_cells(rows: int, columns: int, low: int, high: int, rng: np.random.Generator) -> Floats:
    """(rows, columns, 3): a gray level for each cell, low .. high."""
    levels = rng.integers(low, high + 1, size=(rows, columns, 1)).astype(np.float64)
    return np.repeat(levels, 3, axis=2)


def shaded_cells(
    rows: int, columns: int, colour: tuple[float, float, float], darkest: float, rng: np.random.Generator
) -> Floats:
    """(rows, columns, 3): one hue in many shades, each cell `colour` times darkest .. 1."""
    shade = darkest + (1.0 - darkest) * rng.integers(0, 1001, size=(rows, columns, 1)) / 1000.0
    return np.asarray(shade * np.array(colour), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Sprite:
    """A moving rectangle filled with a grid of flat cells.

    Attributes:
        cells: (rows, columns, 3) BGR values of its cells, which share its area evenly.
        path: (n, 4) centre box x, y, w, h in px for every frame; NaN where it is not there.
        is_round: only the ellipse inside the box is there.
    """

    cells: Floats
    path: Floats
    is_round: bool = False


@dataclass(frozen=True, eq=False)
class Veil:
    """Light that comes and goes, added to what is behind it; the camera's range cuts it off.

    Attributes:
        light: (H, W, 3) BGR at full strength.
        strength: (n,) share of it in every frame.
        above: number of sprites behind it, the first ones.
    """

    light: Floats
    strength: Floats
    above: int


def coverage(centre: float, size: float, cells: int, pixels: int) -> tuple[int, Floats]:
    """How much of each pixel each cell of a segment covers.

    The segment [centre - size/2, centre + size/2] is cut into `cells` equal parts; pixel i spans
    [i - 0.5, i + 0.5]. Returns the first pixel touched and a matrix (pixels touched, cells) of covered
    lengths; the matrix is empty when the segment lies outside 0 .. pixels - 1.

    >>> coverage(1.25, 1.0, 1, 4)
    (1, array([[0.75],
           [0.25]]))
    """
    edges = centre - size / 2 + size * np.arange(cells + 1) / cells
    first = min(max(int(np.floor(edges[0] + 0.5)), 0), pixels)
    last = min(max(int(np.ceil(edges[-1] + 0.5)), first), pixels)
    left = np.arange(first, last)[:, None] - 0.5
    covered = np.minimum(edges[1:], left + 1.0) - np.maximum(edges[:-1], left)
    return first, np.clip(covered, 0.0, None)


def paint(canvas: Floats, sprite: Sprite, index: int) -> None:
    """Paint the sprite's box of frame `index` over `canvas` (H, W, 3), in place, exact to the sub-pixel."""
    x, y, w, h = sprite.path[index]
    if np.isnan(x):
        return
    rows, columns = sprite.cells.shape[:2]
    top, down = coverage(y, h, rows, canvas.shape[0])
    left, across = coverage(x, w, columns, canvas.shape[1])
    covered = np.outer(down.sum(axis=1), across.sum(axis=1))[:, :, None]
    colour = np.tensordot(np.tensordot(down, sprite.cells, axes=(1, 0)), across, axes=(1, 1)).transpose(
        0, 2, 1
    )
    patch = canvas[top : top + down.shape[0], left : left + across.shape[0]]
    if sprite.is_round:
        rows_at = np.arange(top, top + len(down), dtype=np.float64)
        columns_at = np.arange(left, left + len(across), dtype=np.float64)
        inside = ellipse_share(sprite.path[index], rows_at, columns_at)
        colour = np.divide(colour, covered, out=colour, where=covered > 0) * inside
        covered = inside
    patch *= 1.0 - covered
    patch += colour


def ellipse_share(box: Floats, rows: Floats, columns: Floats) -> Floats:
    """(rows, columns, 1) share of each pixel, of 4 x 4 points, inside the ellipse of a centre box (4,)."""
    x, y, w, h = box
    parts = (np.arange(4) + 0.5) / 4 - 0.5
    down = ((rows[:, None] + parts - y) / (h / 2)) ** 2
    across = ((columns[:, None] + parts - x) / (w / 2)) ** 2
    inside = down[:, :, None, None] + across[None, None] <= 1.0
    return np.asarray(inside.mean(axis=(1, 3))[:, :, None])


@cache
def _noise_table(sd: float) -> NDArray[np.int16]:
    """65536 whole numbers, as often each as a Gaussian rounded to whole numbers has them."""
    limit = int(np.ceil(5 * sd)) + 1
    gauss = NormalDist(0.0, sd)
    below = np.array([gauss.cdf(k + 0.5) for k in range(-limit, limit)] + [1.0])
    counts = np.diff(np.rint(below * 65536).astype(np.int64), prepend=0)
    return np.repeat(np.arange(-limit, limit + 1, dtype=np.int16), counts)


@dataclass(frozen=True, eq=False)
class Movie:
    """The frames of a scene: a sequence that renders a picture when it is asked for.

    Attributes:
        background: (H, W, 3) BGR.
        sprites: painted in this order, so the last is nearest to the camera.
        noise_sd: sd of the independent noise of every pixel and channel, in gray levels.
        seed: seed of the noise.
        veils: light between and before the sprites.
    """

    background: Floats
    sprites: tuple[Sprite, ...]
    noise_sd: float
    seed: int
    veils: tuple[Veil, ...] = ()

    def __len__(self) -> int:
        return int(self.sprites[0].path.shape[0])

    def __getitem__(self, index: int) -> Image:
        if not -len(self) <= index < len(self):
            raise IndexError(f"frame {index} of a scene of {len(self)} frames")
        return self._render(index % len(self))

    def __iter__(self) -> Iterator[Image]:
        return (self._render(index) for index in range(len(self)))

    def _render(self, index: int) -> Image:
        canvas = self.background.copy()
        for count, sprite in enumerate(self.sprites):
            self._light(canvas, index, count)
            paint(canvas, sprite, index)
        self._light(canvas, index, len(self.sprites))
        np.rint(canvas, out=canvas)
        values = canvas.astype(np.int16)
        if self.noise_sd > 0:
            rng = np.random.Generator(np.random.SFC64((self.seed, index)))
            values += _noise_table(self.noise_sd)[rng.integers(0, 65536, size=values.shape, dtype=np.uint16)]
        return np.clip(values, 0, 255).astype(np.uint8)

    def _light(self, canvas: Floats, index: int, painted: int) -> None:
        """Add the veils that lie over exactly the first `painted` sprites."""
        for veil in self.veils:
            if veil.above == painted and veil.strength[index]:
                canvas += veil.strength[index] * veil.light
