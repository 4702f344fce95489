"""The second eye of a scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.planes import RightEye, StereoGeometry
from bayesnet_track.sources.scenes.render import Movie


@dataclass(frozen=True, eq=False)
class StereoView:
    """The second eye of a scene, and its true depth.

    Attributes:
        right: the right pictures.
        geometry: the pair's.
        background_m: (H, W) depth of the left picture's background.
        paths: centre boxes (n, 4) in the left picture of everything that moves, the nearest last.
        depths_m: (n,) depth of each of these.
    """

    right: Movie
    geometry: StereoGeometry
    background_m: Floats
    paths: tuple[Floats, ...]
    depths_m: tuple[Floats, ...]

    def eye(self, index: int) -> RightEye:
        """What a frame carries of it."""
        return RightEye(self.right[index], self.geometry)

    def true_depth(self, index: int) -> Floats:
        """(H, W) depth in m of the left picture's pixels (of their centres)."""
        depth = self.background_m.copy()
        rows, columns = np.ogrid[: depth.shape[0], : depth.shape[1]]
        for path, depths in zip(self.paths, self.depths_m, strict=True):
            x, y, w, h = path[index]
            depth[(np.abs(columns - x) <= w / 2) & (np.abs(rows - y) <= h / 2)] = depths[index]
        return depth
