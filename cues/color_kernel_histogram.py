"""Cue: the histogram of colours inside each hypothesis, its middle counting most.

Tracking chapter, 3.83-3.88 and 3.92, corrected: a histogram over cells of RGB or HSV under an Epanechnikov
kernel, compared by the Bhattacharyya coefficient rho; the likelihood is exp(-(1 - rho) / (2 sigma^2)). It
knows shades, which `color_histogram` does not, and where the middle is; colours in neighbouring cells are as
different to it as any.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from bayesnet_track.numerics.log_weights import SHARPER, factor_of, relax, sharpen
from bayesnet_track.observation.cue import (
    Cue,
    CueDeclaration,
    Floats,
    Hypotheses,
    Reference,
    SizedCueParameters,
    blend_arrays,
    blend_sizes,
    floored,
    log_size_penalty,
)
from bayesnet_track.observation.planes import Plane, Planes, for_reading
from bayesnet_track.vision.planes import ColorCells

STEP = 0.7
"""Factor of a local action on the variance."""


class ColorKernelHistogramParameters(SizedCueParameters):
    """Parameters of the colour histogram under a kernel."""

    space: Literal["rgb", "hsv"] = Field(
        default="rgb", description="Colour cells: levels^3 of rgb, or levels x levels x levels / 2 of hsv."
    )
    levels: int = Field(
        default=8, ge=2, le=16, multiple_of=2, description="Levels of each channel (count, even)."
    )
    variance: float = Field(
        default=0.02, gt=0, description="Variance of the Bhattacharyya distance sqrt(1 - rho) (eq. 3.92)."
    )
    pixels: int = Field(
        default=4096,
        ge=16,
        description="Of a larger box every second, third, ... row and column is taken (pixels).",
    )


@dataclass(frozen=True)
class ColorKernelHistogram:
    """The colour histogram under a kernel at work.

    A reference holds ``shares`` (cells,), the target's colours under the kernel, which sum to 1, or to 0
    where nothing of it could be seen; ``variance`` () of the distance; ``size`` (2,), w and h in px;
    ``sharper`` (), a factor on the variance.
    """

    parameters: ColorKernelHistogramParameters
    context: ClassVar[float] = 0.0

    @property
    def _plane(self) -> ColorCells:
        return ColorCells(self.parameters.space, self.parameters.levels)

    @property
    def needs(self) -> tuple[Plane, ...]:
        """Colour in cells."""
        return (self._plane,)

    def learn(self, planes: Planes, box: Floats) -> Reference:
        """The colours of the visible part of the ellipse in `box`."""
        from bayesnet_track.vision.kernels.mean_shift_kernels import kernel_shares

        r = planes.region
        cells = for_reading(planes[self._plane])
        shares = kernel_shares(cells, r.x0, r.y0, box, self.parameters.pixels, self._plane.size)
        return {
            "shares": shares,
            "variance": np.array(self.parameters.variance),
            "size": np.array(box[2:], dtype=np.float64),
            SHARPER: np.array(1.0),
        }

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        """Shares and variance linearly (thesis eq. 2.15), the size in its logarithm.

        A reference without colours gives way to one that has them.
        """
        if rate > 0.0 and not old["shares"].any():
            return new
        if rate < 1.0 and not new["shares"].any():
            return old
        return {**blend_arrays(old, new, rate), **relax(old, new, rate), "size": blend_sizes(old, new, rate)}

    def log_likelihood(self, planes: Planes, hypotheses: Hypotheses, reference: Reference) -> Floats:
        """-(1 - rho) / (2 variance), chapter 3.92, corrected, with the size penalty, over the floor.

        As printed (3.92) divides by 2 sigma where its text says variance, and has a factor that cancels.
        """
        p = self.parameters
        rho = self.coefficients(planes, hypotheses.boxes, reference)
        size = log_size_penalty(hypotheses.boxes, reference["size"], p.sd_log_area, p.sd_log_aspect)
        variance = float(reference["variance"]) * factor_of(reference)
        return floored((rho - 1.0) / (2.0 * variance) + size, p.floor)

    def adapt(self, reference: Reference, attempt: int) -> Reference | None:
        """A sharper likelihood; None at once when the reference has no colours."""
        return sharpen(reference, attempt, STEP) if reference["shares"].any() else None

    def coefficients(self, planes: Planes, boxes: Floats, reference: Reference) -> Floats:
        """(N,) Bhattacharyya coefficient of each centre box (N, 4) with the reference, 0..1."""
        from bayesnet_track.vision.kernels.mean_shift_kernels import coefficients

        cells, r = for_reading(planes[self._plane]), planes.region
        return coefficients(cells, r.x0, r.y0, boxes, self.parameters.pixels, np.sqrt(reference["shares"]))


def _make(parameters: ColorKernelHistogramParameters) -> Cue:
    from bayesnet_track.vision.kernels import mean_shift_kernels  # noqa: F401  load first

    return ColorKernelHistogram(parameters)


CUE = CueDeclaration(
    name="color_kernel_histogram",
    summary="Colour histogram weighted towards the middle of the box, by the Bhattacharyya coefficient.",
    parameters=ColorKernelHistogramParameters,
    make=_make,
    cost_ms=7.7,
    adapts=True,
)
