"""The planes on which an agent looks at many targets: a crop for each, or the whole frame for all."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.observation.planes import MANY, Plane, Planes, Region


def planes_of_each(
    work: FrameContext,
    needs: Iterable[Plane],
    boxes: Floats,
    starts: Ints,
    grow: float = 0.0,
    share: bool = False,
) -> list[Planes]:
    """For each target planes that hold its boxes, each grown by `grow` of its size per side.

    Those of target t are `starts[t]` to `starts[t + 1] - 1` of the boxes (N, 4), one at least.

    With `share`, the same of the whole frame for all where their crops would take as long: planes do not
    depend on where they are cut.
    """
    from bayesnet_track.numerics.kernels.box_kernels import crops_of_each

    started, frame = work.engine.clock(), work.frame
    corners = crops_of_each(boxes, starts, grow, frame.width, frame.height)
    areas = np.clip(corners[:, 2:] - corners[:, :2], 0, None).prod(axis=1)
    whole, needs = Region(0, 0, frame.width, frame.height), tuple(needs)
    if share and len(corners) > 1 and (len(corners) > MANY or 2 * areas.sum() > whole.area):
        found = [work.cache.planes(needs, whole)] * len(corners)
    else:
        found = [work.cache.planes(needs, Region(*own)) for own in corners.tolist()]
    work.charge("planes", started)
    return found
