"""Cue: where the blobs of one hue lie inside each hypothesis (thesis 3.1.2, corrected).

Blobs are 4-connected regions of similar hue over a least size, grown inside each hypothesis on its own: over
a grid of samples spanned on the box rather than over its pixels, the approximation that makes a thousand
boxes affordable and every box independent of what is around it. A median filter goes before the sampling.
Each blob of the reference, the largest first, is matched with at most one of the hypothesis.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from bayesnet_track.numerics.distributions import follow_spread, spread_of, start_spread
from bayesnet_track.numerics.log_weights import SHARPER, factor_of, relax, sharpen
from bayesnet_track.observation.cue import (
    Cue,
    CueDeclaration,
    Floats,
    Hypotheses,
    Reference,
    SizedCueParameters,
    blend_sizes,
    floored,
    log_size_penalty,
)
from bayesnet_track.observation.planes import Frame, Plane, Planes
from bayesnet_track.vision.planes import Hue

SHARE = 3
"""Column of a blob that holds its share of the box."""

STEP = 0.7
"""Factor of a local action on the standard deviations with which blobs are matched."""


class ColorBlobsParameters(SizedCueParameters):
    """Parameters of the colour blobs."""

    min_chroma: int = Field(
        default=30,
        ge=1,
        le=255,
        description="Pixels with a smaller difference between largest and smallest channel have no hue (of "
        "255).",
    )
    median_px: Literal[1, 3, 5] = Field(
        default=3, description="Side of the median filter before hue is taken (px)."
    )
    cells: int = Field(default=8, ge=4, le=64, description="Samples along each side of a box (count).")
    tolerance_deg: float = Field(
        default=15.0, ge=1.5, le=90, description="Largest hue difference of neighbours in one blob (degrees)."
    )
    min_share: float = Field(
        default=0.05, gt=0, lt=1, description="Smallest size of a blob (share of the box)."
    )
    max_blobs: int = Field(default=6, ge=1, le=64, description="Blobs kept of each box, the largest (count).")
    sd_offset: float = Field(
        default=0.1, gt=0, description="Sd of a blob's centre (widths and heights of the box)."
    )
    sd_hue_deg: float = Field(default=15.0, gt=0, description="Sd of a blob's mean hue (degrees).")
    sd_memory_frames: float | None = Field(
        default=None,
        ge=2,
        description="Both standard deviations follow how much the target's own blobs vary, over about so "
        "many frames; they stay as given when absent.",
    )
    unmatched: float = Field(
        default=4.0,
        gt=0,
        description="Cost of a blob without a match, and of a box outside the frame (nats).",
    )


@dataclass(frozen=True)
class ColorBlobs:
    """The colour blobs at work.

    A reference holds ``blobs`` (K, 4), each a centre relative to the box's in its widths and heights, a mean
    hue in degrees and a share of the box; ``size`` (2,), w and h in px; ``sharper`` (), a factor on the
    standard deviations of centre and hue; and ``spread`` (2,), another on each, where they follow the target.
    Blobs below the least share are remembered while they fade in or out, and not compared.
    """

    parameters: ColorBlobsParameters
    context: ClassVar[float] = 0.0

    @property
    def _plane(self) -> Hue:
        return Hue(self.parameters.min_chroma, self.parameters.median_px)

    @property
    def needs(self) -> tuple[Plane, ...]:
        """Hue."""
        return (self._plane,)

    def learn(self, planes: Planes, box: Floats) -> Reference:
        """The blobs inside `box`."""
        blobs, counts = self._blobs(planes, box[None])
        return {
            "blobs": blobs[0, : counts[0]],
            "size": np.array(box[2:], dtype=np.float64),
            SHARPER: np.array(1.0),
            **start_spread(2, self.parameters.sd_memory_frames),
        }

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        """Matching blobs linearly (eq. 2.15, the hue round its circle), the size in its logarithm.

        A blob without a match is blended with one of size 0 in its place: old ones fade out, new ones in.
        """
        from bayesnet_track.vision.kernels.blob_kernels import match_blobs

        p = self.parameters
        old_blobs, new_blobs = np.ascontiguousarray(old["blobs"]), np.ascontiguousarray(new["blobs"])
        match, _ = match_blobs(old_blobs, new_blobs, p.sd_offset, p.sd_hue_deg, p.unmatched)
        matched = match >= 0
        target = np.concatenate([old_blobs[:, :SHARE], np.zeros((len(old_blobs), 1))], axis=1)
        target[matched] = new_blobs[match[matched]]
        step = target - old_blobs
        step[:, 2] = (step[:, 2] + 180.0) % 360.0 - 180.0
        blended = old_blobs + rate * step
        blended[:, 2] %= 360.0
        arrived = np.delete(new_blobs, match[matched], axis=0)
        arrived[:, SHARE] *= rate
        blobs = np.concatenate([blended, arrived])
        largest = np.argsort(-blobs[:, SHARE], kind="stable")[: 2 * p.max_blobs]
        blobs = blobs[largest]
        compared = new_blobs if rate and p.sd_memory_frames else new_blobs[:0]
        errors = self._differences(self._wanted(old), compared)
        return {
            "blobs": blobs[blobs[:, SHARE] > 0],
            "size": blend_sizes(old, new, rate),
            **relax(old, new, rate),
            **follow_spread(old, errors, (p.sd_offset, p.sd_hue_deg), p.sd_memory_frames),
        }

    def adapt(self, reference: Reference, attempt: int) -> Reference | None:
        """A tighter match of the blobs; None at once when there is none to match."""
        return sharpen(reference, attempt, STEP) if len(self._wanted(reference)) else None

    def log_likelihood(self, planes: Planes, hypotheses: Hypotheses, reference: Reference) -> Floats:
        """Minus the mean cost of the reference's blobs, with the size penalty, over the floor.

        Thesis eq. 3.4, corrected: the mean runs over the reference's blobs, so that a box without blobs does
        not score the maximum, and weighs them by their share of the box, so that small ones which come and go
        say little; a blob without a match costs the same on either side; hue goes round a circle.
        """
        from bayesnet_track.vision.kernels.blob_kernels import blob_costs

        p, boxes = self.parameters, hypotheses.boxes
        expected, wider = self._wanted(reference), factor_of(reference) * spread_of(reference, 2)
        blobs, counts = self._blobs(planes, boxes)
        cost = blob_costs(
            blobs, counts, expected, wider[0] * p.sd_offset, wider[1] * p.sd_hue_deg, p.unmatched
        )
        cost += p.unmatched * _share_outside(boxes, planes.frame)
        size = log_size_penalty(boxes, reference["size"], p.sd_log_area, p.sd_log_aspect)
        return floored(size - cost, p.floor)

    def residuals(self, planes: Planes, box: Floats, reference: Reference) -> dict[str, Floats]:
        """Differences of eq. 3.4: the reference's blobs and those of the centre box (4,), nearest pairs.

        Offsets of their centres in both axes (widths and heights of the box), differences of hue (degrees).
        """
        blobs, counts = self._blobs(planes, np.asarray(box, dtype=np.float64)[None])
        offsets, hues = self._differences(self._wanted(reference), blobs[0, : counts[0]])
        return {"sd_offset": offsets, "sd_hue_deg": hues}

    def _differences(self, expected: Floats, blobs: Floats) -> tuple[Floats, Floats]:
        """Offsets in both axes, and differences of hue, of nearest pairs, however far apart."""
        from bayesnet_track.vision.kernels.blob_kernels import match_blobs

        p = self.parameters
        match, _ = match_blobs(expected, blobs, p.sd_offset, p.sd_hue_deg, np.inf)
        differences = blobs[match[match >= 0]] - expected[match >= 0]
        return differences[:, :2].ravel(), np.asarray((differences[:, 2] + 180.0) % 360.0 - 180.0)

    def _wanted(self, reference: Reference) -> Floats:
        """(K, 4) blobs that are compared."""
        blobs = reference["blobs"]
        return np.ascontiguousarray(blobs[blobs[:, SHARE] >= self.parameters.min_share])

    def _blobs(self, planes: Planes, boxes: Floats) -> tuple[Floats, NDArray[np.int64]]:
        from bayesnet_track.vision.kernels.blob_kernels import grow_blobs

        p, region = self.parameters, planes.region
        return grow_blobs(
            planes[self._plane],
            boxes,
            (region.x0, region.y0),
            p.cells,
            p.tolerance_deg,
            p.min_share,
            p.max_blobs,
        )


def _share_outside(boxes: Floats, frame: Frame) -> Floats:
    """(N,) share of each box's area outside the frame."""
    x, y, w, h = boxes.T  # column by column: NumPy is slow on rows of two
    share_x = _inside(x, w, frame.width) / w
    share_y = _inside(y, h, frame.height) / h
    return np.asarray(np.clip(1.0 - share_x * share_y, 0.0, 1.0))


def _inside(centre: Floats, size: Floats, extent: int) -> Floats:
    """(N,) px of each span that lie on the frame's `extent` pixels."""
    low, high = np.maximum(centre - size / 2, -0.5), np.minimum(centre + size / 2, extent - 0.5)
    return np.asarray(np.maximum(high - low, 0.0))


def _make(parameters: ColorBlobsParameters) -> Cue:
    from bayesnet_track.vision.kernels import color_kernels  # noqa: F401  load before the first frame

    return ColorBlobs(parameters)


CUE = CueDeclaration(
    name="color_blobs",
    summary="Place and hue of the one-colour regions inside the box.",
    parameters=ColorBlobsParameters,
    make=_make,
    needs_color=True,
    cost_ms=1.4,
    adapts=True,
    has_residuals=True,
)
