"""Cue: colours of the target against colours of what is around it.

Each colour has a probability of being the target's, from histograms of the box and of a ring around it. A
hypothesis is scored by how much more of it there is inside than in a narrow ring: too small a box has the
target in its ring, too large a one has background inside (Possegger et al. 2015; Bertinetto et al. 2016).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from pydantic import Field

from bayesnet_track.numerics.arrays import Bytes, Floats
from bayesnet_track.numerics.log_weights import SHARPER, factor_of, relax, sharpen
from bayesnet_track.observation.cue import (
    Cue,
    CueDeclaration,
    Hypotheses,
    Reference,
    SizedCueParameters,
    blend_arrays,
    blend_sizes,
    floored,
    log_size_penalty,
)
from bayesnet_track.observation.planes import Frame, Plane, Planes
from bayesnet_track.vision.planes import WholeFrame

if TYPE_CHECKING:
    from bayesnet_track.vision.kernels.mean_shift_kernels import CellLayout


STEP = 1.4
"""Factor of a local action on the gain."""


class ForegroundColorParameters(SizedCueParameters):
    """Parameters of foreground and background colours."""

    floor: float = Field(
        default=0.005,
        gt=0,
        lt=1,
        description="Likelihood of an outlier as a share of the best possible likelihood.",
    )
    gain: float = Field(
        default=20.0, gt=0, description="Log-likelihood per unit of contrast, which is -1 .. 1 (no unit)."
    )
    levels: int = Field(default=16, ge=2, le=32, description="Levels of each channel (count).")
    gray_levels: int = Field(
        default=32, ge=2, le=256, description="Levels of brightness on a gray source (count)."
    )
    inner: float = Field(
        default=0.8,
        gt=0,
        le=1,
        description="Part of the box's sides in which the target's colours are learnt.",
    )
    surround: float = Field(
        default=0.5,
        gt=0,
        le=4,
        description="Ring in which the surroundings' colours are learnt (mean sides of the box).",
    )
    ring: float = Field(
        default=0.25, gt=0, le=2, description="Ring that a box is compared with (mean sides of the box)."
    )
    wide: float = Field(
        default=1.5,
        gt=0,
        le=8,
        description="Ring in which colours that could distract are learnt (mean sides of the box).",
    )
    memory: float = Field(
        default=0.5, ge=0, le=1, description="Share of the wide ring in the surroundings' colours."
    )
    memory_rate: float = Field(
        default=0.25,
        gt=0,
        le=1,
        description="How fast the wide ring is forgotten, as a share of the learning rate.",
    )
    prior: float = Field(
        default=0.5,
        ge=0,
        le=1,
        description="Probability that a colour in neither of the two is the target's.",
    )


@dataclass(frozen=True)
class ForegroundColor:
    """Foreground and background colours at work.

    A reference holds ``foreground``, ``background`` and ``memory`` (cells,), the share of the box's, the
    ring's and the wide ring's visible pixels in each cell of colour; ``posterior`` (cells,) uint8, the
    probability of the target by colour, of 255; ``contrast`` (), that of the target's own box; ``size`` (2,),
    w and h in px; ``sharper`` (), a factor on the gain.
    """

    parameters: ForegroundColorParameters
    context: ClassVar[float] = 0.0  # it reads the whole picture

    @property
    def needs(self) -> tuple[Plane, ...]:
        """The whole picture: rings lie beyond the boxes."""
        return (WholeFrame(),)

    def learn(self, planes: Planes, box: Floats) -> Reference:
        """The colours of the inner box, of the ring, and of the wide ring; the contrast that they give."""
        from bayesnet_track.vision.kernels import mean_shift_kernels as f

        p, frame = self.parameters, planes.frame
        box = np.asarray(box, dtype=np.float64)
        x, y, w, h = box.tolist()
        ring_sizes = [ring * (w + h) for ring in sorted((p.surround, p.wide), reverse=True)]
        sizes = (
            *((w + ring_size, h + ring_size) for ring_size in ring_sizes),
            (w, h),
            (p.inner * w, p.inner * h),
        )
        boxes = np.array([(x, y, *size) for size in sizes])
        counts = f.count_pixels(frame, self._cells(frame), boxes)
        *of_rings, mean_shift_kernels = f.shares_of(counts)
        learnt = {
            "foreground": mean_shift_kernels,
            "background": of_rings[int(p.surround < p.wide)],
            "memory": of_rings[int(p.wide <= p.surround)],
            "size": np.array(box[2:]),
            SHARPER: np.array(1.0),
        }
        learnt["posterior"] = self._posterior(learnt)
        contrast = self.contrasts(frame, box[None], learnt)[0]
        return {**learnt, "contrast": np.array(contrast)}

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        """Linear (eq. 2.15), for the wide ring at a slower rate, for the size in its logarithm."""
        slow = 1.0 - (1.0 - rate) ** self.parameters.memory_rate
        quick = {name: old[name] for name in ("foreground", "background", "contrast")}
        blended = {**blend_arrays(quick, new, rate), **blend_arrays({"memory": old["memory"]}, new, slow)}
        size = blend_sizes(old, new, rate)
        return {**blended, **relax(old, new, rate), "size": size, "posterior": self._posterior(blended)}

    def log_likelihood(self, planes: Planes, hypotheses: Hypotheses, reference: Reference) -> Floats:
        """gain * min(contrast - the target's own contrast, 0), plus the size penalty, over the floor.

        A contrast is the mean posterior inside the box less that in the ring. A box counts with all of its
        area: what lies outside the frame is not the target's. All 0 when the target has no contrast of its
        target_contrast: then its colours say nothing.
        """
        p = self.parameters
        target_contrast = float(reference["contrast"])
        if target_contrast <= 0.0:
            return np.zeros(len(hypotheses))
        contrast = self.contrasts(planes.frame, hypotheses.boxes, reference)
        log = p.gain * factor_of(reference) * np.minimum(contrast - target_contrast, 0.0)
        size = log_size_penalty(hypotheses.boxes, reference["size"], p.sd_log_area, p.sd_log_aspect)
        return floored(log + size, p.floor)

    def adapt(self, reference: Reference, attempt: int) -> Reference | None:
        """A larger gain; None at once when the target has no contrast."""
        return sharpen(reference, attempt, STEP) if float(reference["contrast"]) > 0.0 else None

    def _cells(self, frame: Frame) -> CellLayout:
        from bayesnet_track.vision.kernels.mean_shift_kernels import CellLayout

        p = self.parameters
        return CellLayout(p.levels, False) if frame.has_color else CellLayout(p.gray_levels, True)

    def _posterior(self, shares: Reference) -> Bytes:
        from bayesnet_track.vision.kernels.mean_shift_kernels import posterior

        return posterior(shares, self.parameters.memory, self.parameters.prior)

    def contrasts(self, frame: Frame, boxes: Floats, reference: Reference) -> Floats:
        """(N,) mean posterior inside the box less that in the ring."""
        from bayesnet_track.vision.kernels.mean_shift_kernels import means

        levels, ring = reference["posterior"], self.parameters.ring
        box_means, ring_means = means(frame, self._cells(frame), levels, boxes, ring, reference["size"]).T
        return np.asarray(box_means - ring_means)


def _make(parameters: ForegroundColorParameters) -> Cue:
    from bayesnet_track.vision.kernels import mean_shift_kernels  # noqa: F401  load before the first frame

    return ForegroundColor(parameters)


CUE = CueDeclaration(
    name="foreground_color",
    summary="Colours of the target against those around it, inside a box and in a ring.",
    parameters=ForegroundColorParameters,
    make=_make,
    cost_ms=0.4,
    rate_max=0.04,
    adapts=True,
)
