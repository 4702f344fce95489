"""How a grid's masses move: by the motion's drift, then spread by its noise.

Equations 1 to 3 of the General Distribution Filter. A linear drift of position and velocity with correlated
noise splits exactly into three steps along single axes. With c = Q_xv / Q_vv, the noise of the velocity n and
what is left of the position's noise e (variance Q_xx - c Q_xv, split between the first step and the last),

    x' = x + (F_xv - c F_vv) v + e / sqrt 2,    v' = F_vv v + n,    x'' = x' + c v' + e / sqrt 2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.bounds import Confined
from bayesnet_track.belief.contract import Motion
from bayesnet_track.belief.grid_cells import GridBelief, Lattice, X, Y
from bayesnet_track.numerics.distributions import gaussian_taps, spreading_matrix

Floats = NDArray[np.float64]

NEGLIGIBLE = 1e-13
"""Outer rows and columns with less than this share of the heaviest one's mass are dropped."""


@dataclass(frozen=True, eq=False)
class Patch:
    """Masses (vy, vx, rows, columns) of one scale; the first cell stands in `column`, `row`."""

    mass: Floats
    column: int
    row: int


@dataclass(frozen=True)
class AxisStep:
    """What one frame does to position and velocity of an axis, px and px per frame.

    Attributes:
        first: F_xv - c F_vv, frames.
        second: c, frames.
        decay: F_vv.
        sd_velocity: of the velocity's noise.
        variances: of e, for each component of the noise.
    """

    first: float
    second: float
    decay: float
    sd_velocity: float
    variances: tuple[float, ...]


@dataclass(frozen=True)
class Limits:
    """First and last column and row of the image (None: no borders), and most cells of a window."""

    columns: tuple[int, int] | None
    rows: tuple[int, int] | None
    window: int


def predicted(prior: GridBelief, motion: Motion, dt: float, window: int) -> GridBelief:
    """The belief after `dt` frame intervals, in a window of at most `window` cells around its mean.

    Mass that would leave the image stays at its border, as confined hypotheses do; mass further from the
    mean than the window reaches is cut off.

    Raises:
        ValueError: the motion needs cells that the belief does not have.
    """
    lattice, limits = prior.lattice, limits_of(prior.lattice, motion, window)
    sizes = np.exp(lattice.log_scales)[:, None] * np.array(lattice.size)
    moved: list[Patch] = []
    for mass, size in zip(prior.mass, sizes, strict=True):
        state = prior.mean.copy()
        state[2:4] = size
        steps, shares = axis_steps(motion, state, dt)
        moved.append(_moved(Patch(mass, lattice.column, lattice.row), steps, shares, lattice, limits))
    layers, column, row = _stacked(moved)
    if len(layers) > 1:
        sd = scale_sd(motion, prior.mean, dt) / float(lattice.log_scales[1] - lattice.log_scales[0])
        layers = np.tensordot(spreading_matrix(len(layers), 1.0, sd), layers, 1)
    whole = _within(Patch(layers.reshape(-1, *layers.shape[2:]), column, row), limits, limits.window)
    mass = np.maximum(whole.mass, 0.0).reshape(*layers.shape[:3], *whole.mass.shape[2:])
    mass /= mass.sum()
    return replace(prior, mass=mass, lattice=replace(lattice, column=whole.column, row=whole.row))


def limits_of(lattice: Lattice, motion: Motion, window: int) -> Limits:
    """The columns and rows of the image that a confined motion keeps to."""
    if not isinstance(motion, Confined):
        return Limits(None, None, window)
    bounds: list[tuple[int, int]] = []
    for anchor, size in zip(lattice.anchor, (motion.width, motion.height), strict=True):
        low = int(np.ceil(-anchor / lattice.cell_px - 1e-9))
        high = int(np.floor((size - 1 - anchor) / lattice.cell_px + 1e-9))
        bounds.append((low, high) if low <= high else (low, low))
    return Limits(bounds[0], bounds[1], window)


def axis_steps(motion: Motion, state: Floats, dt: float) -> tuple[tuple[AxisStep, AxisStep], Floats]:
    """The steps of x and y at a state (D,), and the (C,) shares of the noise's components."""
    drift, noise = motion.linearise(state, dt)
    transition = motion.transition(state[None], dt)
    shares = np.exp(transition.log_shares)
    steps: list[AxisStep] = []
    column = 0
    for axis in (0, 1):
        along = noise[axis, axis]
        first = second = decay = sd_velocity = 0.0
        if len(state) > 4:
            variance = noise[4 + axis, 4 + axis]
            second = noise[axis, 4 + axis] / variance if variance > 0 else 0.0
            decay = float(drift[4 + axis, 4 + axis])
            first = drift[axis, 4 + axis] - second * decay
            along, sd_velocity = along - second * noise[axis, 4 + axis], np.sqrt(variance)
        variances = [max(float(along), 0.0)]
        if len(shares) > 1 and noise[axis, axis] > 0:
            variances = (transition.sds[:, 0, column] ** 2).tolist()
        column += int(noise[axis, axis] > 0)
        variances += variances * (len(shares) - len(variances))
        steps.append(AxisStep(float(first), float(second), decay, float(sd_velocity), tuple(variances)))
    return (steps[0], steps[1]), shares


def scale_sd(motion: Motion, state: Floats, dt: float) -> float:
    """The sd of log sqrt(w h) over `dt`.

    Raises:
        ValueError: the size changes in another way than by its scale.
    """
    noise = motion.linearise(state, dt)[1][2:4, 2:4] / np.outer(state[2:4], state[2:4])
    if not np.allclose(noise, noise[0, 0], rtol=1e-6, atol=1e-15):
        raise ValueError("a grid's size changes by its scale alone: use sd_log.scale")
    return float(np.sqrt(noise[0, 0]))


def _moved(
    patch: Patch, steps: tuple[AxisStep, AxisStep], shares: Floats, lattice: Lattice, limits: Limits
) -> Patch:
    """One scale's masses after the motion. The wide part of the noise takes all axes together."""
    half = [0.0, 0.0]
    across, down = steps
    if len(lattice.velocities) > 1:
        half = [min(step.variances) / 2 for step in steps]
        patch = _spread(patch, X, across.first * lattice.velocities, half[0], lattice, limits)
        patch = _spread(patch, Y, down.first * lattice.velocities, half[1], lattice, limits)
        spacing = float(lattice.velocities[1] - lattice.velocities[0])
        size = len(lattice.velocities)
        change = [spreading_matrix(size, step.decay, step.sd_velocity / spacing) for step in steps]
        patch = replace(patch, mass=_turned(patch.mass, change[1], change[0]))
    parts: list[Patch] = []
    for k, share in enumerate(shares):
        part = replace(patch, mass=patch.mass * share) if len(shares) > 1 else patch
        shift = across.second * lattice.velocities
        part = _spread(part, X, shift, across.variances[k] - half[0], lattice, limits)
        shift = down.second * lattice.velocities
        parts.append(_spread(part, Y, shift, down.variances[k] - half[1], lattice, limits))
    if len(parts) == 1:
        return parts[0]
    layers, column, row = _stacked(parts)
    return Patch(layers.sum(axis=0), column, row)


def _turned(mass: Floats, down: Floats, across: Floats) -> Floats:
    """The masses after the velocities' step: new[a, b] = sum down[a, c] across[b, d] old[c, d]."""
    from bayesnet_track.numerics import grid_kernels

    vy, vx = mass.shape[:2]
    out = np.empty((vy, vx, mass[0, 0].size))
    grid_kernels.turn(np.ascontiguousarray(mass).reshape(out.shape), down, across, out)
    return out.reshape(mass.shape)


def _spread(
    patch: Patch, axis: int, shifts: Floats, variance: float, lattice: Lattice, limits: Limits
) -> Patch:
    """The masses moved along X or Y by a shift (px) of each velocity and spread by noise (px^2)."""
    from bayesnet_track.numerics import grid_kernels

    if variance <= 0.0 and not shifts.any():
        return patch
    most = 4.0 * limits.window  # further than any window reaches
    sd = min(float(np.sqrt(max(variance, 0.0))) / lattice.cell_px, float(limits.window))
    cells = np.clip(shifts / lattice.cell_px, -most, most)
    kernels = [gaussian_taps(float(cell), sd) for cell in cells]
    first = np.array([kernel[0] for kernel in kernels], dtype=np.int64)
    taps = np.stack([kernel[1] for kernel in kernels])
    low = int(first.min())
    grown = list(patch.mass.shape)
    grown[axis - 1] += int(first.max()) - low + taps.shape[1] - 1
    out = np.zeros(grown)
    mass = np.ascontiguousarray(patch.mass)
    if axis == X:
        grid_kernels.spread_columns(mass, taps, first - low, out)
        spread = Patch(out, patch.column + low, patch.row)
    else:
        grid_kernels.spread_rows(mass, taps, first - low, out)
        spread = Patch(out, patch.column, patch.row + low)
    # Trimmed at the end; on the way only what a long gap has spread beyond use.
    return _within(spread, limits, 2 * limits.window) if max(grown) > 4 * limits.window else spread


def _within(patch: Patch, limits: Limits, most: int) -> Patch:
    """The masses inside the image, without empty borders, and at most `most` cells to a side."""
    across = patch.mass.sum(axis=(0, 1, 2))
    column, keep, ends = _kept(across, patch.column, limits.columns, most)
    mass = _folded(patch.mass, keep, ends)
    down = mass.sum(axis=(0, 1, 3))
    row, keep, ends = _kept(down, patch.row, limits.rows, most)
    return Patch(_folded(mass.swapaxes(2, 3), keep, ends).swapaxes(2, 3), column, row)


def _kept(
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


def _folded(mass: Floats, keep: slice, ends: tuple[bool, bool]) -> Floats:
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


def _stacked(patches: Sequence[Patch]) -> tuple[Floats, int, int]:
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
