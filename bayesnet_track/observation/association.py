"""The rule by which a target is given one of the frame's detections as its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from bayesnet_track.numerics.arrays import Floats


@dataclass(frozen=True)
class AssociationRule:
    """Which detection a target is given as its own, and how far off detections are.

    Attributes:
        sd_place: sd of a detection's centre, as a share of its sides.
        sd_size: sd of its sides, as a share of them.
        gate: a detection farther from the prediction than this share of right ones is not the target's.
        min_overlap: nor is one whose intersection over union with the predicted box is smaller.
        appearance: exponent of the likelihood that agents which know the target's appearance give the
            detection's box.
        floor: floor of its measurement where that is the detection's box with errors of `variances` and
            nothing else, so that many targets are measured at once; None where the cue has to be asked.
        sd_place_px: further sd of its centre, px.
        sd_size_px: further sd of its sides, px.
        similarity: what the best assignment has most of: log density of the detections, or overlap.
        first_score: detections of a lower score are given in a second pass, to targets left without one.
        direction: weight of the direction consistency beside the overlap.
        direction_frames: over how many frames the direction of a target is measured.
        recover: whether targets left without a detection are compared by their last one in another pass.
        re_update: whether a target that has a detection again is filtered anew over the gap.
    """

    sd_place: float
    sd_size: float
    gate: float
    min_overlap: float
    appearance: float
    floor: float | None = None
    sd_place_px: float = 0.0
    sd_size_px: float = 0.0
    similarity: Literal["density", "iou"] = "density"
    first_score: float = 0.0
    direction: float = 0.0
    direction_frames: int = 3
    recover: bool = False
    re_update: bool = False

    def variances(self, boxes: Floats) -> Floats:
        """(..., 4) variances in px^2 of x, y, w, h of detections (..., 4)."""
        shares = np.array([self.sd_place, self.sd_place, self.sd_size, self.sd_size])
        variances = (shares * boxes[..., [2, 3, 2, 3]]) ** 2
        if self.sd_place_px or self.sd_size_px:
            variances += np.square([self.sd_place_px, self.sd_place_px, self.sd_size_px, self.sd_size_px])
        return np.ascontiguousarray(variances)  # kernels have one compiled version only

    @property
    def remembers(self) -> bool:
        """Whether a target's former detections say anything of which one is its own, or of its belief."""
        return self.direction > 0.0 or self.recover or self.re_update
