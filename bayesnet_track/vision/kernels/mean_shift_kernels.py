"""Compiled kernels of mean shift: histograms under an Epanechnikov kernel, shifts, windowed moments."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.compiled import compiled

Cells = NDArray[np.uint16]


@compiled
def kernel_histogram(cells: Cells, x: float, y: float, rx: float, ry: float, bins: int) -> Floats:
    """(bins,) share of each colour cell under 1 - |d|^2 in the ellipse of radii rx, ry about (x, y).

    Coordinates are those of `cells` (rows, columns). Pixels outside it count in the whole, so that a window
    that leaves it sums to less than 1. Radii below 1 px are taken as 1. Tracking chapter, 3.15 and 3.84.
    """
    histogram = np.zeros(bins)
    rows, columns = cells.shape
    rx, ry = max(rx, 1.0), max(ry, 1.0)
    whole = 0.0
    for row in range(int(np.ceil(y - ry)), int(np.floor(y + ry)) + 1):
        down = ((row - y) / ry) ** 2
        for column in range(int(np.ceil(x - rx)), int(np.floor(x + rx)) + 1):
            weight = 1.0 - down - ((column - x) / rx) ** 2
            if weight > 0.0:
                whole += weight
                if 0 <= row < rows and 0 <= column < columns:
                    histogram[cells[row, column]] += weight
    if whole > 0.0:
        histogram /= whole
    return histogram


@compiled
def bhattacharyya(cells: Cells, model: Floats, x: float, y: float, rx: float, ry: float) -> float:
    """rho = sum over cells of sqrt(p q), p the histogram at a place and q the model (chapter, 3.87)."""
    here = kernel_histogram(cells, x, y, rx, ry, len(model))
    rho = 0.0
    for u in range(len(model)):
        rho += np.sqrt(here[u] * model[u])
    return rho


@compiled
def shift(
    cells: Cells, model: Floats, x: float, y: float, rx: float, ry: float, tolerance: float, most: int
) -> tuple[float, float, int]:
    """Mean shift of an ellipse toward the place whose colours are those of `model`; the place and the steps.

    Each pixel weighs sqrt(q_u / p_u), p the histogram where the window stands: for the Epanechnikov kernel
    the mean of these weights climbs the Bhattacharyya coefficient, linearised there. A step after which rho
    itself is lower is halved. Stops below `tolerance` px a step, after `most` steps, or where no pixel has a
    colour of the model (0 steps then, if at once).
    """
    rows, columns = cells.shape
    rx, ry = max(rx, 1.0), max(ry, 1.0)
    steps = 0
    weights = np.zeros(len(model))
    rho = bhattacharyya(cells, model, x, y, rx, ry)
    for _ in range(most):
        here = kernel_histogram(cells, x, y, rx, ry, len(model))
        for u in range(len(model)):
            weights[u] = np.sqrt(model[u] / here[u]) if here[u] > 0.0 else 0.0
        total = down = across = 0.0
        for row in range(max(int(np.ceil(y - ry)), 0), min(int(np.floor(y + ry)) + 1, rows)):
            height = ((row - y) / ry) ** 2
            for column in range(max(int(np.ceil(x - rx)), 0), min(int(np.floor(x + rx)) + 1, columns)):
                if height + ((column - x) / rx) ** 2 < 1.0:
                    weight = weights[cells[row, column]]
                    total += weight
                    across += weight * (column - x)
                    down += weight * (row - y)
        if total <= 0.0:
            break
        steps += 1
        across, down = across / total, down / total
        after = bhattacharyya(cells, model, x + across, y + down, rx, ry)
        while after < rho and across**2 + down**2 >= tolerance**2:
            across, down = across / 2, down / 2
            after = bhattacharyya(cells, model, x + across, y + down, rx, ry)
        if after < rho:
            break
        x, y, rho = x + across, y + down, after
        if across**2 + down**2 < tolerance**2:
            break
    return x, y, steps


@compiled
def window_moments(
    cells: Cells, probability: Floats, x: float, y: float, half_w: float, half_h: float
) -> Floats:
    """(6,) sums over a window of the back-projection P: P, P dx, P dy, P dx^2, P dx dy, P dy^2.

    dx, dy are taken from (x, y), the window's centre, in px of `cells`; pixels whose centre lies in
    [x - half_w, x + half_w) x [y - half_h, y + half_h) and inside `cells` count. The nearest always does.
    """
    rows, columns = cells.shape
    moments = np.zeros(6)
    left, right = int(np.ceil(x - half_w)), int(np.ceil(x + half_w))
    top, bottom = int(np.ceil(y - half_h)), int(np.ceil(y + half_h))
    if right <= left:
        left = int(np.floor(x + 0.5))
        right = left + 1
    if bottom <= top:
        top = int(np.floor(y + 0.5))
        bottom = top + 1
    for row in range(max(top, 0), min(bottom, rows)):
        for column in range(max(left, 0), min(right, columns)):
            p = probability[cells[row, column]]
            if p > 0.0:
                dx, dy = column - x, row - y
                moments[0] += p
                moments[1] += p * dx
                moments[2] += p * dy
                moments[3] += p * dx * dx
                moments[4] += p * dx * dy
                moments[5] += p * dy * dy
    return moments
