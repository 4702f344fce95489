"""Distributions over cells of position, velocity and scale: the posterior of a grid and its windows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import BOX_FIELDS, Evaluate, Evidence, MotionModel, hypotheses_of
from bayesnet_track.belief.motion.borders import Confined
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.distributions import gaussian_taps, spreading_matrix
from bayesnet_track.numerics.log_weights import LogWeights
from bayesnet_track.numerics.resampling import resample
from bayesnet_track.observation.cue import Measurement

SCALE, VY, VX, Y, X = range(5)
"""Axes of the cells' array. An axis that is not used has one cell."""

AXIS = {"x": X, "y": Y, "w": SCALE, "h": SCALE, "vx": VX, "vy": VY}


@dataclass(frozen=True, eq=False)
class Lattice:
    """Places of cells: points of a lattice that is anchored at the start box's centre.

    Attributes:
        anchor: (x, y) of the cell in column 0, row 0, px.
        cell_px: spacing in x and y.
        column: column of the first cell of the window.
        row: its row.
        size: (w, h) of the middle scale, px.
        log_scales: (S,) logarithms of the sizes' factors.
        velocities: (V,) px per frame, of each axis; a single 0 without velocity.
    """

    anchor: tuple[float, float]
    cell_px: float
    column: int
    row: int
    size: tuple[float, float]
    log_scales: Floats
    velocities: Floats

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of the columns of a state."""
        return BOX_FIELDS + (("vx", "vy") if len(self.velocities) > 1 else ())

    def columns(self, count: int) -> Floats:
        """(count,) x of the cells, px."""
        return np.asarray(self.anchor[0] + self.cell_px * (self.column + np.arange(count)))

    def rows(self, count: int) -> Floats:
        """(count,) y of the cells, px."""
        return np.asarray(self.anchor[1] + self.cell_px * (self.row + np.arange(count)))


@dataclass(frozen=True, eq=False)
class GridBelief:
    """Masses of cells. A cell stands for its own point: the density is known there.

    The moments are sums over these points. On a smooth density wider than a cell they are those of the
    density itself (error exp(-2 pi^2 sd^2 / cell^2)), so that adding cell^2 / 12 for the inside of a cell, as
    for a histogram, would be wrong.

    Attributes:
        mass: (S, V, V, rows, columns) of scale, vy, vx, y, x; not negative, summing to 1.
        lattice: where the cells stand.
        first_velocities: (V, V) masses of vy and vx when nothing is known of them.
        asked: number of hypotheses at which evidence was taken in the last step.
    """

    mass: Floats
    lattice: Lattice
    first_velocities: Floats
    asked: int = 1

    def __len__(self) -> int:
        return self.asked

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of the columns of a state."""
        return self.lattice.fields

    @cached_property
    def positions(self) -> Floats:
        """(S, rows, columns) masses whatever the velocity."""
        return np.asarray(self.mass.sum(axis=(VY, VX)))

    @cached_property
    def values(self) -> tuple[Floats, ...]:
        """Each field's values along its axis (`AXIS`)."""
        lattice, factors = self.lattice, np.exp(self.lattice.log_scales)
        rows, columns = self.mass.shape[Y], self.mass.shape[X]
        sizes = (lattice.size[0] * factors, lattice.size[1] * factors)
        box = (lattice.columns(columns), lattice.rows(rows), *sizes)
        return box if len(self.fields) == 4 else (*box, lattice.velocities, lattice.velocities)

    @cached_property
    def mean(self) -> Floats:
        """(D,) mean state."""
        pairs = zip(self.fields, self.values, strict=True)
        return np.array([self._marginal(AXIS[name]) @ values for name, values in pairs])

    @cached_property
    def covariance(self) -> Floats:
        """(D, D) covariance of the cells' points."""
        size = len(self.fields)
        deviations = [values - mean for values, mean in zip(self.values, self.mean, strict=True)]
        axes = [AXIS[name] for name in self.fields]
        result = np.zeros((size, size))
        for i in range(size):
            for j in range(i + 1):
                if axes[i] == axes[j]:
                    value = self._marginal(axes[i]) @ (deviations[i] * deviations[j])
                else:
                    low, high = sorted((i, j), key=lambda k: axes[k])
                    value = deviations[low] @ self._joint(axes[low], axes[high]) @ deviations[high]
                result[i, j] = result[j, i] = value
        return result

    def uncertainty(self, reference: Floats, columns: Sequence[int]) -> float:
        """UD = E |s - about|^2 over the columns of the state."""
        selection = list(columns)
        offset = self.mean[selection] - reference[selection]
        return float(np.diag(self.covariance)[selection].sum() + offset @ offset)

    def mass_within(self, centre: Floats, radius: float) -> tuple[float, float]:
        """Mass of the cells whose points lie within `radius` px of `centre` (2,), exact."""
        x, y = self.values[:2]
        in_circle = (y[:, None] - centre[1]) ** 2 + (x - centre[0]) ** 2 <= radius * radius
        return min(float(self.positions.sum(axis=0)[in_circle].sum()), 1.0), math.inf

    def regions(self, shares: Sequence[float]) -> Floats:
        """(S, 4) x_low, x_high, y_low, y_high in px: the central share on each axis, even inside a cell."""
        tails = np.array([[(1.0 - share) / 2.0, (1.0 + share) / 2.0] for share in shares])
        bounds = np.empty((len(tails), 4))
        for k, (axis, values) in enumerate(((X, self.values[0]), (Y, self.values[1]))):
            edges = np.append(values, values[-1] + self.lattice.cell_px) - self.lattice.cell_px / 2
            cumulative = np.append(0.0, np.cumsum(self._marginal(axis)))
            bounds[:, 2 * k : 2 * k + 2] = np.interp(tails, cumulative, edges)
        return bounds

    def draw(self, size: int, rng: np.random.Generator) -> Floats:
        """(size, 4) boxes: cells drawn systematically, the centre even inside its cell."""
        positions = self.positions
        cells = resample("systematic", positions.ravel() / positions.sum(), size, rng)
        boxes = self.boxes(cells)
        boxes[:, :2] += self.lattice.cell_px * (rng.random((size, 2)) - 0.5)
        return boxes

    def boxes(self, cells: NDArray[np.integer]) -> Floats:
        """(N, 4) boxes of cells, given as indices into the flat `positions`."""
        scale, row, column = np.unravel_index(cells, self.positions.shape)
        x, y, w, h = self.values[:4]
        return np.stack([x[column], y[row], w[scale], h[scale]], axis=1)

    def most_probable(self) -> Floats:
        """(D,) state of the cell of the largest mass: the maximum of the density, prior included."""
        cell = np.unravel_index(int(np.argmax(self.mass)), self.mass.shape)
        pairs = zip(self.fields, self.values, strict=True)
        return np.array([values[cell[AXIS[name]]] for name, values in pairs])

    def _marginal(self, axis: int) -> Floats:
        if axis in (VX, VY):
            return np.asarray(self._velocities.sum(axis=int(axis == VY)))
        return np.asarray(self.positions.sum(axis=tuple({0, 1, 2} - {_IN_POSITIONS[axis]})))

    @cached_property
    def _velocities(self) -> Floats:
        """(V, V) masses of vy, vx."""
        return np.asarray(self.mass.sum(axis=(SCALE, Y, X)))

    def _joint(self, first: int, second: int) -> Floats:
        """Masses of two axes, the first the lower one."""
        if first == VY and second == VX:
            return self._velocities
        if {first, second} <= set(_IN_POSITIONS):
            summed = {0, 1, 2} - {_IN_POSITIONS[first], _IN_POSITIONS[second]}
            return np.asarray(self.positions.sum(axis=tuple(summed)))
        return np.asarray(self.mass.sum(axis=tuple({0, 1, 2, 3, 4} - {first, second})))


_IN_POSITIONS = {SCALE: 0, Y: 1, X: 2}


NEGLIGIBLE = 1e-13
"""Outer rows and columns with less than this share of the heaviest one's mass are dropped."""


@dataclass(frozen=True, eq=False)
class Patch:
    """Masses (vy, vx, rows, columns) of one scale; the first cell stands in `column`, `row`."""

    mass: Floats
    column: int
    row: int


@dataclass(frozen=True)
class GridLimits:
    """First and last column and row of the image (None: no borders), and most cells of a window."""

    columns: tuple[int, int] | None
    rows: tuple[int, int] | None
    window: int


def limits_of(lattice: Lattice, motion: MotionModel, window: int) -> GridLimits:
    """The columns and rows of the image that a confined motion keeps to."""
    if not isinstance(motion, Confined):
        return GridLimits(None, None, window)
    bounds: list[tuple[int, int]] = []
    for anchor, size in zip(lattice.anchor, (motion.width, motion.height), strict=True):
        low = int(np.ceil(-anchor / lattice.cell_px - 1e-9))
        high = int(np.floor((size - 1 - anchor) / lattice.cell_px + 1e-9))
        bounds.append((low, high) if low <= high else (low, low))
    return GridLimits(bounds[0], bounds[1], window)


def crop_patch(patch: Patch, limits: GridLimits, size: int) -> Patch:
    """The masses inside the image, without empty borders, and at most `size` cells to a side."""
    column_masses = patch.mass.sum(axis=(0, 1, 2))
    column, keep, ends = find_kept(column_masses, patch.column, limits.columns, size)
    mass = _fold(patch.mass, keep, ends)
    row_masses = mass.sum(axis=(0, 1, 3))
    row, keep, ends = find_kept(row_masses, patch.row, limits.rows, size)
    return Patch(_fold(mass.swapaxes(2, 3), keep, ends).swapaxes(2, 3), column, row)


def find_kept(
    line: Floats, start: int, bounds: tuple[int, int] | None, size: int
) -> tuple[int, slice, tuple[bool, bool]]:
    """First cell kept, the slice of the line that is kept, and whether the ends take what lies beyond."""
    low, high = 0, len(line) - 1
    folds = (False, False)
    if bounds is not None:
        low, high = min(max(bounds[0] - start, 0), high), max(min(bounds[1] - start, high), 0)
        folds = (start + low > start, high < len(line) - 1)
    masses = np.abs(line)
    if folds[0]:
        masses[low] += masses[:low].sum()
    if folds[1]:
        masses[high] += masses[high + 1 :].sum()
    heavy = low + np.flatnonzero(masses[low : high + 1] > NEGLIGIBLE * masses[low : high + 1].max())
    first, final = int(heavy[0]), int(heavy[-1])
    if final - first >= size:
        cells = np.arange(first, final + 1)
        middle = float(masses[first : final + 1] @ cells / masses[first : final + 1].sum())
        first = min(max(round(middle) - size // 2, first), final - size + 1)
        final = first + size - 1
    first_cell = start + first
    if bounds is not None:  # all of it may lie beyond a border
        first_cell = min(max(first_cell, bounds[0]), bounds[1])
    return first_cell, slice(first, final + 1), (folds[0] and first == low, folds[1] and final == high)


def _fold(mass: Floats, keep: slice, ends: tuple[bool, bool]) -> Floats:
    """The columns that are kept; an end that is the image's border takes the mass beyond it."""
    folded = mass[..., keep]
    if not any(ends):
        return folded
    folded = folded.copy()
    if ends[0]:
        folded[..., 0] += mass[..., : keep.start].sum(axis=-1)
    if ends[1]:
        folded[..., -1] += mass[..., keep.stop :].sum(axis=-1)
    return folded


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


def log_gaussian(measured: Measurement, values: list[Floats]) -> Floats:
    """Log-likelihood of a Gaussian message at the values of its fields, mixed with its floor."""
    return _log_away(measured, np.stack(values, axis=-1) - measured.mean)


def log_measured(measured: Measurement, states: Floats, fields: tuple[str, ...]) -> Floats:
    """(N,) the same of states (N, D), by their fields or by functions of them."""
    if measured.seen is None:
        return log_gaussian(measured, [states[:, fields.index(name)] for name in measured.fields])
    values = measured.seen.function(dict(zip(fields, states.T, strict=True)))
    return _log_away(measured, np.nan_to_num(measured.seen.less(values, measured.mean), nan=1e100))


def _log_away(measured: Measurement, deviations: Floats) -> Floats:
    distance2 = np.einsum("...k,kl,...l->...", deviations, np.linalg.inv(measured.covariance), deviations)
    likelihood = measured.floor + (1.0 - measured.floor) * np.exp(-0.5 * distance2)
    return np.asarray(np.log(likelihood + 1e-300))  # finite far out, as products of masses need it


def ask_again(
    evaluate: Evaluate,
    first: Evidence,
    states: Floats,
    fields: tuple[str, ...],
    prior_log: Floats | None = None,
) -> Evidence:
    """The evidence at other states (N, D) of a frame that was measured already.

    Agents that measure look around the hypotheses that they are given, and would find another place now.
    What they measured first stands, so that both are evidence of one frame.
    """
    prior_log = LogWeights.uniform(len(states)).log if prior_log is None else prior_log
    fresh = evaluate(hypotheses_of(states, fields), prior_log)
    if not first.gaussians and not fresh.gaussians:
        return fresh
    sampled = fresh.log_likelihood if fresh.sampled is None else fresh.sampled
    total = sampled
    for measurement in first.gaussians.values():
        total = total + log_measured(measurement, states, fields)
    return replace(
        fresh, log_likelihood=total, gaussians=first.gaussians, sampled=sampled, measured=first.measured
    )


def predict_by_function(prior: GridBelief, motion: MotionModel, dt: float, window: int) -> GridBelief:
    """The belief after `dt` frame intervals, in a window of at most `window` cells around its mean.

    The Phi(x) of the General Distribution Filter may be any function of the state. Every cell's mass goes
    where the function takes its state, split between the cells around that place so that moments up to the
    third are kept; the noise, the same everywhere, then spreads it.

    The cells' spacing should be less than an sd of the noise wherever the function pulls cells apart; else
    holes between them stay.
    """
    lattice, v = prior.lattice, prior.lattice.velocities
    cells = np.argwhere(prior.mass > NEGLIGIBLE * prior.mass.max())  # scale, vy, vx, row, column
    mass = prior.mass[tuple(cells.T)]
    values = prior.values
    sizes = np.tile(prior.mean[2:4], (len(cells), 1))
    states = np.column_stack([values[0][cells[:, 4]], values[1][cells[:, 3]], sizes])
    if len(v) > 1:
        states = np.column_stack([states, v[cells[:, 2]], v[cells[:, 1]]])
    drifted = motion.drift(states, dt)
    sds = np.sqrt(np.diagonal(motion.linearise(prior.mean, dt)[1]))

    column, row = ((drifted[:, k] - lattice.anchor[k]) / lattice.cell_px for k in (0, 1))
    if len(v) > 1:
        highest = len(v) - 1.0
        speeds = [np.clip((drifted[:, k] - v[0]) / (v[1] - v[0]), 0.0, highest) for k in (5, 4)]
    else:
        speeds = [np.zeros(len(cells)), np.zeros(len(cells))]
    column, row = (_near_mean(places, mass, window) for places in (column, row))
    patch = _deposit(mass, (*speeds, row, column), len(v))

    if len(v) > 1:
        spread_y, spread_x = (spreading_matrix(len(v), 1.0, sds[k] / float(v[1] - v[0])) for k in (5, 4))
        patch = replace(
            patch, mass=np.einsum("ac,bd,cdyx->abyx", spread_y, spread_x, patch.mass, optimize=True)
        )
    patch = _spread(_spread(patch, 3, sds[0] / lattice.cell_px), 2, sds[1] / lattice.cell_px)
    limits = limits_of(lattice, motion, window)
    fitted = crop_patch(replace(patch, mass=np.maximum(patch.mass, 0.0)), limits, window)
    masses = fitted.mass[None] / fitted.mass.sum()
    return replace(prior, mass=masses, lattice=replace(lattice, column=fitted.column, row=fitted.row))


def _deposit(mass: Floats, places: Sequence[Floats], velocities: int) -> Patch:
    """Masses (N,) at places (vy, vx, row, column), in cells, each split between four cells an axis."""
    taps = [_taps(place, velocities) if k < 2 else _taps(place) for k, place in enumerate(places)]
    low = [0, 0, *(int(cells.min()) for cells, _ in taps[2:])]
    high = [velocities - 1, velocities - 1, *(int(cells.max()) for cells, _ in taps[2:])]
    shape = [end + 1 - first for first, end in zip(low, high, strict=True)]
    total = np.zeros(int(np.prod(shape)))
    for corner in product(*(range(len(cells)) for cells, _ in taps)):
        index = np.zeros(len(mass), dtype=np.int64)
        share = mass
        for (cells, weights), tap, first, size in zip(taps, corner, low, shape, strict=True):
            index = index * size + cells[tap] - first
            share = share * weights[tap]
        total += np.bincount(index, share, len(total))
    return Patch(total.reshape(shape), low[3], low[2])


def _taps(place: Floats, size: int | None = None) -> tuple[Ints, Floats]:
    """(T, N) cells around places (N,), and (T, N) shares by Lagrange's cubic; of an axis of `size` its own.

    >>> cells, shares = _taps(np.array([2.25]))
    >>> (cells[:, 0] @ shares[:, 0]).item(), (cells[:, 0] ** 2 @ shares[:, 0]).item()
    (2.25, 5.0625)
    """
    if size == 1:
        return np.zeros((1, len(place)), dtype=np.int64), np.ones((1, len(place)))
    base = np.floor(place)
    f = place - base
    shares = np.stack(
        [
            -f * (f - 1) * (f - 2) / 6,
            (f + 1) * (f - 1) * (f - 2) / 2,
            -(f + 1) * f * (f - 2) / 2,
            (f + 1) * f * (f - 1) / 6,
        ]
    )
    cells = base.astype(np.int64) + np.arange(-1, 3)[:, None]
    return (cells if size is None else np.clip(cells, 0, size - 1)), shares


def _near_mean(place: Floats, mass: Floats, window: int) -> Floats:
    middle = float(mass @ place / mass.sum())
    return np.clip(place, middle - window, middle + window)


def _spread(patch: Patch, axis: int, sd: float) -> Patch:
    """The masses spread along rows (2) or columns (3) by noise of `sd` cells."""
    if sd == 0.0:
        return patch
    first, taps = gaussian_taps(0.0, sd)
    size = patch.mass.shape[axis]
    grown = list(patch.mass.shape)
    grown[axis] += len(taps) - 1
    spread = np.zeros(grown)
    lines, to = np.moveaxis(patch.mass, axis, 0), np.moveaxis(spread, axis, 0)
    for t, weight in enumerate(taps):
        to[t : t + size] += weight * lines
    corner = {2: (patch.column, patch.row + first), 3: (patch.column + first, patch.row)}[axis]
    return Patch(spread, *corner)
