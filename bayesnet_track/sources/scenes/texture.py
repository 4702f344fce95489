"""Backgrounds and surfaces, from whole-number random draws and plain arithmetic only."""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Floats

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
