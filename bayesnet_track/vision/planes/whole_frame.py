"""The whole picture as a plane, for agents that look beyond the boxes of the hypotheses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from bayesnet_track.numerics.arrays import Array
from bayesnet_track.observation.planes import FramePair, Plane, Region


@dataclass(frozen=True)
class WholeFrame:
    """The frame's own picture, (H, W, 3) uint8 BGR, not copied and never cut: in frame coordinates."""

    margin: ClassVar[None] = None
    inputs: ClassVar[tuple[Plane, ...]] = ()
    is_points: ClassVar[bool] = True

    def compute(self, frames: FramePair, inputs: tuple[Array, ...], region: Region) -> Array:
        """The picture, whatever the region."""
        return frames.current.image
