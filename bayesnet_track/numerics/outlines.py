"""Outlines of upright ellipsoids in an image: their boxes, in closed form, and derivatives.

A target (x, y, w, h) is the ellipsoid that touches the ground in (x, y, 0), w across and h high. Its outline
is a conic, whose tangents follow from the ellipsoid's dual quadric (Hartley and Zisserman, *Multiple View
Geometry*, 2004, chapter 8). A lens bends the outline; the tangent of the bent one is found by iteration.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayesnet_track.numerics.arrays import Floats

Lens = Callable[[Floats], tuple[Floats, Floats]]
"""Pixels (..., 2) of normalised points (..., 2), and derivatives (..., 2, 2)."""


@dataclass(frozen=True)
class Tangents:
    """The four tangents of N outlines, in the order left, right, top, bottom.

    Attributes:
        bounds: (N, 4) pixels: x of the first two, y of the others.
        axes: (N, 4, 3) the quadric's axes, of one metre, seen from the tangents.
        centre: (N, 4) the quadric's centre, seen from the tangents.
        depth: (N, 4) the homogeneous third number of the tangent points, times the quadric's.
    """

    bounds: Floats
    axes: Floats
    centre: Floats
    depth: Floats


def straight(axes: Floats, origin: Floats, ground: Floats) -> tuple[Floats, Floats]:
    """Boxes (N, 4) and derivatives (N, 4, 4) of targets (N, 4) by a projection [axes origin] to pixels."""
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.compiled import plain
    from bayesnet_track.numerics.kernels.view_kernels import straight_outlines

    return straight_outlines(plain(axes), plain(origin), plain(ground))


_NORMALS = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 1.0]])
_SIDES = np.array([-1.0, 1.0, -1.0, 1.0])


def tangents(lens: Lens, axes: Floats, origin: Floats, ground: Floats) -> Tangents:
    """Tangents of the outlines of targets (N, 4), of a projection [axes origin] that `lens` maps to pixels.

    A line l = (n, -d) touches the outline if sum_k s_k^2 (m_k . l)^2 = (p . l)^2, with half axes s and the
    images m of the axes and p of the centre. In a distorted image the normal n is the gradient of the pixels'
    x or y at the tangent point, found by iteration.
    """
    halves = np.abs(ground[:, [2, 2, 3]]) / 2
    position = np.column_stack([ground[:, :2], ground[:, 3] / 2])
    centre = position @ axes.T + origin
    reached = np.sqrt(halves**2 @ axes[2] ** 2)
    depth = np.where(centre[:, 2] > reached, centre[:, 2], np.nan)
    middle = centre[:, :2] / depth[:, None]
    # (N, 3, 2): axes, seen from the centre.
    centred_axes = axes[:2].T - middle[:, None, :] * axes[2][None, :, None]
    weighted = centred_axes * (halves**2)[:, :, None]
    square = np.einsum("nki,nkj->nij", weighted, centred_axes)
    mixed = np.einsum("nki,k->ni", weighted, axes[2])
    depth_term = reached**2 - depth**2

    def touch(normals: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Offsets (N, 4) of the tangents with the normals (N, 4, 2), depths, pixels, and gradients there."""
        along = np.einsum("nbi,ni->nb", normals, mixed)
        extent = np.einsum("nbi,nij,nbj->nb", normals, square, normals)
        offset = (along - _SIDES * np.sqrt(along**2 - extent * depth_term[:, None])) / depth_term[:, None]
        points = np.einsum("nij,nbj->nbi", square, normals) - offset[..., None] * mixed[:, None]
        touch_depths = along - offset * depth_term[:, None]
        pixels, derivative = lens(middle[:, None, :] + points / touch_depths[..., None])
        return offset, touch_depths, pixels, np.einsum("nbij,bi->nbj", derivative, _NORMALS)

    derivative = lens(np.broadcast_to(middle[:, None, :], (len(ground), 4, 2)))[1]
    normals = _parallel(touch, np.einsum("nbij,bi->nbj", derivative, _NORMALS))
    offset, touch_depths, pixels, _ = touch(normals)
    tangent_axes = np.einsum("nbi,nki->nbk", normals, centred_axes) - offset[..., None] * axes[2]
    return Tangents(
        np.einsum("nbi,bi->nb", pixels, _NORMALS), tangent_axes, -offset * depth[:, None], touch_depths
    )


def _parallel(touch: Callable[[Floats], tuple[Floats, Floats, Floats, Floats]], normals: Floats) -> Floats:
    """Normals (N, 4, 2) that are the gradients of the pixels where their tangents touch; by secants."""
    slope, residual = np.zeros(normals.shape[:2]), np.zeros(normals.shape[:2])
    for round_ in range(20):
        gradient = touch(normals)[3]
        previous_slope, earlier = slope, residual
        slope, target = _slopes(normals), _slopes(gradient)
        residual = target - slope
        if not (np.abs(residual) > 1e-10).any():
            return gradient
        step = residual.copy()
        if round_:
            turned = np.abs(residual - earlier) > 1e-14
            np.divide(-residual * (slope - previous_slope), residual - earlier, out=step, where=turned)
        step = np.clip(step, -0.5, 0.5)
        normals = _NORMALS + (slope + step)[..., None] * _NORMALS[:, ::-1]
    return gradient


def _slopes(normals: Floats) -> Floats:
    """Slopes (N, 4) of normals (N, 4, 2) against the axis that they are near."""
    return np.asarray(
        np.einsum("nbi,bi->nb", normals, _NORMALS[:, ::-1]) / np.einsum("nbi,bi->nb", normals, _NORMALS)
    )


def boxes(outline: Tangents) -> Floats:
    """Boxes (N, 4) between the tangents; nan in a whole row where one is missing."""
    left, right, top, bottom = outline.bounds.T
    boxes = np.column_stack([(left + right) / 2, (top + bottom) / 2, right - left, bottom - top])
    boxes[np.isnan(boxes).any(axis=1)] = np.nan
    return boxes


def jacobian(outline: Tangents, ground: Floats) -> Floats:
    """Derivatives (N, 4, 4) of the boxes: those of the tangents' equation, by the implicit function."""
    (east, north, upright), centre = np.moveaxis(outline.axes, -1, 0), outline.centre
    width, height = ground[:, 2, None], ground[:, 3, None]
    change = np.stack(
        [
            -2 * centre * east,
            -2 * centre * north,
            width / 2 * (east**2 + north**2),
            height / 2 * upright**2 - centre * upright,
        ],
        axis=-1,
    )
    left, right, top, bottom = np.moveaxis(change / (2 * outline.depth[..., None]), 1, 0)
    rows = np.stack([(left + right) / 2, (top + bottom) / 2, right - left, bottom - top], axis=1)
    rows[np.isnan(outline.bounds).any(axis=1) | np.isnan(rows).any(axis=(1, 2))] = np.nan
    return rows
