"""How a grid's masses move by any function of the state: the Phi(x) of the General Distribution Filter.

Every cell's mass goes where the function takes its state, split between the cells around that place so that
moments up to the third are kept; the noise, the same everywhere, then spreads it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.belief.grid.cells import NEGLIGIBLE, GridBelief, Patch, crop_patch, limits_of
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.distributions import gaussian_taps, spreading_matrix


def predict_by_function(prior: GridBelief, motion: MotionModel, dt: float, window: int) -> GridBelief:
    """The belief after `dt` frame intervals, in a window of at most `window` cells around its mean.

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
