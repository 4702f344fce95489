"""Shading cue: how brightness falls off smoothly across a box, whatever its texture, gain and offset.

The thesis names shade as a further cue (6.2). Here it is the part of the brightness inside a box that a
polynomial of low degree can follow; what changes faster, the texture, is left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from pydantic import Field

from bayesnet_track.numerics.log_weights import SHARPER, factor_of, relax, sharpen
from bayesnet_track.observation.cue import (
    CueDeclaration,
    Floats,
    Hypotheses,
    Reference,
    SizedCueParameters,
    floored,
    log_size_penalty,
)
from bayesnet_track.observation.geometry import box_integral
from bayesnet_track.vision.planes import GrayPlane

if TYPE_CHECKING:
    from bayesnet_track.observation.planes import Plane, Planes

STEP = 1.4
"""Factor of a local action on the exponent."""


class ShadingParameters(SizedCueParameters):
    """Parameters of the shading cue."""

    degree: int = Field(
        default=3, ge=1, le=5, description="Degree of the polynomial in x and y that is the shading (count)."
    )
    grid: int = Field(
        default=8, ge=6, le=32, description="Cells of the grid per side; each holds the mean of its pixels."
    )
    sd_pattern: float = Field(
        default=0.5,
        gt=0,
        description="Standard deviation of the distance between shadings, each scaled to length 1.",
    )
    sd_noise_gray: float = Field(
        default=3.0, gt=0, description="Shading weaker than this counts as none, in gray levels of 255."
    )
    sd_mask: float = Field(
        default=0.5,
        gt=0,
        description="Standard deviation of the Gaussian mask that favours the centre, in half sides.",
    )


@dataclass(frozen=True)
class ShadingCue:
    """Compares the coefficients of smooth brightness.

    Reference: `shading` (K,) coefficients in gray levels; `known` () the weight of the cells that lay inside
    the frame when learnt; `size` (2,) width and height in px; `sharper` () factor on the log-likelihood.
    """

    parameters: ShadingParameters
    gray: GrayPlane
    context: ClassVar[float] = 0.0

    @property
    def needs(self) -> tuple[Plane, ...]:
        """The gray plane."""
        return (self.gray,)

    def learn(self, planes: Planes, box: Floats) -> Reference:
        """The shading under the centre box (4,)."""
        visible_weights, shading = self.shading(planes, box[None])
        return {
            "shading": shading[0],
            "known": np.array(visible_weights[0]),
            "size": np.array(box[2:], dtype=np.float64),
            SHARPER: np.array(1.0),
        }

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        """Linear (eq. 2.15), each shading as far as it was seen."""
        visible_weight = (1.0 - rate) * old["known"] + rate * new["known"]
        share = float(rate * new["known"] / visible_weight) if visible_weight > 0 else rate
        return {
            "shading": (1.0 - share) * old["shading"] + share * new["shading"],
            "known": np.asarray(visible_weight),
            "size": (1.0 - rate) * old["size"] + rate * new["size"],
            **relax(old, new, rate),
        }

    def log_likelihood(self, planes: Planes, hypotheses: Hypotheses, reference: Reference) -> Floats:
        """-(1 - s rho) / sd^2 with the size penalty, over the floor; s is the share inside the frame.

        rho = (a . b + e) / sqrt((a . a + e)(b . b + e)), a and b the coefficients of box and reference,
        e = sd_noise^2: their normalised correlation (thesis eq. 3.5) above the noise, and 1 for two boxes
        without shading. All 0 when the reference has seen nothing.
        """
        p, b = self.parameters, reference["shading"]
        if reference["known"] <= 0.0:
            return np.zeros(len(hypotheses))
        share, a = self.shading(planes, hypotheses.boxes)
        noise = p.sd_noise_gray**2
        # not `a @ b`: the order in which BLAS sums may depend on how many hypotheses there are
        product, square = (a * b).sum(axis=1), (a * a).sum(axis=1)
        rho = (product + noise) / np.sqrt((square + noise) * ((b * b).sum() + noise))
        log = -(1.0 - np.minimum(share, 1.0) * np.clip(rho, 0.0, 1.0)) / p.sd_pattern**2
        log = np.where(share > 0.0, log, -np.inf)
        penalty = log_size_penalty(hypotheses.boxes, reference["size"], p.sd_log_area, p.sd_log_aspect)
        return floored(factor_of(reference) * log + penalty, p.floor)

    def adapt(self, reference: Reference, attempt: int) -> Reference | None:
        """A sharper likelihood; None at once when the reference has seen nothing."""
        return sharpen(reference, attempt, STEP) if reference["known"] > 0.0 else None

    def shading(self, planes: Planes, boxes: Floats) -> tuple[Floats, Floats]:
        """Of centre boxes (N, 4): (N,) weight inside the frame, (N, K) coefficients in gray levels."""
        from bayesnet_track.vision.kernels.patch_kernels import patch_projections

        p = self.parameters
        weights, lines = polynomials(p.grid, p.degree, p.sd_mask)
        coefficients = np.zeros((len(boxes), (p.degree + 1) * (p.degree + 2) // 2))
        if len(boxes) and not planes.region.is_empty:
            patch_projections(*box_integral(planes, self.gray, boxes), weights, lines, coefficients)
        return coefficients[:, 0], coefficients[:, 1:]


@cache
def polynomials(cells: int, degree: int, sd_mask: float) -> tuple[Floats, Floats]:
    """(G,) mask of sum 1 along a side, and (D + 1, G) polynomials of degree 0 .. D, orthonormal under it.

    Their products across and down are orthonormal under the mask's own product.
    """
    place = (2.0 * np.arange(cells) + 1.0) / cells - 1.0
    mask = np.exp(-0.5 * (place / sd_mask) ** 2)
    mask /= mask.sum()
    root = np.sqrt(mask)[:, None]
    orthonormal, triangle = np.linalg.qr(root * place[:, None] ** np.arange(degree + 1))
    return mask, np.ascontiguousarray((np.sign(np.diag(triangle)) * orthonormal / root).T)


def _make(parameters: ShadingParameters) -> ShadingCue:
    import cv2  # noqa: F401  (loaded when tracking starts, not at the first frame)

    from bayesnet_track.vision.kernels import patch_kernels  # noqa: F401

    return ShadingCue(parameters, GrayPlane())


CUE = CueDeclaration(
    name="shading",
    summary="Smooth fall-off of brightness across the box, without its texture.",
    parameters=ShadingParameters,
    make=_make,
    cost_ms=1.0,
    adapts=True,
)
