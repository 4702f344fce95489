"""Cue: histograms of texture in the cells of a box.

Each pixel has a code, the direction of its gradient or its local binary pattern. What is compared is how
often each occurs in each cell, so that small shifts and turns inside a cell do not matter, nor does light.
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
    log_logistic,
    log_size_penalty,
)
from bayesnet_track.observation.geometry import HALF_OVERLAP
from bayesnet_track.observation.planes import Plane, Planes
from bayesnet_track.vision.planes import TextureCodes, WholeFrame

STEP = 0.7
"""Factor of a local action on alpha."""
FEW = 5
"""Boxes whose pixels are counted one by one; more are faster by an integral image."""


class TextureParameters(SizedCueParameters):
    """Parameters of the histograms of texture."""

    floor: float = Field(
        default=0.005,
        gt=0,
        lt=1,
        description="Likelihood of an outlier as a share of the best possible likelihood.",
    )
    form: Literal["gradients", "patterns"] = Field(
        default="gradients",
        description="Code of a pixel: direction of its `gradients`, or its local binary `patterns`, which do "
        "not change when the target rotates in the image.",
    )
    cells: int = Field(default=3, ge=1, le=8, description="Cells of the box per side (count).")
    noise_gray: int = Field(
        default=8,
        ge=0,
        le=255,
        description="Differences between neighbours up to this count as none (gray levels).",
    )
    alpha_share: float = Field(
        default=0.5,
        gt=0,
        le=2,
        description="Distance at which the likelihood halves, as a share of that of boxes half a box away.",
    )
    alpha_min: float = Field(
        default=0.05, gt=0, le=1, description="Smallest distance at which the likelihood halves (0..1)."
    )


@dataclass(frozen=True)
class Texture:
    """Histograms of texture at work.

    A reference holds ``shares`` (cells, cells, codes), how often each code occurs in each cell, of all of its
    pixels; ``alpha`` (), the distance at which the likelihood halves; ``size`` (2,), w and h in px;
    ``sharper`` (), a factor on alpha.
    """

    parameters: TextureParameters
    context: ClassVar[float] = 0.5  # boxes half a box away

    @property
    def needs(self) -> tuple[Plane, ...]:
        """The whole picture, of which codes are made on the grid of the target."""
        return (WholeFrame(),)

    def learn(self, planes: Planes, box: Floats) -> Reference:
        """The shares of the box, each cell's summing to 1 if it was seen, and alpha from its surroundings.

        Alpha is `alpha_share` times the mean distance of the four boxes that overlap it by 50 %, as for
        the colour histogram (thesis figure 3.2).
        """
        p = self.parameters
        boxes = np.tile(box, (5, 1)).astype(np.float64)
        boxes[1:, :2] += HALF_OVERLAP * box[2:]
        shares, *shifted = self._shares(planes, boxes, box[2:])
        cell_sums = shares.sum(axis=-1, keepdims=True)
        shares = np.divide(shares, cell_sums, out=np.zeros_like(shares), where=cell_sums > 0)
        alpha = p.alpha_share * float(_distances(np.array(shifted), shares).mean())
        return {
            "shares": shares,
            "alpha": np.array(max(alpha, p.alpha_min)),
            "size": np.array(box[2:], dtype=np.float64),
            SHARPER: np.array(1.0),
        }

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        """Linear (eq. 2.15), the size in its logarithm."""
        return {**blend_arrays(old, new, rate), **relax(old, new, rate), "size": blend_sizes(old, new, rate)}

    def log_likelihood(self, planes: Planes, hypotheses: Hypotheses, reference: Reference) -> Floats:
        """-log(1 + exp(4 (d - alpha) / alpha)), 0 at d = 0, plus the size penalty, over the floor.

        d is the Bhattacharyya distance, sqrt(1 - rho), rho the mean over cells; thesis eq. 3.3, corrected.
        All 0 when the reference has seen nothing.
        """
        p, alpha = self.parameters, float(reference["alpha"]) * factor_of(reference)
        if not reference["shares"].any():
            return np.zeros(len(hypotheses))
        distances = _distances(self._shares(planes, hypotheses.boxes, reference["size"]), reference["shares"])
        similarity = log_logistic(distances, alpha)
        size = log_size_penalty(hypotheses.boxes, reference["size"], p.sd_log_area, p.sd_log_aspect)
        return floored(similarity + size, p.floor)

    def adapt(self, reference: Reference, attempt: int) -> Reference | None:
        """A sharper likelihood; None at once when the reference has seen nothing."""
        return sharpen(reference, attempt, STEP) if reference["shares"].any() else None

    def _shares(self, planes: Planes, boxes: Floats, size: Floats) -> Floats:
        """(N, cells, cells, codes) share of each code in boxes of a target of `size` (2,), px."""
        from bayesnet_track.numerics.compiled import plain
        from bayesnet_track.vision.kernels.patch_kernels import (
            cell_shares,
            counted_shares,
            integral_histogram,
        )

        form, cells = TextureCodes(self.parameters.form, self.parameters.noise_gray), self.parameters.cells
        grid = form.grid(planes.frame, boxes, size)
        codes, boxes = grid.values, plain(grid.boxes(boxes))
        shares = np.empty((len(boxes), cells, cells, form.bins))
        if len(boxes) <= FEW:
            counted_shares(codes, boxes, 0, 0, cells, shares)
            return shares
        integral = np.empty((codes.shape[0] + 1, codes.shape[1] + 1, form.bins), np.int32)
        integral_histogram(codes, integral)
        cell_shares(integral, boxes, 0, 0, cells, shares)
        return shares


def _distances(box_shares: Floats, shares: Floats) -> Floats:
    """(N,) Bhattacharyya distances of shares (N, cells, cells, codes) from the reference's, 0..1."""
    from bayesnet_track.numerics.compiled import plain
    from bayesnet_track.vision.kernels.patch_kernels import bhattacharyya

    coefficients = np.empty(len(box_shares))
    bhattacharyya(box_shares, plain(shares), coefficients)
    return np.asarray(np.sqrt(1.0 - coefficients))


def _make(parameters: TextureParameters) -> Cue:
    from bayesnet_track.vision.kernels import patch_kernels  # noqa: F401  load before the first frame

    return Texture(parameters)


CUE = CueDeclaration(
    name="texture",
    summary="Histograms of gradients or binary patterns in the cells of the box.",
    parameters=TextureParameters,
    make=_make,
    cost_ms=1.1,
    adapts=True,
)
