"""A distribution over cells of position, velocity and scale: the grid's posterior."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import BOX_FIELDS
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.resampling import resample

SCALE, VY, VX, Y, X = range(5)
"""Axes of the cells' array. An axis that is not used has one cell."""

AXIS = {"x": X, "y": Y, "w": SCALE, "h": SCALE, "vx": VX, "vy": VY}


@dataclass(frozen=True, eq=False)
class Lattice:
    """Where cells stand: points of a lattice that is anchored at the start box's centre.

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
        away = [values - mean for values, mean in zip(self.values, self.mean, strict=True)]
        axes = [AXIS[name] for name in self.fields]
        result = np.zeros((size, size))
        for i in range(size):
            for j in range(i + 1):
                if axes[i] == axes[j]:
                    value = self._marginal(axes[i]) @ (away[i] * away[j])
                else:
                    low, high = sorted((i, j), key=lambda k: axes[k])
                    value = away[low] @ self._joint(axes[low], axes[high]) @ away[high]
                result[i, j] = result[j, i] = value
        return result

    def uncertainty(self, about: Floats, columns: Sequence[int]) -> float:
        """UD = E |s - about|^2 over the columns of the state."""
        chosen = list(columns)
        off = self.mean[chosen] - about[chosen]
        return float(np.diag(self.covariance)[chosen].sum() + off @ off)

    def mass_within(self, centre: Floats, radius: float) -> tuple[float, float]:
        """Mass of the cells whose points lie within `radius` px of `centre` (2,), exact."""
        x, y = self.values[:2]
        inside = (y[:, None] - centre[1]) ** 2 + (x - centre[0]) ** 2 <= radius * radius
        return min(float(self.positions.sum(axis=0)[inside].sum()), 1.0), math.inf

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
        chosen = resample("systematic", positions.ravel() / positions.sum(), size, rng)
        boxes = self.boxes(chosen)
        boxes[:, :2] += self.lattice.cell_px * (rng.random((size, 2)) - 0.5)
        return boxes

    def boxes(self, chosen: NDArray[np.integer]) -> Floats:
        """(N, 4) boxes of cells, given as indices into the flat `positions`."""
        scale, row, column = np.unravel_index(chosen, self.positions.shape)
        x, y, w, h = self.values[:4]
        return np.stack([x[column], y[row], w[scale], h[scale]], axis=1)

    def most_probable(self) -> Floats:
        """(D,) state of the cell of the largest mass: the maximum of the density, prior included."""
        at = np.unravel_index(int(np.argmax(self.mass)), self.mass.shape)
        pairs = zip(self.fields, self.values, strict=True)
        return np.array([values[at[AXIS[name]]] for name, values in pairs])

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
            rest = {0, 1, 2} - {_IN_POSITIONS[first], _IN_POSITIONS[second]}
            return np.asarray(self.positions.sum(axis=tuple(rest)))
        return np.asarray(self.mass.sum(axis=tuple({0, 1, 2, 3, 4} - {first, second})))


_IN_POSITIONS = {SCALE: 0, Y: 1, X: 2}
