"""Windows of a grid's masses: cut to the image and to the cells that matter, or laid over each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.belief.grid.cells import Lattice
from bayesnet_track.belief.motion.bounds import Confined
from bayesnet_track.numerics.arrays import Floats

NEGLIGIBLE = 1e-13
"""Outer rows and columns with less than this share of the heaviest one's mass are dropped."""


@dataclass(frozen=True, eq=False)
class Patch:
    """Masses (vy, vx, rows, columns) of one scale; the first cell stands in `column`, `row`."""

    mass: Floats
    column: int
    row: int


@dataclass(frozen=True)
class Limits:
    """First and last column and row of the image (None: no borders), and most cells of a window."""

    columns: tuple[int, int] | None
    rows: tuple[int, int] | None
    window: int


def limits_of(lattice: Lattice, motion: MotionModel, window: int) -> Limits:
    """The columns and rows of the image that a confined motion keeps to."""
    if not isinstance(motion, Confined):
        return Limits(None, None, window)
    bounds: list[tuple[int, int]] = []
    for anchor, size in zip(lattice.anchor, (motion.width, motion.height), strict=True):
        low = int(np.ceil(-anchor / lattice.cell_px - 1e-9))
        high = int(np.floor((size - 1 - anchor) / lattice.cell_px + 1e-9))
        bounds.append((low, high) if low <= high else (low, low))
    return Limits(bounds[0], bounds[1], window)


def within(patch: Patch, limits: Limits, most: int) -> Patch:
    """The masses inside the image, without empty borders, and at most `most` cells to a side."""
    across = patch.mass.sum(axis=(0, 1, 2))
    column, keep, ends = find_kept(across, patch.column, limits.columns, most)
    mass = _fold(patch.mass, keep, ends)
    down = mass.sum(axis=(0, 1, 3))
    row, keep, ends = find_kept(down, patch.row, limits.rows, most)
    return Patch(_fold(mass.swapaxes(2, 3), keep, ends).swapaxes(2, 3), column, row)


def find_kept(
    line: Floats, start: int, bounds: tuple[int, int] | None, most: int
) -> tuple[int, slice, tuple[bool, bool]]:
    """First cell kept, the slice of the line that is kept, and whether the ends take what lies beyond."""
    low, high = 0, len(line) - 1
    folds = (False, False)
    if bounds is not None:
        low, high = min(max(bounds[0] - start, 0), high), max(min(bounds[1] - start, high), 0)
        folds = (start + low > start, high < len(line) - 1)
    inside = np.abs(line)
    if folds[0]:
        inside[low] += inside[:low].sum()
    if folds[1]:
        inside[high] += inside[high + 1 :].sum()
    heavy = low + np.flatnonzero(inside[low : high + 1] > NEGLIGIBLE * inside[low : high + 1].max())
    first, last = int(heavy[0]), int(heavy[-1])
    if last - first >= most:
        cells = np.arange(first, last + 1)
        middle = float(inside[first : last + 1] @ cells / inside[first : last + 1].sum())
        first = min(max(round(middle) - most // 2, first), last - most + 1)
        last = first + most - 1
    at = start + first
    if bounds is not None:  # all of it may lie beyond a border
        at = min(max(at, bounds[0]), bounds[1])
    return at, slice(first, last + 1), (folds[0] and first == low, folds[1] and last == high)


def _fold(mass: Floats, keep: slice, ends: tuple[bool, bool]) -> Floats:
    """The columns that are kept; an end that is the image's border takes the mass beyond it."""
    kept = mass[..., keep]
    if not any(ends):
        return kept
    kept = kept.copy()
    if ends[0]:
        kept[..., 0] += mass[..., : keep.start].sum(axis=-1)
    if ends[1]:
        kept[..., -1] += mass[..., keep.stop :].sum(axis=-1)
    return kept


def stack_patches(patches: Sequence[Patch]) -> tuple[Floats, int, int]:
    """(patches, vy, vx, rows, columns) on the smallest common window, and its first column and row."""
    column, row = min(p.column for p in patches), min(p.row for p in patches)
    columns = max(p.column + p.mass.shape[3] for p in patches) - column
    rows = max(p.row + p.mass.shape[2] for p in patches) - row
    if len(patches) == 1:
        return patches[0].mass[None], column, row
    stacked = np.zeros((len(patches), *patches[0].mass.shape[:2], rows, columns))
    for layer, patch in zip(stacked, patches, strict=True):
        at_row, at_column = patch.row - row, patch.column - column
        height, width = patch.mass.shape[2:]
        layer[:, :, at_row : at_row + height, at_column : at_column + width] = patch.mass
    return stacked, column, row
