"""The planes on which the agents of many targets look: those of the whole frame, or of a crop for each."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.observation.planes import MANY, Plane, Planes, Region

FARTHEST = 2.0**30
"""Pixels from the frame's corner at which a box is cut."""


def planes_of_each(
    work: FrameWork, needs: Iterable[Plane], boxes: Floats, starts: Ints, grow: float = 0.0
) -> list[Planes]:
    """For each target planes that hold its boxes, each grown by `grow` of its size per side.

    Those of target t are `starts[t]` to `starts[t + 1] - 1` of the boxes (N, 4), one at least.

    The same of the whole frame for all where their crops would take as long: planes do not depend on where
    they are cut.
    """
    started, frame = work.engine.clock(), work.frame
    reach, firsts = boxes[:, 2:] * (0.5 + grow), starts[:-1]
    low, high = np.minimum.reduceat(boxes[:, :2] - reach, firsts), boxes[:, :2] + reach
    low = np.floor(np.clip(low + 0.5, -FARTHEST, FARTHEST))
    high = np.ceil(np.clip(np.maximum.reduceat(high, firsts) + 0.5, -FARTHEST, FARTHEST))
    edges = np.hstack([low, high]).astype(np.int64)
    corners = np.clip(edges, 0, [frame.width, frame.height, frame.width, frame.height])
    areas = np.clip(corners[:, 2:] - corners[:, :2], 0, None).prod(axis=1)
    whole = Region(0, 0, frame.width, frame.height)
    needs = tuple(needs)
    if len(edges) > MANY or 2 * areas.sum() > whole.area:
        found = [work.cache.planes(needs, whole)] * len(edges)
    else:
        found = [work.cache.planes(needs, Region(*own)) for own in corners.tolist()]
    work.charge("planes", started)
    return found
