"""Cue: mean shift, which climbs to where the colours are the target's and measures x and y.

Tracking chapter, 3.3-3.5 and 3.86-3.88: histograms under an Epanechnikov kernel are compared by the
Bhattacharyya coefficient rho, each pixel is weighed sqrt(q / p), and the window moves to the weighted mean
until it rests. It starts at the prediction's mean, in a window that its spread enlarges and that then shrinks
to the target. What it says is a Gaussian message: the likelihood (3.92) at its peak, by the curvature of rho
there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from bayesnet_track.observation.cue import (
    CueDeclaration,
    CueParameters,
    Floats,
    Hypotheses,
    Measurement,
    MeasuringCue,
    Reference,
    blend_arrays,
)
from bayesnet_track.observation.planes import Plane, Planes, for_reading
from bayesnet_track.vision.planes import ColorCells, seen_cells

SHRINK = 0.7
"""Factor of the search window from one stage to the next."""
MAX_STEPS, TOLERANCE_PX = 20, 0.05
"""Largest number of shifts of each window; the search ends with a smaller shift, px."""


class MeanShiftParameters(CueParameters):
    """Parameters of mean shift."""

    space: Literal["rgb", "hsv"] = Field(
        default="rgb", description="Colour cells: levels^3 of rgb, or levels x levels x levels / 2 of hsv."
    )
    levels: int = Field(
        default=8, ge=2, le=16, multiple_of=2, description="Levels of each channel (count, even)."
    )
    reach_sd: float = Field(
        default=2.0,
        ge=0,
        description="How far beyond the box the first window reaches (sds of the prediction).",
    )
    variance: float = Field(
        default=0.02, gt=0, description="Variance of the Bhattacharyya distance sqrt(1 - rho) (eq. 3.92)."
    )
    sd_px: float = Field(
        default=1.0, gt=0, description="Error of the place that remains at a perfect match (px)."
    )
    seen_above: float = Field(
        default=0.5,
        gt=0,
        lt=1,
        description="Smallest share of the target's colours under the window at which the target is seen.",
    )


@dataclass(frozen=True)
class MeanShift:
    """Mean shift at work.

    A reference holds ``shares`` (cells,), the target's colours under the kernel; they sum to 1, or to 0 where
    nothing of the target could be seen.
    """

    parameters: MeanShiftParameters
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
        from bayesnet_track.vision.kernels.mean_shift_kernels import kernel_histogram

        cells, origin = seen_cells(planes, self._plane, box[None])
        x, y = box[:2] - origin
        shares = kernel_histogram(cells, x, y, box[2] / 2, box[3] / 2, self._plane.size)
        return {"shares": shares / max(float(shares.sum()), 1e-9)}

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        """Shares linearly (thesis eq. 2.15)."""
        return blend_arrays(old, new, rate)

    def measure(
        self, planes: Planes, hypotheses: Hypotheses, weights: Floats, reference: Reference
    ) -> Measurement | None:
        """x and y of the peak, with the inverse curvature there as covariance; None when not seen.

        Not seen: fewer than `seen_above` of the target's colours lie under the window, or rho has no peak
        that is narrower than the box. The covariance is 2 variance (-rho'')^-1 + sd_px^2, and
        ((1 - share) r)^2 for a box of radii r of which only a share is seen: the rest may be hidden on either
        side.
        """
        from bayesnet_track.vision.kernels.mean_shift_kernels import bhattacharyya_at, kernel_histogram

        p, model = self.parameters, for_reading(reference["shares"])
        path = self.climb(planes, hypotheses, weights, reference)
        if path is None:
            return None
        x, y, rx, ry = path[-1]
        cells, origin = seen_cells(planes, self._plane, hypotheses.boxes)
        peak = np.array([x, y]) - origin
        step = np.maximum(np.array([rx, ry]) / 2, 1.0)

        def rho(x_steps: float, y_steps: float) -> float:
            place = peak + step * [x_steps, y_steps]
            return bhattacharyya_at(cells, model, place[0], place[1], rx, ry)

        histogram = kernel_histogram(cells, peak[0], peak[1], rx, ry, len(model))
        share = float(np.minimum(histogram, model).sum())
        if share < p.seen_above:
            return None
        covariance = _curvature(rho, step, p.variance)
        if covariance is None or (np.diag(covariance) > np.array([rx, ry]) ** 2).any():
            return None
        covariance = covariance + np.diag(p.sd_px**2 + ((1.0 - share) * np.array([rx, ry])) ** 2)
        return Measurement(("x", "y"), np.array([x, y]), covariance, p.floor)

    def climb(
        self, planes: Planes, hypotheses: Hypotheses, weights: Floats, reference: Reference
    ) -> Floats | None:
        """(K, 4) windows it stood in: centre x, y and radii, px; None where no colour of the target is."""
        from bayesnet_track.vision.kernels.mean_shift_kernels import shift

        p, model = self.parameters, for_reading(reference["shares"])
        box = weights @ hypotheses.boxes
        sd = np.sqrt(weights @ (hypotheses.boxes[:, :2] - box[:2]) ** 2)
        cells, origin = seen_cells(planes, self._plane, hypotheses.boxes)
        (x, y), radii_at_rest = box[:2] - origin, np.maximum(box[2:] / 2, 1.0)
        radii = radii_at_rest + p.reach_sd * sd
        path = [(x, y, *radii)]
        while True:
            x, y, steps = shift(cells, model, x, y, radii[0], radii[1], TOLERANCE_PX, MAX_STEPS)
            if steps == 0:
                return None
            path.append((x, y, *radii))
            if (radii <= radii_at_rest).all():
                return np.array(path) + [*origin, 0.0, 0.0]
            radii = np.maximum(radii * SHRINK, radii_at_rest)


def _curvature(rho: Callable[[float, float], float], step: Floats, variance: float) -> Floats | None:
    """(2, 2) inverse of -d^2 log L, log L = (rho - 1) / (2 variance), by differences; None without a peak."""
    top = rho(0.0, 0.0)
    bend = np.array([rho(1.0, 0.0) + rho(-1.0, 0.0), rho(0.0, 1.0) + rho(0.0, -1.0)]) - 2.0 * top
    twist = (rho(1.0, 1.0) + rho(-1.0, -1.0) - rho(1.0, -1.0) - rho(-1.0, 1.0)) / 4.0
    hessian = np.array([[bend[0], twist], [twist, bend[1]]]) / np.outer(step, step)
    precision = -hessian / (2.0 * variance)
    if np.linalg.eigvalsh(precision).min() <= 1e-9:
        return None
    covariance = np.linalg.inv(precision)
    return np.asarray((covariance + covariance.T) / 2)


def _make(parameters: MeanShiftParameters) -> MeasuringCue:
    from bayesnet_track.vision.kernels import mean_shift_kernels  # noqa: F401  load before the first frame

    return MeanShift(parameters)


CUE = CueDeclaration(
    name="mean_shift",
    summary="Mean shift on colour histograms: measures where the target is.",
    parameters=MeanShiftParameters,
    make=_make,
    cost_ms=1.5,
    measures=True,
)
