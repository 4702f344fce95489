"""Cue: CamShift, mean shift on the back-projection of hue with a window that takes the target's size.

Tracking chapter, 3.3-3.4. The back-projection says how much likelier a pixel's hue is inside the box than in
the ring around it; the chapter's plain histogram takes every background of a similar hue for the target, and
the corners of the box as well. The window moves to the mean, and its size follows the second moments, in
proportion to what they were when the target was learnt: measures x, y, w, h.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
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
from bayesnet_track.observation.planes import Plane, Planes
from bayesnet_track.vision.planes import HueBins, seen_cells

WINDOW = 1.3
"""The window's side in sides of the target: room to grow."""
RING = 1.8
"""Outer side of the ring that counts as background, in sides of the target."""
RARE = 0.01
"""A hue of so small a share of the pixels says little about whose it is."""
CONTRAST_ABOVE = 1.5
"""Smallest ratio of the back-projection in the box to that in the ring around it."""
MAX_STEPS, TOLERANCE_PX = 20, 0.05
"""Largest number of shifts of the window; the search ends with a smaller shift, px."""


class CamShiftParameters(CueParameters):
    """Parameters of CamShift."""

    bins: int = Field(
        default=32, ge=4, le=128, multiple_of=2, description="Bins round the hue circle (count, even)."
    )
    min_chroma: int = Field(
        default=30,
        ge=1,
        le=255,
        description="Pixels with a smaller difference between largest and smallest channel have no hue (of "
        "255).",
    )
    reach_sd: float = Field(
        default=2.0,
        ge=0,
        description="How far beyond the box the first window reaches (sds of the prediction).",
    )
    sd_box: float = Field(
        default=0.05, gt=0, description="Error of the place at a full match (share of the box's side)."
    )
    sd_size: float = Field(
        default=0.1, gt=0, description="Error of width and height at a full match (share of each)."
    )
    change_max: float = Field(
        default=1.3, gt=1, description="Largest change of a side against the prediction (factor)."
    )
    seen_above: float = Field(
        default=0.4,
        gt=0,
        lt=1,
        description="Smallest back-projection in the box at which the target is seen, as a share of that when"
        " learnt.",
    )


@dataclass(frozen=True)
class RestingWindow:
    """Window at rest.

    Attributes:
        box: (4,) centre box, px.
        axis: direction of the longer axis of the back-projection's ellipse, radians from x toward y.
        density: mean back-projection in the box, which is 0 outside the picture.
        ring: mean back-projection in the part of the ring around it that the hypotheses cover.
        mass: sum of the back-projection in the box.
        path: (K, 4) centre boxes: the prediction, then those that the windows came from.
    """

    box: Floats
    axis: float
    mass: float
    density: float
    ring: float
    path: Floats


@dataclass(frozen=True)
class CamShift:
    """CamShift at work.

    A reference holds ``inside`` and ``around`` (bins + 1,), shares of the pixels in the box and in the ring
    by hue, the last without one; ``density`` (), the mean back-projection in the box; ``spread`` (2,), sds of
    the back-projection in the window, as shares of the box's sides.
    """

    parameters: CamShiftParameters
    context: ClassVar[float] = 0.5

    @property
    def _plane(self) -> HueBins:
        return HueBins(self.parameters.bins, self.parameters.min_chroma)

    @property
    def needs(self) -> tuple[Plane, ...]:
        """Hue in bins."""
        return (self._plane,)

    def learn(self, planes: Planes, box: Floats) -> Reference:
        """Hues of the box and of the ring around it, and what the back-projection makes of them."""
        from bayesnet_track.vision.kernels.mean_shift_kernels import window_moments

        cells, origin = self._cells(planes, (box * [1, 1, 2, 2])[None])
        x, y = box[:2] - origin
        box_counts, ring_counts = (
            np.array(
                [
                    window_moments(cells, indicator, x, y, side * box[2] / 2, side * box[3] / 2)[0]
                    for indicator in np.eye(self.parameters.bins + 1)
                ]
            )
            for side in (1.0, RING)
        )
        ring_counts = ring_counts - box_counts
        reference = {
            "inside": box_counts / max(float(box_counts.sum()), 1.0),
            "around": ring_counts / max(float(ring_counts.sum()), 1.0),
        }
        probability = _back_projection(reference)
        density = window_moments(cells, probability, x, y, box[2] / 2, box[3] / 2)[0] / (box[2] * box[3])
        moments = window_moments(cells, probability, x, y, *(WINDOW * box[2:] / 2))
        spread = np.sqrt(np.maximum(np.diag(_covariance(moments)), 1.0 / 12.0)) / box[2:]
        return {**reference, "density": np.array(density), "spread": spread}

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        """Linearly (thesis eq. 2.15)."""
        return blend_arrays(old, new, rate)

    def measure(
        self, planes: Planes, hypotheses: Hypotheses, weights: Floats, reference: Reference
    ) -> Measurement | None:
        """x, y, w, h with stated errors; None when not seen.

        Where only a share of the back-projection is seen that the predicted box should hold, the rest may be
        hidden on either side: errors grow by (1 - share) of half a side, those of the sides by a whole one.
        """
        p = self.parameters
        window = self.climb(planes, hypotheses, weights, reference)
        if window is None or float(reference["density"]) <= 0.0:
            return None
        share = min(window.mass / (float(reference["density"]) * float(np.prod(window.path[0, 2:]))), 1.0)
        if share < p.seen_above or window.density < CONTRAST_ABOVE * window.ring:
            return None
        sides, lost = window.box[2:], (1.0 - share) * window.path[0, 2:]
        place = np.maximum(p.sd_box * sides, 0.5) ** 2 + (lost / 2) ** 2
        size = np.maximum(p.sd_size * sides, 1.0) ** 2 + lost**2
        return Measurement(("x", "y", "w", "h"), window.box, np.diag([*place, *size]), p.floor)

    def climb(
        self, planes: Planes, hypotheses: Hypotheses, weights: Floats, reference: Reference
    ) -> RestingWindow | None:
        """The window at rest; None where the back-projection is empty."""
        from bayesnet_track.vision.kernels.mean_shift_kernels import window_moments

        p = self.parameters
        predicted = weights @ hypotheses.boxes
        sd = np.sqrt(weights @ (hypotheses.boxes[:, :2] - predicted[:2]) ** 2)
        cells, origin = self._cells(planes, hypotheses.boxes)
        probability = _back_projection(reference)
        centre, sides = predicted[:2] - origin, predicted[2:] + 2.0 * p.reach_sd * sd
        low, high = predicted[2:] / p.change_max, predicted[2:] * p.change_max
        path, spread = [np.concatenate([centre, predicted[2:]])], np.eye(2)
        for _ in range(MAX_STEPS):
            half = WINDOW * sides / 2
            moments = window_moments(cells, probability, centre[0], centre[1], half[0], half[1])
            if moments[0] <= 0.0:
                return None
            spread = _covariance(moments)
            grown = np.sqrt(np.maximum(np.diag(spread), 1.0 / 12.0)) / reference["spread"]
            shift, sides = moments[1:3] / moments[0], np.clip(grown, low, np.maximum(sides, low))
            centre = centre + shift
            path.append(np.concatenate([centre, sides]))
            if shift @ shift < TOLERANCE_PX**2 and np.allclose(path[-1], path[-2], atol=TOLERANCE_PX):
                break
        sides = np.minimum(sides, high)
        window_sums, wide, inner, outer = (
            window_moments(cells, image, centre[0], centre[1], *(side * sides / 2))[0]
            for image in (probability, np.ones_like(probability))
            for side in (1.0, RING)
        )
        windows = np.array(path)
        windows[:, :2] += origin
        return RestingWindow(
            np.concatenate([centre + origin, sides]),
            0.5 * float(np.arctan2(2.0 * spread[0, 1], spread[0, 0] - spread[1, 1])),
            window_sums,
            window_sums / float(np.prod(sides)),
            (wide - window_sums) / max(outer - inner, 1.0),
            windows,
        )

    def _cells(self, planes: Planes, boxes: Floats) -> tuple[NDArray[np.uint16], Floats]:
        cells, origin = seen_cells(planes, self._plane, boxes)
        return cells.astype(np.uint16), origin


def _back_projection(reference: Reference) -> Floats:
    """(bins + 1,) max(0, q - b) / (q + b + RARE), q inside the box and b around it; 0 without a hue."""
    box_shares, ring_shares = reference["inside"], reference["around"]
    contrast = np.maximum(box_shares - ring_shares, 0.0) / (box_shares + ring_shares + RARE)
    contrast[-1] = 0.0
    return np.asarray(contrast)


def _covariance(moments: Floats) -> Floats:
    """(2, 2) covariance of the place under a window's moments (6,)."""
    if moments[0] <= 0.0:
        return np.zeros((2, 2))
    mean = moments[1:3] / moments[0]
    second = np.array([[moments[3], moments[4]], [moments[4], moments[5]]]) / moments[0]
    return np.asarray(second - np.outer(mean, mean))


def _make(parameters: CamShiftParameters) -> MeasuringCue:

    return CamShift(parameters)


CUE = CueDeclaration(
    name="camshift",
    summary="CamShift on the back-projection of hue: measures place and size.",
    parameters=CamShiftParameters,
    make=_make,
    needs_color=True,
    cost_ms=2.0,
    measures=True,
)
