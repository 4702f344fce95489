"""Motion of a grid's masses: drift and noise, also over gaps that take them far.

Each axis goes at once from the old window to the new one, which is chosen first from the axis' own marginal.
In between (after the first of the three steps of `grid_motion`) half of the noise has smoothed the masses, so
that they stand on points as far apart as that noise allows: a few dozen, however long the gap.

Equations 1 to 3 of the General Distribution Filter. A linear drift of position and velocity with correlated
noise splits exactly into three steps along single axes. With c = Q_xv / Q_vv, the noise of the velocity n and
what is left of the position's noise e (variance Q_xx - c Q_xv, split between the first step and the last),

    x' = x + (F_xv - c F_vv) v + e / sqrt 2,    v' = F_vv v + n,    x'' = x' + c v' + e / sqrt 2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.belief.grid.cells import (
    GridBelief,
    GridLimits,
    Lattice,
    Patch,
    X,
    Y,
    crop_patch,
    find_kept,
    limits_of,
    predict_by_function,
    stack_patches,
)
from bayesnet_track.belief.motion.borders import Confined
from bayesnet_track.belief.motion.formulas import FormulaMotion
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.distributions import SUBCELL, gaussian_taps, spreading_matrix

REACH = 7.0
"""Sds at which noise ends: 3e-12 of its mass lies further out."""

APART = 1.0 / math.sqrt(2.0)
"""Spacing of the points in between, in sds of each half: sums over the product of both err by 5e-9."""


@dataclass(frozen=True)
class Span:
    """Cells `low` to `high`; what moves beyond stays in the last cell of an end that keeps it."""

    low: int
    high: int
    keeps: tuple[bool, bool]


@dataclass(frozen=True, eq=False)
class Leap:
    """Effect of a gap on the position along one axis, in cells.

    Attributes:
        first: (V,) shift of each old velocity.
        second: (V,) shift of each new velocity.
        change: (V, V) of p(new velocity | old velocity).
        sd: of the noise.
    """

    first: Floats
    second: Floats
    change: Floats
    sd: float

    @property
    def reach(self) -> tuple[float, float]:
        """Distance that mass goes down and up."""
        shift = self.first[None, :] + self.second[:, None]
        return float(shift.min()) - REACH * self.sd, float(shift.max()) + REACH * self.sd


def leapt(
    patch: Patch, x_leaps: Sequence[Leap], y_leaps: Sequence[Leap], shares: Floats, limits: GridLimits
) -> Patch:
    """A patch after a gap; `x_leaps` and `y_leaps` say what each component of the noise does to x and y.

    Args:
        shares: (C,) of the components.
        limits: of the new window.
    """
    columns = _span(patch.mass.sum(axis=(0, 2)), patch.column, x_leaps, shares, limits.columns, limits.window)
    rows = _span(patch.mass.sum(axis=(1, 3)), patch.row, y_leaps, shares, limits.rows, limits.window)
    mass = np.zeros((*patch.mass.shape[:2], rows.high - rows.low + 1, columns.high - columns.low + 1))
    for share, x_leap, y_leap in zip(shares, x_leaps, y_leaps, strict=True):
        shifted = _leapt(share * patch.mass, patch.column, x_leap, columns)
        shifted = np.ascontiguousarray(shifted.transpose(1, 0, 3, 2))
        mass += _leapt(shifted, patch.row, y_leap, rows).transpose(1, 0, 3, 2)
    return Patch(mass, columns.low, rows.low)


def _span(
    lines: Floats,
    start: int,
    leaps: Sequence[Leap],
    shares: Floats,
    bounds: tuple[int, int] | None,
    window: int,
) -> Span:
    """The new window of an axis with masses (V, cells)."""
    if bounds is None:
        mean_cell = start + float(lines.sum(axis=0) @ np.arange(lines.shape[1]) / lines.sum())
        shift = leaps[0].first[None, :] + leaps[0].second[:, None]
        middle = round(mean_cell + float((leaps[0].change * lines.sum(axis=1) * shift).sum() / lines.sum()))
        widest = Span(middle - window, middle + window, (False, False))
    else:
        widest = Span(*bounds, (True, True))
    reached = [_leapt(lines[None, :, None], start, leap, widest).sum(axis=(0, 1, 2)) for leap in leaps]
    low, keep, _ = find_kept(shares @ np.array(reached), widest.low, bounds, window)
    high = low + keep.stop - keep.start - 1
    return Span(low, high, (False, False) if bounds is None else (low == bounds[0], high == bounds[1]))


def _leapt(mass: Floats, start: int, leap: Leap, span: Span) -> Floats:
    """Masses (A, V, B, cells) whose first cell is `start`, moved along the last axis to `span`."""
    cells = start + np.arange(mass.shape[-1])
    if len(leap.first) == 1:
        shift = leap.first[0] + leap.second[0]
        return np.asarray(mass @ moving(cells + shift, leap.sd, span))
    half = leap.sd / math.sqrt(2.0)
    spacing = max(APART * half, 1.0)
    between = _between(cells, leap, span, spacing)
    to_points = moving((cells + leap.first[:, None]) / spacing, half / spacing, between)
    points = spacing * np.arange(between.low, between.high + 1)
    from_points = moving(points + leap.second[:, None], half, span)
    at_points = mass @ to_points
    lines = at_points.reshape(len(mass), len(leap.first), -1)
    return np.asarray((leap.change @ lines).reshape(at_points.shape) @ from_points)


def _between(cells: NDArray[np.int64], leap: Leap, span: Span, spacing: float) -> Span:
    """The points in between, at multiples of `spacing` cells: those that may still reach the span."""
    reach = REACH * leap.sd / math.sqrt(2.0) + 4.0 * spacing
    low, high = cells[0] + leap.first.min() - reach, cells[-1] + leap.first.max() + reach
    size = span.high - span.low + 1
    margin = max(2.0 * size, 60.0 * spacing)  # mass that is further out does not come back
    low, high = max(low, span.low - margin), min(high, span.high + margin)
    if low > high:  # all of it passes one end
        low, high = min(low, span.high + margin), max(high, span.low - margin)
    return Span(math.floor(low / spacing), math.ceil(high / spacing), (True, True))


def moving(centres: Floats, sd: float, span: Span) -> Floats:
    """(..., cells of the span) of p(cell | centre) for mass at `centres` (...) and noise of `sd`, in cells.

    From `SUBCELL` on the noise is sampled; below, it has the right moments up to the sixth.
    """
    cells = np.arange(span.low, span.high + 1)
    if sd < SUBCELL:
        return _narrow(centres, sd, span)
    deviations = (cells - centres[..., None]) / sd
    masses = np.exp(-0.5 * deviations**2) / (sd * math.sqrt(2.0 * math.pi))
    if any(span.keeps):
        lower_tail = _tail((centres - span.low + 0.5) / sd)
        upper_tail = _tail((span.high + 0.5 - centres) / sd)
        tail_mass = np.clip(1.0 - masses.sum(axis=-1), 0.0, None)
        is_cut = lower_tail + upper_tail > 1e-9  # or what is missing is the sampling's error
        tail_mass[~is_cut] = 0.0
        share = np.divide(lower_tail, lower_tail + upper_tail, out=np.zeros_like(lower_tail), where=is_cut)
        masses[..., 0] += tail_mass * share * span.keeps[0]
        masses[..., -1] += tail_mass * (1.0 - share) * span.keeps[1]
    return np.asarray(masses)


def _narrow(centres: Floats, sd: float, span: Span) -> Floats:
    size = span.high - span.low + 1
    flat = np.clip(centres.ravel(), span.low - 8.0, span.high + 8.0)
    lines = np.zeros((len(flat), size))
    for line, centre in zip(lines, flat, strict=True):
        first, taps = gaussian_taps(float(centre) - span.low, sd)
        cells = first + np.arange(len(taps))
        counts = ((cells >= 0) | span.keeps[0]) & ((cells < size) | span.keeps[1])
        np.add.at(line, np.clip(cells[counts], 0, size - 1), taps[counts])
    return lines.reshape(*centres.shape, size)


def _tail(deviations: Floats) -> Floats:
    """The standard normal mass beyond `deviations`."""
    flat = [0.5 * math.erfc(value / math.sqrt(2.0)) for value in deviations.ravel().tolist()]
    return np.array(flat).reshape(deviations.shape)


FEW = 96
"""Cells by which a window may grow on the way to the next frame, however small it is."""


@dataclass(frozen=True)
class AxisStep:
    """Effect of one frame on position and velocity of an axis, px and px per frame.

    Attributes:
        first: F_xv - c F_vv, frames.
        second: c, frames.
        decay: F_vv.
        sd_velocity: of the velocity's noise.
        variances: of e, for each component of the noise.
        offset: a shift that all masses take in the first step.
    """

    first: float
    second: float
    decay: float
    sd_velocity: float
    variances: tuple[float, ...]
    offset: float = 0.0


def predict_grid(prior: GridBelief, motion: MotionModel, dt: float, window: int) -> GridBelief:
    """The belief after `dt` frame intervals, in a window of at most `window` cells around its mean.

    Mass that would leave the image stays at its border, as confined hypotheses do; mass further from the
    mean than the window reaches is cut off.

    Raises:
        ValueError: the motion needs cells that the belief does not have.
    """
    if isinstance(motion.motion if isinstance(motion, Confined) else motion, FormulaMotion):
        return predict_by_function(prior, motion, dt, window)
    lattice, limits = prior.lattice, limits_of(prior.lattice, motion, window)
    sizes = np.exp(lattice.log_scales)[:, None] * np.array(lattice.size)
    patches: list[Patch] = []
    occupied = np.flatnonzero(prior.mass.sum(axis=(1, 2, 3, 4)) > 0)
    for scale in occupied:
        state = prior.mean.copy()
        state[2:4] = sizes[scale]
        steps, shares = axis_steps(motion, state, dt)
        patch = Patch(prior.mass[scale], lattice.column, lattice.row)
        patches.append(_move(patch, steps, shares, lattice, limits))
    layers, column, row = stack_patches(patches)
    if len(occupied) < len(sizes):
        occupied_layers, layers = layers, np.zeros((len(sizes), *layers.shape[1:]))
        layers[occupied] = occupied_layers
    if len(layers) > 1:
        sd = scale_sd(motion, prior.mean, dt) / float(lattice.log_scales[1] - lattice.log_scales[0])
        layers = np.tensordot(spreading_matrix(len(layers), 1.0, sd), layers, 1)
    fitted = crop_patch(Patch(layers.reshape(-1, *layers.shape[2:]), column, row), limits, limits.window)
    mass = np.maximum(fitted.mass, 0.0).reshape(*layers.shape[:3], *fitted.mass.shape[2:])
    mass /= mass.sum()
    return replace(prior, mass=mass, lattice=replace(lattice, column=fitted.column, row=fitted.row))


def axis_steps(motion: MotionModel, state: Floats, dt: float) -> tuple[tuple[AxisStep, AxisStep], Floats]:
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


def scale_sd(motion: MotionModel, state: Floats, dt: float) -> float:
    """The sd of log sqrt(w h) over `dt`.

    Raises:
        ValueError: the size changes in another way than by its scale.
    """
    noise = motion.linearise(state, dt)[1][2:4, 2:4] / np.outer(state[2:4], state[2:4])
    if not np.allclose(noise, noise[0, 0], rtol=1e-6, atol=1e-15):
        raise ValueError("a grid's size changes by its scale alone: use sd_log.scale")
    return float(np.sqrt(noise[0, 0]))


def _move(
    patch: Patch, steps: tuple[AxisStep, AxisStep], shares: Floats, lattice: Lattice, limits: GridLimits
) -> Patch:
    """One scale's masses after the motion. The wide part of the noise takes all axes together."""
    velocities, cell = lattice.velocities, lattice.cell_px
    changes = [_change(step, velocities) for step in steps]
    x_step, y_step = (_bound(k, patch, steps[k], (shares, changes[k]), lattice, limits) for k in (0, 1))
    leaps = [
        [
            Leap((step.first * velocities + step.offset) / cell, step.second * velocities / cell, change, sd)
            for sd in np.sqrt(step.variances) / cell
        ]
        for step, change in zip((x_step, y_step), changes, strict=True)
    ]
    if max(np.ptp(leap.reach) for leap in (*leaps[0], *leaps[1])) > max(limits.window, FEW):
        return leapt(patch, leaps[0], leaps[1], shares, limits)
    half = [0.0, 0.0]
    if len(velocities) > 1:
        half = [min(step.variances) / 2 for step in (x_step, y_step)]
        patch = _spread(patch, X, x_step.first * velocities + x_step.offset, half[0], lattice)
        patch = _spread(patch, Y, y_step.first * velocities + y_step.offset, half[1], lattice)
        patch = replace(patch, mass=_turn(patch.mass, changes[1], changes[0]))
    parts: list[Patch] = []
    for k, share in enumerate(shares):
        part = replace(patch, mass=patch.mass * share) if len(shares) > 1 else patch
        part = _spread(part, X, x_step.second * velocities, x_step.variances[k] - half[0], lattice)
        parts.append(_spread(part, Y, y_step.second * velocities, y_step.variances[k] - half[1], lattice))
    if len(parts) == 1:
        return parts[0]
    layers, column, row = stack_patches(parts)
    return Patch(layers.sum(axis=0), column, row)


def _change(step: AxisStep, velocities: Floats) -> Floats:
    """(V, V) of p(new velocity | old velocity) along an axis."""
    size = len(velocities)
    if size == 1:
        return np.ones((1, 1))
    sd = min(step.sd_velocity / float(velocities[1] - velocities[0]), 20.0 * size)  # even, but for the ends
    return spreading_matrix(size, step.decay, sd)


def _bound(
    axis: int,
    patch: Patch,
    step: AxisStep,
    noise: tuple[Floats, Floats],
    lattice: Lattice,
    limits: GridLimits,
) -> AxisStep:
    """The step, with a spread of at most that of a target which may be anywhere in the image.

    As for Gaussians, the mean then goes to its place in the image. Without an image the window is its stead.
    `noise` holds the shares of the noise's parts and p(new velocity | old velocity) along the axis.
    """
    shares, change = noise
    mass = patch.mass.sum(axis=(0, 2) if axis == 0 else (1, 3))  # (V, cells)
    velocity_shares = mass.sum(axis=1) / mass.sum()
    shifts = step.first * lattice.velocities[None, :] + step.second * lattice.velocities[:, None]
    joint = change * velocity_shares
    drift = float((joint * shifts).sum())
    spread = float((joint * (shifts - drift) ** 2).sum() + shares @ np.array(step.variances))
    mean_cell = (
        float(mass.sum(axis=0) @ np.arange(mass.shape[1]) / mass.sum()) + (patch.column, patch.row)[axis]
    )
    ends, goal = (limits.columns, limits.rows)[axis], mean_cell * lattice.cell_px + drift
    largest = (limits.window * lattice.cell_px) ** 2
    if ends is not None:
        low, high = (end * lattice.cell_px for end in ends)
        goal = min(max(goal, low), high)
        largest = (high - low + lattice.cell_px) ** 2 / 12 + (goal - (low + high) / 2) ** 2
    if spread <= largest:
        return step
    less = np.sqrt(largest / spread)
    return replace(
        step,
        first=step.first * less,
        second=step.second * less,
        offset=goal - mean_cell * lattice.cell_px - less * drift,
        variances=tuple(variance * largest / spread for variance in step.variances),
    )


def _turn(mass: Floats, y_change: Floats, x_change: Floats) -> Floats:
    """The masses after the velocities' step: new[a, b] = sum y_change[a, c] x_change[b, d] old[c, d]."""
    from bayesnet_track.numerics.kernels import box_kernels

    vy, vx = mass.shape[:2]
    turned = np.empty((vy, vx, mass[0, 0].size))
    box_kernels.turn(np.ascontiguousarray(mass).reshape(turned.shape), y_change, x_change, turned)
    return turned.reshape(mass.shape)


def _spread(patch: Patch, axis: int, shifts: Floats, variance: float, lattice: Lattice) -> Patch:
    """The masses moved along X or Y by a shift (px) of each velocity and spread by noise (px^2)."""
    from bayesnet_track.numerics.kernels import box_kernels

    if variance <= 0.0 and not shifts.any():
        return patch
    sd = float(np.sqrt(max(variance, 0.0))) / lattice.cell_px
    kernels = [gaussian_taps(float(cell), sd) for cell in shifts / lattice.cell_px]
    first = np.array([kernel[0] for kernel in kernels], dtype=np.int64)
    taps = np.stack([kernel[1] for kernel in kernels])
    low = int(first.min())
    grown = list(patch.mass.shape)
    grown[axis - 1] += int(first.max()) - low + taps.shape[1] - 1
    spread = np.zeros(grown)
    mass = np.ascontiguousarray(patch.mass)
    if axis == X:
        box_kernels.spread_columns(mass, taps, first - low, spread)
        return Patch(spread, patch.column + low, patch.row)
    box_kernels.spread_rows(mass, taps, first - low, spread)
    return Patch(spread, patch.column, patch.row + low)
