"""Where a target may reappear, and how it is looked for there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.resampling import systematic


@dataclass(frozen=True, eq=False)
class Places:
    """A mixture of uniform densities on rectangles, all inside the frame.

    Attributes:
        low: (M, 2) least x and y.
        high: (M, 2) largest x and y.
        shares: (M,) of the rectangles, summing to 1.
    """

    low: Floats
    high: Floats
    shares: Floats

    def draw(self, size: int, rng: np.random.Generator) -> Floats:
        """(size, 2) points in px, in random order: which hypothesis is sent where depends on nothing."""
        chosen = rng.permutation(systematic(self.shares, size, rng))
        return np.asarray(self.low[chosen] + rng.random((size, 2)) * (self.high - self.low)[chosen])

    def density(self, points: Floats) -> Floats:
        """(N,) per px^2 at points (N, 2)."""
        x, y = points.T[:, :, None]
        inside = (x >= self.low[:, 0]) & (x < self.high[:, 0]) & (y >= self.low[:, 1]) & (y < self.high[:, 1])
        extent = (self.high - self.low).T
        return np.asarray(inside @ (self.shares / (extent[0] * extent[1])))


@dataclass(frozen=True, eq=False)
class Search:
    """How reappearing is looked for in one frame.

    Attributes:
        hypotheses: share of the hypotheses that look.
        by: uniform, agents, or the detector's name.
        probes: boxes that the net's agents are asked about; 0 for none.
        boxes: (M, 4) where a detector sees something.
        scores: (M,) how surely.
        ud_px2: UD of the last frame.
        above_px2: level above which the belief is unsure.
        fit: what fits without the search, as a share of the usual fit; None when it does not matter.
        below_fit: level below which that calls for the search.
    """

    hypotheses: float
    by: str
    probes: int
    boxes: Floats
    scores: Floats
    ud_px2: float
    above_px2: float
    fit: float | None = None
    below_fit: float | None = None


@dataclass(frozen=True, eq=False)
class Within:
    """The part of the frame in which a target that was lost may reappear by now, as large as it was.

    Attributes:
        low: (2,) least x and y of its centre, px.
        high: (2,) largest x and y.
        size: (2,) w and h of the box that held it last, px.
        half_px: how far from that box.
        cell_box: side of the cells about which agents are asked, in sqrt(w h).
    """

    low: Floats
    high: Floats
    size: Floats
    half_px: float
    cell_box: float = 0.5

    @classmethod
    def around(cls, box: Floats, half_px: float, width: int, height: int, cell_box: float = 0.5) -> Within:
        """The square around the centre box (4,) with half its side in px, as far as the frame goes."""
        half, most = max(half_px, 2.0), np.array([width - 1.0, height - 1.0])
        centre = np.clip(box[:2], 0.0, most)
        return cls(np.maximum(centre - half, 0.0), np.minimum(centre + half, most), box[2:4], half, cell_box)
