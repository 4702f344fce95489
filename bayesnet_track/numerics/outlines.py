"""Outlines of upright ellipsoids in an image: their boxes, in closed form, and derivatives.

A target (x, y, w, h) is the ellipsoid that touches the ground in (x, y, 0), w across and h high; a target (x,
y, w, h, z) the same with its centre in (x, y, z). Its outline is a conic, whose tangents follow from the
ellipsoid's dual quadric (Hartley and Zisserman, *Multiple View Geometry*, 2004, chapter 8). A lens bends the
outline; the tangent of the bent one is found by iteration. The most probable target of a box is found by
Gauss and Newton's steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from bayesnet_track.numerics.arrays import Bools, Floats

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
    """Boxes (N, 4) and derivatives (N, 4, D) of targets (N, D) by a projection [axes origin] to pixels."""
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.compiled import plain
    from bayesnet_track.numerics.kernels.view_kernels import straight_outlines

    return straight_outlines(plain(axes), plain(origin), plain(_targets(ground)))


def _targets(ground: Floats) -> Floats:
    """The rows, refused where they are neither (x, y, w, h) nor (x, y, w, h, z)."""
    if ground.ndim != 2 or ground.shape[1] not in (4, 5):
        raise ValueError(f"targets of shape {ground.shape}; allowed: (N, 4) on the ground, (N, 5) in space")
    return ground


_NORMALS = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 1.0]])
_SIDES = np.array([-1.0, 1.0, -1.0, 1.0])


def tangents(lens: Lens, axes: Floats, origin: Floats, ground: Floats) -> Tangents:
    """Tangents of the outlines of targets (N, D), of a projection [axes origin] that `lens` maps to pixels.

    A line l = (n, -d) touches the outline if sum_k s_k^2 (m_k . l)^2 = (p . l)^2, with half axes s and the
    images m of the axes and p of the centre. In a distorted image the normal n is the gradient of the pixels'
    x or y at the tangent point, found by iteration.
    """
    halves = np.abs(_targets(ground)[:, [2, 2, 3]]) / 2
    position = np.column_stack([ground[:, :2], ground[:, 4] if ground.shape[1] > 4 else ground[:, 3] / 2])
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
    """Derivatives (N, 4, D) of the boxes: those of the tangents' equation, by the implicit function."""
    (east, north, upright), centre = np.moveaxis(outline.axes, -1, 0), outline.centre
    width, height = ground[:, 2, None], ground[:, 3, None]
    columns = [-2 * centre * east, -2 * centre * north, width / 2 * (east**2 + north**2)]
    if ground.shape[1] > 4:
        change = np.stack([*columns, height / 2 * upright**2, -2 * centre * upright], axis=-1)
    else:
        change = np.stack([*columns, height / 2 * upright**2 - centre * upright], axis=-1)
    left, right, top, bottom = np.moveaxis(change / (2 * outline.depth[..., None]), 1, 0)
    rows = np.stack([(left + right) / 2, (top + bottom) / 2, right - left, bottom - top], axis=1)
    rows[np.isnan(outline.bounds).any(axis=1) | np.isnan(rows).any(axis=(1, 2))] = np.nan
    return rows


class GroundView(Protocol):
    """Interface of a camera over the ground; all in float64, a row each."""

    @property
    def size(self) -> tuple[int, int] | None:
        """Width and height of the image, px, if known."""

    def project(self, points: Floats) -> Floats:
        """Pixels (N, 2) of points (N, 3) in m."""

    def boxes(self, ground: Floats) -> Floats:
        """Boxes (N, 4) in px, centre first, of targets (N, 4) on the ground or (N, 5) in space, in m."""

    def jacobian(self, ground: Floats) -> Floats:
        """Derivatives (N, 4, D) of `boxes`: d box_i / d ground_j."""

    def sight(self, pixels: Floats) -> tuple[Floats, Floats]:
        """Origin (3,) and directions (N, 3), one unit of depth long, of what is seen in pixels (N, 2)."""

    def ground_points(self, pixels: Floats) -> Floats:
        """Points (N, 2) of the ground, m, that are seen in pixels (N, 2)."""


@dataclass(frozen=True, eq=False)
class SeveralViews:
    """Several cameras as one, which sees a target as its boxes in all of their images: (N, 4 C) numbers.

    Places are sought along the sight of the first one. Edges at the borders of images count as seen.
    """

    cameras: Sequence[GroundView]
    size: None = None

    def project(self, points: Floats) -> Floats:
        """Pixels (N, 2 C) of points (N, 3) in m."""
        return np.concatenate([camera.project(points) for camera in self.cameras], axis=1)

    def boxes(self, ground: Floats) -> Floats:
        """Boxes (N, 4 C) in px of targets (N, D) in m."""
        return np.concatenate([camera.boxes(ground) for camera in self.cameras], axis=1)

    def jacobian(self, ground: Floats) -> Floats:
        """Derivatives (N, 4 C, D) of `boxes`."""
        return np.concatenate([camera.jacobian(ground) for camera in self.cameras], axis=1)

    def sight(self, pixels: Floats) -> tuple[Floats, Floats]:
        """Sight of the first camera."""
        return self.cameras[0].sight(pixels)

    def ground_points(self, pixels: Floats) -> Floats:
        """Points of the ground by the first camera."""
        return self.cameras[0].ground_points(pixels)


STEPS = 30
CLOSE = 1e-9

DEPTHS = np.geomspace(1.0, 3e4, 120)
"""Distances from a camera at which a target may be, in mean sizes."""


def most_probable(
    camera: GroundView, boxes: Floats, variances: Floats, start: tuple[Floats, Floats]
) -> tuple[Floats, Floats, Floats, Bools]:
    """States (N, D) of targets seen as boxes (N, 4), their covariances, R^-1, and which of them are usable.

    Of `SeveralViews` boxes have 4 C numbers. The errors of boxes have variances (N, 4), infinite of what was
    not measured, and those of edges that were cut. `start` is the mean and the sd of each number of a state
    before it is seen, an infinite sd of what nothing is known of: 4 of a target on the ground, 5 in space.
    The maximum is sought on the ground from the foot of a box, in space from the most probable place along
    the ray through its centre; the covariance is (J' R^-1 J + P^-1)^-1.
    """
    means, prior, precision = start[0], start[1] ** -2.0, _precision(camera, boxes, variances)
    find = _stand_on_ground if len(means) == 4 else _hang_in_space
    states = find(camera, boxes, precision, (means, prior))
    information, pull = _normal(camera, states, boxes, precision, (means, prior))
    for _ in range(STEPS):
        step = _solve(information, pull)
        states[:, :2] += step[:, :2]
        states[:, 2:4] = np.maximum(states[:, 2:4] + step[:, 2:4], states[:, 2:4] / 4)  # sizes stay positive
        states[:, 4:] += step[:, 4:]
        information, pull = _normal(camera, states, boxes, precision, (means, prior))
        if not (np.abs(step) > CLOSE).any():
            break
    covariances = _inverse(information)
    converged = np.abs(_solve(information, pull)).max(axis=1) < 1e-4
    usable = converged & np.isfinite(states).all(axis=1) & np.isfinite(covariances).all(axis=(1, 2))
    return states, covariances, precision, usable


def _stand_on_ground(
    camera: GroundView, boxes: Floats, precision: Floats, start: tuple[Floats, Floats]
) -> Floats:
    """(N, 4) states that stand where the feet of boxes are."""
    means, prior = start
    feet = camera.ground_points(np.column_stack([boxes[:, 0], boxes[:, 1] + boxes[:, 3] / 2]))
    states = np.column_stack([feet, np.tile(means[2:], (len(boxes), 1))])
    first = camera.boxes(states)
    for k in (2, 3):
        if prior[k] == 0.0:
            states[:, k] *= boxes[:, k] / first[:, k]
    return states


def _hang_in_space(
    camera: GroundView, boxes: Floats, precision: Floats, start: tuple[Floats, Floats]
) -> Floats:
    """(N, 5) states of the usual size, most probable along the rays through centres of boxes."""
    means, prior = start
    origin, rays = camera.sight(boxes[:, :2])
    places = origin + rays[:, None] * (means[2] * DEPTHS)[:, None]
    count, depths = places.shape[:2]
    sizes = np.broadcast_to(means[2:4], (count, depths, 2))
    states = np.concatenate([places[..., :2], sizes, places[..., 2:]], axis=2)
    residual = boxes[:, None] - camera.boxes(states.reshape(-1, 5)).reshape(count, depths, -1)
    d2 = np.einsum("nki,nij,nkj->nk", residual, precision, residual) + ((states - means) ** 2) @ prior
    nearest = np.argmin(np.where(np.isfinite(d2), d2, np.inf), axis=1)
    return np.asarray(states[np.arange(count), nearest])


def _normal(
    camera: GroundView, states: Floats, boxes: Floats, precision: Floats, start: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """(N, K, K) information, and (N, K) slopes of the log density."""
    means, prior = start
    slopes = camera.jacobian(states)
    weighted = np.swapaxes(slopes, 1, 2) @ precision
    residual = boxes - camera.boxes(states)
    pull = (weighted @ residual[:, :, None])[:, :, 0] + prior * (means - states)
    return weighted @ slopes + np.diag(prior), pull


def _inverse(information: Floats) -> Floats:
    """(N, K, K) inverses; NaN where there is none."""
    scale = np.sqrt(np.diagonal(information, axis1=1, axis2=2))
    scaled = information / (scale[:, :, None] * scale[:, None, :])
    usable = np.isfinite(scaled).all(axis=(1, 2))
    scaled[~usable] = np.eye(scale.shape[1])
    usable &= np.abs(np.linalg.det(scaled)) > 1e-10
    scaled[~usable] = np.eye(scale.shape[1])
    inverse = np.linalg.inv(scaled) / (scale[:, :, None] * scale[:, None, :])
    return np.where(usable[:, None, None], (inverse + np.swapaxes(inverse, 1, 2)) / 2, np.nan)


def _solve(information: Floats, pull: Floats) -> Floats:
    return np.asarray((_inverse(information) @ pull[:, :, None])[:, :, 0])


AT_BORDER = 1.5
"""An edge of a box that is so many px from the image's border at most was cut there."""

_EDGES = np.array([[0.5, 0.0, -1.0, 0.0], [0.0, 0.5, 0.0, -1.0], [0.5, 0.0, 1.0, 0.0], [0.0, 0.5, 0.0, 1.0]])
"""By how much x, y, w, h of a box change with its left, upper, right and lower edge."""


def cut_covariance(camera: GroundView, boxes: Floats) -> Floats:
    """(N, K, K) further errors of boxes (N, K) with edges at the border of the image, where they were cut.

    Such an edge is not seen: it may be anywhere beyond, with an sd of the image's own side. A box that goes
    on beyond the border was not cut.
    """
    cut = np.zeros((len(boxes), boxes.shape[1], boxes.shape[1]))
    if camera.size is None:
        return cut
    size = np.array(camera.size, dtype=np.float64)
    low, high = boxes[:, :2] - boxes[:, 2:] / 2.0, boxes[:, :2] + boxes[:, 2:] / 2.0
    is_cut = np.abs(np.concatenate([low + 0.5, high - size + 0.5], axis=1)) <= AT_BORDER
    if is_cut.any():
        for k, edge in enumerate(_EDGES):
            cut[is_cut[:, k]] += size[k % 2] ** 2 * np.outer(edge, edge)
    return cut


def _precision(camera: GroundView, boxes: Floats, variances: Floats) -> Floats:
    """(N, K, K) inverse covariances of boxes with errors of variances (N, K): 0 of what is not measured."""
    each = np.eye(boxes.shape[1])
    if np.isfinite(variances).all():
        return np.asarray(np.linalg.inv(variances[:, :, None] * each + cut_covariance(camera, boxes)))
    return np.asarray((1.0 / variances)[:, :, None] * each)
