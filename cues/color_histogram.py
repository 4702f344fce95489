"""Cue: the hue histogram inside each hypothesis (thesis 3.1.1, corrected).

A histogram has a chromatic part (hue in bins) and an achromatic share. Two of them are compared by the cost
of moving one into the other: round the hue circle, a fixed price between colour and no colour, the full
price for pixels outside the frame. Thesis eq. 3.2 sums along a line instead, which depends on where hue
starts, and normalises by the coloured pixels only, which makes every part of a one-colour target perfect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from bayesnet_track.numerics.arrays import Ints
from bayesnet_track.numerics.log_weights import SHARPER, factor_of, relax, relax_all, sharpen
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
    log_logistic,
    log_size_penalty,
)
from bayesnet_track.observation.geometry import HALF_OVERLAP, box_pixels, crops_of, distinct_pixels
from bayesnet_track.observation.likelihoods import ReferenceRows, column
from bayesnet_track.observation.planes import Plane, Planes
from bayesnet_track.vision.planes import HueBins

STEP = 0.7
"""Factor of a local action on alpha."""


class ColorHistogramParameters(SizedCueParameters):
    """Parameters of the hue histogram."""

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
    achromatic_distance: float = Field(
        default=0.5,
        gt=0,
        le=1,
        description="Distance from no colour to any hue, as a share of the distance of opposite hues.",
    )
    alpha_min: float = Field(
        default=0.03,
        gt=0,
        le=1,
        description="Smallest distance at which the likelihood halves (share of the distance of opposite "
        "hues).",
    )


@dataclass(frozen=True)
class ColorHistogram:
    """The hue histogram at work.

    A reference holds ``shares`` (bins + 1,), the share of the box's visible pixels in each hue bin and, last,
    without colour; ``alpha`` (), the distance at which the likelihood halves; ``size`` (2,), w and h in px;
    ``sharper`` (), a factor on alpha.
    """

    parameters: ColorHistogramParameters
    context: ClassVar[float] = 0.5  # boxes half a box away

    @cached_property
    def _plane(self) -> HueBins:
        return HueBins(self.parameters.bins, self.parameters.min_chroma)

    @cached_property
    def needs(self) -> tuple[Plane, ...]:
        """Hue in bins."""
        return (self._plane,)

    def learn(self, planes: Planes, box: Floats) -> Reference:
        """The histogram of the visible part of `box`, and alpha from its surroundings.

        Alpha is half the mean distance of the four boxes that overlap it by 50 % (thesis eq. 3.3 and figure
        3.2, corrected), of those inside the frame where there are any.
        """
        from bayesnet_track.vision.kernels.histogram_kernels import color_distances

        boxes = np.empty((5, 4))  # the box itself, then those around it
        boxes[:] = box
        boxes[1:, :2] += HALF_OVERLAP * box[2:]
        counts, visible, nominal = self._count(planes, boxes)
        bins, pixel_count = self.parameters.bins, max(int(visible[0]), 1)
        shares = np.zeros(bins + 1)
        shares[:bins] = counts[0] / pixel_count
        shares[bins] = 1.0 - shares[:bins].sum()
        distances, outside_shares = color_distances(
            counts[1:], visible[1:], nominal[1:], shares, self.parameters.achromatic_distance
        )
        is_inside = outside_shares == 0
        alpha = 0.5 * float(distances[is_inside if is_inside.any() else slice(None)].mean())
        return {
            "shares": shares,
            "alpha": np.array(max(alpha, self.parameters.alpha_min)),
            "size": np.array(box[2:], dtype=np.float64),
            SHARPER: np.array(1.0),
        }

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        """Shares and alpha linearly (eq. 2.15), the size in its logarithm."""
        return {**blend_arrays(old, new, rate), **relax(old, new, rate), "size": blend_sizes(old, new, rate)}

    def log_likelihood(self, planes: Planes, hypotheses: Hypotheses, reference: Reference) -> Floats:
        """-log(1 + exp(4 (d - alpha) / alpha)), 0 at d = 0, times the size penalty, over the floor.

        Thesis eq. 3.3, corrected, and divided by its value 1 / (1 + e^-4) at distance 0.
        """
        p, alpha = self.parameters, float(reference["alpha"]) * factor_of(reference)
        distances, _ = self._distances(planes, hypotheses.boxes, reference["shares"])
        similarity = log_logistic(distances, alpha)
        size = log_size_penalty(hypotheses.boxes, reference["size"], p.sd_log_area, p.sd_log_aspect)
        return floored(similarity + size, p.floor)

    def adapt(self, reference: Reference, attempt: int) -> Reference | None:
        """A sharper likelihood."""
        return sharpen(reference, attempt, STEP)

    def log_likelihood_of_each(
        self, planes: Sequence[Planes], hypotheses: Hypotheses, starts: Ints, references: Sequence[Reference]
    ) -> Floats:
        """`log_likelihood` of several targets at once."""
        from bayesnet_track.vision.kernels.histogram_kernels import color_distances_of_each

        p, boxes = self.parameters, hypotheses.boxes
        counts, visible, nominal, firsts, places = self._count_of_each(planes, boxes, starts)
        shares = column(references, "shares")
        distances, _ = color_distances_of_each(
            counts, visible, nominal, firsts, shares, p.achromatic_distance
        )
        alphas = column(references, "alpha") * column(references, SHARPER, 1.0)
        similarity = log_logistic(distances, np.repeat(alphas, np.diff(firsts)))[places]
        sizes = np.repeat(column(references, "size"), np.diff(starts), axis=0)
        size = log_size_penalty(boxes, sizes.T, p.sd_log_area, p.sd_log_aspect)
        return floored(similarity + size, p.floor)

    def follow_each(
        self, planes: Sequence[Planes], boxes: Floats, references: Sequence[Reference], rates: Floats
    ) -> Sequence[Reference]:
        """`learn` and `blend` of several targets at once."""
        shares, alphas = self._learn_each(planes, boxes)
        old_shares, old_alphas = column(references, "shares"), column(references, "alpha")
        factors, unit_factors = column(references, SHARPER, 1.0), np.ones(len(references))
        sizes = {"size": column(references, "size")}
        columns = {
            "shares": rates[:, None] * shares + (1.0 - rates)[:, None] * old_shares,
            "alpha": rates * alphas + (1.0 - rates) * old_alphas,
            "size": blend_sizes(sizes, {"size": boxes[:, 2:]}, np.repeat(rates, 2).reshape(-1, 2)),
            SHARPER: relax_all(factors, unit_factors, rates),
        }
        return ReferenceRows(columns)

    def _learn_each(self, planes: Sequence[Planes], boxes: Floats) -> tuple[Floats, Floats]:
        """(T, bins + 1) shares and (T,) alphas of targets in the centre boxes (T, 4), as `learn` has them."""
        from bayesnet_track.vision.kernels.histogram_kernels import color_distances_of_each

        count, bins = len(boxes), self.parameters.bins
        neighbours = np.repeat(boxes[:, None], 5, axis=1)
        neighbours[:, 1:, :2] += HALF_OVERLAP * boxes[:, None, 2:]
        starts = np.arange(0, 5 * count + 1, 5)
        counts, visible, nominal, _, places = self._count_of_each(planes, neighbours.reshape(-1, 4), starts)
        counts, visible, nominal = counts[places], visible[places], nominal[places]
        pixel_counts = np.maximum(visible[::5].astype(np.int64), 1)
        shares = np.zeros((count, bins + 1))
        shares[:, :bins] = counts[::5] / pixel_counts[:, None]
        shares[:, bins] = 1.0 - shares[:, :bins].sum(axis=1)
        distances, outside_shares = color_distances_of_each(
            counts, visible, nominal, starts, shares, self.parameters.achromatic_distance
        )
        neighbour_distances, is_inside = (
            distances.reshape(-1, 5)[:, 1:],
            outside_shares.reshape(-1, 5)[:, 1:] == 0,
        )
        means = neighbour_distances.mean(axis=1)
        for t in np.flatnonzero(is_inside.any(axis=1) & ~is_inside.all(axis=1)).tolist():
            means[t] = neighbour_distances[t, is_inside[t]].mean()
        return shares, np.maximum(0.5 * means, self.parameters.alpha_min)

    def _count_of_each(
        self, planes: Sequence[Planes], boxes: Floats, starts: Ints
    ) -> tuple[NDArray[np.int32], Floats, Floats, Ints, Ints]:
        """Coloured pixels (U, bins), pixels inside the frame, and in all, of the boxes that differ.

        Then (T + 1,) where those of each target begin, and (N,) where each box is among them.
        """
        from bayesnet_track.vision.kernels.histogram_kernels import (
            count_of_each,
            distinct_of_each,
        )

        values, crops, regions = crops_of(planes, self._plane)
        corners, visible, nominal, firsts, places = distinct_of_each(boxes, starts, regions)
        counts = count_of_each(values, crops, corners, firsts, self.parameters.bins)
        return counts, visible, nominal, firsts, places

    def _distances(self, planes: Planes, boxes: Floats, shares: Floats) -> tuple[Floats, Floats]:
        """(N,) distances to the reference's shares, 0..1, and the share of each box outside the frame.

        Boxes with the same pixels are compared once.
        """
        from bayesnet_track.vision.kernels.histogram_kernels import color_distances, count_in_boxes

        pixels, place = distinct_pixels(box_pixels(planes, boxes))
        counts = count_in_boxes(planes[self._plane], pixels.corners, self.parameters.bins)
        distances, outside_shares = color_distances(
            counts, pixels.visible, pixels.nominal, shares, self.parameters.achromatic_distance
        )
        return (distances, outside_shares) if place is None else (distances[place], outside_shares[place])

    def _count(self, planes: Planes, boxes: Floats) -> tuple[NDArray[np.int32], Floats, Floats]:
        """(N, bins) coloured pixels, (N,) pixels inside the frame, (N,) pixels of the whole box."""
        from bayesnet_track.vision.kernels.histogram_kernels import count_in_boxes

        pixels = box_pixels(planes, boxes)
        counts = count_in_boxes(planes[self._plane], pixels.corners, self.parameters.bins)
        return counts, pixels.visible, pixels.nominal


def _make(parameters: ColorHistogramParameters) -> Cue:
    from bayesnet_track.numerics.kernels import box_kernels  # noqa: F401  load before the first frame
    from bayesnet_track.vision.kernels import histogram_kernels  # noqa: F401

    return ColorHistogram(parameters)


CUE = CueDeclaration(
    name="color_histogram",
    summary="Hue histogram inside the box, compared round the hue circle.",
    parameters=ColorHistogramParameters,
    make=_make,
    needs_color=True,
    cost_ms=0.7,
    adapts=True,
)
