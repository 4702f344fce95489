"""A room as one eye of a pair sees it: textured floor and wall, and a pane before the wall."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.planes import StereoGeometry

FINER = 2
"""Rays per pixel and direction."""
STRIPES = (60.0, 200.0)
"""Gray levels of a pane's pattern."""


@dataclass(frozen=True)
class Pane:
    """A pane parallel to the picture, with a pattern that repeats, before the wall.

    Attributes:
        left_m, right_m: its edges.
        depth_m: its distance.
        period_m: width of one stripe and the gap beside it.
        opacity: share of the stripes in what is seen; the rest is what is behind the pane.
    """

    left_m: float
    right_m: float
    depth_m: float
    period_m: float
    opacity: float


@dataclass(frozen=True, eq=False)
class Room:
    """A floor and a wall with random texture, and maybe a pane.

    Attributes:
        wall_m: distance of the wall.
        camera_height_m: height of both cameras above the floor, which they look along.
        wall, floor: (rows, columns, 3) BGR values on a lattice of `cell_m`, repeated.
        cell_m: its spacing; values in between are bilinear.
        pane: a pane, or None.
    """

    wall_m: float
    camera_height_m: float
    wall: Floats
    floor: Floats
    cell_m: float
    pane: Pane | None = None

    def seen(self, geometry: StereoGeometry, eye_m: float, width: int, height: int) -> tuple[Floats, Floats]:
        """The picture (H, W, 3) BGR of the eye at x = `eye_m`, and the depth (H, W) in m of its pixels."""
        at = (np.arange(FINER) + 0.5) / FINER - 0.5
        columns = (np.arange(width)[:, None] + at).ravel()
        rows = (np.arange(height)[:, None] + at).ravel()
        seen, _ = self._rays(geometry, eye_m, columns, rows)
        centres = np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64)
        _, depth = self._rays(geometry, eye_m, *centres)
        return seen.reshape(height, FINER, width, FINER, 3).mean(axis=(1, 3)), depth

    def _rays(
        self, geometry: StereoGeometry, eye_m: float, columns: Floats, rows: Floats
    ) -> tuple[Floats, Floats]:
        """Colour (rows, columns, 3) and depth (rows, columns) where each ray ends."""
        across = (columns - geometry.centre_x_px) / geometry.focal_px
        down = (rows - geometry.centre_y_px) / geometry.focal_px
        with np.errstate(divide="ignore"):
            depth_of_row = np.where(down > 0, self.camera_height_m / down, np.inf)
        on_floor = depth_of_row < self.wall_m
        seen, depth = np.empty((len(rows), len(columns), 3)), np.empty((len(rows), len(columns)))
        depth[:] = np.minimum(depth_of_row, self.wall_m)[:, None]
        x = eye_m + across * depth
        seen[on_floor] = self._sampled(self.floor, x[on_floor], depth[on_floor])
        wall = down[~on_floor, None] * np.full(len(columns), self.wall_m)
        seen[~on_floor] = self._sampled(self.wall, x[~on_floor], wall)
        if self.pane is not None:
            pane = self.pane
            x = eye_m + across * pane.depth_m
            before = (x >= pane.left_m) & (x < pane.right_m) & (depth > pane.depth_m)
            stripe = np.where(x / pane.period_m % 1.0 < 0.5, *STRIPES)[None, :, None]
            mixed = pane.opacity * stripe + (1.0 - pane.opacity) * seen
            seen = np.where(before[..., None], mixed, seen)
            depth = np.where(before, pane.depth_m, depth)
        return seen, depth

    def _sampled(self, texture: Floats, u: Floats, v: Floats) -> Floats:
        """Bilinear values of `texture` at (u, v) in m."""
        rows, columns = texture.shape[:2]
        (u0, du), (v0, dv) = np.divmod(u / self.cell_m, 1.0), np.divmod(v / self.cell_m, 1.0)
        i, j = u0.astype(np.int64) % columns, v0.astype(np.int64) % rows
        i1, j1 = (i + 1) % columns, (j + 1) % rows
        du, dv = du[..., None], dv[..., None]
        upper = (1 - du) * texture[j, i] + du * texture[j, i1]
        lower = (1 - du) * texture[j1, i] + du * texture[j1, i1]
        return np.asarray((1 - dv) * upper + dv * lower)
