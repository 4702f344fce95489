"""How a grid's masses move over gaps in time that take them far, compared with the window.

Each axis goes at once from the old window to the new one, which is chosen first from the axis' own marginal.
In between (after the first of the three steps of `grid_motion`) half of the noise has smoothed the masses, so
that they stand on points as far apart as that noise allows: a few dozen, however long the gap.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.grid.window import Limits, Patch, find_kept
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.distributions import SUBCELL, gaussian_taps

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
    """What a gap does to the position along one axis, in cells.

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
        """How far down and up mass goes."""
        shift = self.first[None, :] + self.second[:, None]
        return float(shift.min()) - REACH * self.sd, float(shift.max()) + REACH * self.sd


def leapt(
    patch: Patch, across: Sequence[Leap], down: Sequence[Leap], shares: Floats, limits: Limits
) -> Patch:
    """A patch after a gap; `across` and `down` say what each component of the noise does to x and y.

    Args:
        shares: (C,) of the components.
        limits: of the new window.
    """
    columns = _span(patch.mass.sum(axis=(0, 2)), patch.column, across, shares, limits.columns, limits.window)
    rows = _span(patch.mass.sum(axis=(1, 3)), patch.row, down, shares, limits.rows, limits.window)
    mass = np.zeros((*patch.mass.shape[:2], rows.high - rows.low + 1, columns.high - columns.low + 1))
    for share, right, below in zip(shares, across, down, strict=True):
        moved = _leapt(share * patch.mass, patch.column, right, columns)
        moved = np.ascontiguousarray(moved.transpose(1, 0, 3, 2))
        mass += _leapt(moved, patch.row, below, rows).transpose(1, 0, 3, 2)
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
        at = start + float(lines.sum(axis=0) @ np.arange(lines.shape[1]) / lines.sum())
        shift = leaps[0].first[None, :] + leaps[0].second[:, None]
        middle = round(at + float((leaps[0].change * lines.sum(axis=1) * shift).sum() / lines.sum()))
        whole = Span(middle - window, middle + window, (False, False))
    else:
        whole = Span(*bounds, (True, True))
    moved = [_leapt(lines[None, :, None], start, leap, whole).sum(axis=(0, 1, 2)) for leap in leaps]
    low, keep, _ = find_kept(shares @ np.array(moved), whole.low, bounds, window)
    high = low + keep.stop - keep.start - 1
    return Span(low, high, (False, False) if bounds is None else (low == bounds[0], high == bounds[1]))


def _leapt(mass: Floats, start: int, leap: Leap, span: Span) -> Floats:
    """Masses (A, V, B, cells) whose first cell is `start`, moved along the last axis to `span`."""
    cells = start + np.arange(mass.shape[-1])
    if len(leap.first) == 1:
        shift = leap.first[0] + leap.second[0]
        return np.asarray(mass @ moving(cells + shift, leap.sd, span))
    half = leap.sd / math.sqrt(2.0)
    apart = max(APART * half, 1.0)
    between = _between(cells, leap, span, apart)
    to_points = moving((cells + leap.first[:, None]) / apart, half / apart, between)
    points = apart * np.arange(between.low, between.high + 1)
    from_points = moving(points + leap.second[:, None], half, span)
    moved = mass @ to_points
    lines = moved.reshape(len(mass), len(leap.first), -1)
    return np.asarray((leap.change @ lines).reshape(moved.shape) @ from_points)


def _between(cells: NDArray[np.int64], leap: Leap, span: Span, apart: float) -> Span:
    """The points in between, at multiples of `apart` cells: those that may still reach the span."""
    reach = REACH * leap.sd / math.sqrt(2.0) + 4.0 * apart
    low, high = cells[0] + leap.first.min() - reach, cells[-1] + leap.first.max() + reach
    size = span.high - span.low + 1
    far = max(2.0 * size, 60.0 * apart)  # mass that is further out does not come back
    low, high = max(low, span.low - far), min(high, span.high + far)
    if low > high:  # all of it passes one end
        low, high = min(low, span.high + far), max(high, span.low - far)
    return Span(math.floor(low / apart), math.ceil(high / apart), (True, True))


def moving(centres: Floats, sd: float, span: Span) -> Floats:
    """(..., cells of the span) of p(cell | centre) for mass at `centres` (...) and noise of `sd`, in cells.

    From `SUBCELL` on the noise is sampled; below, it has the right moments up to the sixth.
    """
    cells = np.arange(span.low, span.high + 1)
    if sd < SUBCELL:
        return _narrow(centres, sd, span)
    away = (cells - centres[..., None]) / sd
    inside = np.exp(-0.5 * away**2) / (sd * math.sqrt(2.0 * math.pi))
    if any(span.keeps):
        below = _tail((centres - span.low + 0.5) / sd)
        above = _tail((span.high + 0.5 - centres) / sd)
        outside = np.clip(1.0 - inside.sum(axis=-1), 0.0, None)
        is_cut = below + above > 1e-9  # or what is missing is the sampling's error
        outside[~is_cut] = 0.0
        share = np.divide(below, below + above, out=np.zeros_like(below), where=is_cut)
        inside[..., 0] += outside * share * span.keeps[0]
        inside[..., -1] += outside * (1.0 - share) * span.keeps[1]
    return np.asarray(inside)


def _narrow(centres: Floats, sd: float, span: Span) -> Floats:
    size = span.high - span.low + 1
    flat = np.clip(centres.ravel(), span.low - 8.0, span.high + 8.0)
    out = np.zeros((len(flat), size))
    for line, centre in zip(out, flat, strict=True):
        first, taps = gaussian_taps(float(centre) - span.low, sd)
        at = first + np.arange(len(taps))
        counts = ((at >= 0) | span.keeps[0]) & ((at < size) | span.keeps[1])
        np.add.at(line, np.clip(at[counts], 0, size - 1), taps[counts])
    return out.reshape(*centres.shape, size)


def _tail(away: Floats) -> Floats:
    """The standard normal mass beyond `away`."""
    flat = [0.5 * math.erfc(value / math.sqrt(2.0)) for value in away.ravel().tolist()]
    return np.array(flat).reshape(away.shape)
