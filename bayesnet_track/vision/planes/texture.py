"""The plane of texture codes: what the brightness does around each pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from bayesnet_track.numerics.arrays import Array
from bayesnet_track.observation.planes import FramePair, Plane, Region
from bayesnet_track.vision.planes.gray_plane import gray


@dataclass(frozen=True)
class TextureCodes:
    """Code of each pixel, (rows, columns) uint8, below `bins`.

    Attributes:
        form: `patterns`, uniform local binary patterns of the 8 neighbours, however turned; or `gradients`,
            the direction of the gradient, one of 8, or none where it is weak.
        noise: differences up to this are none, gray levels.
    """

    form: Literal["patterns", "gradients"] = "gradients"
    noise: int = 8
    margin: ClassVar[int] = 1
    inputs: ClassVar[tuple[Plane, ...]] = ()
    is_points: ClassVar[bool] = False

    @property
    def bins(self) -> int:
        """Number of codes."""
        return 10 if self.form == "patterns" else 9

    def compute(self, frames: FramePair, inputs: tuple[Array, ...], region: Region) -> Array:
        """Codes on `region`; beyond the frame its border is repeated."""
        from bayesnet_track.vision.kernels.texture_kernels import binary_patterns, gradient_directions

        codes = np.empty((max(region.y1 - region.y0, 0), max(region.x1 - region.x0, 0)), np.uint8)
        if codes.size == 0:
            return codes
        wanted = region.grown(1)
        has = wanted.within(frames.current)
        beyond = ((has.y0 - wanted.y0, wanted.y1 - has.y1), (has.x0 - wanted.x0, wanted.x1 - has.x1))
        values = gray(has.of(frames.current.image))
        values = values if has == wanted else np.pad(values, beyond, mode="edge")
        if self.form == "patterns":
            binary_patterns(values, self.noise, codes)
        else:
            gradient_directions(values, self.noise, codes)
        return codes
