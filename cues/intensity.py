"""Intensity cue: the gray values inside a box, resampled to a fixed grid, against those of the target.

Thesis 3.4, eq. 3.8, corrected (the mask weighs the squared differences, and the exponent is negative).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from pydantic import Field

from bayesnet_track.numerics.arrays import Ints
from bayesnet_track.numerics.log_weights import SHARPER, relax, sharpen
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
from bayesnet_track.observation.likelihoods import column
from bayesnet_track.observation.planes import for_reading, read_only
from bayesnet_track.vision.planes import GrayPlane

if TYPE_CHECKING:
    from bayesnet_track.observation.planes import Plane, Planes

LOOKS = (("grid", "known"), ("coarse", "coarse_known"))
"""The arrays of a reference: mean gray of cells, and how much of them was seen; the first look's last."""

STEP = 1.2
"""Factor of a local action on the exponent.

A small one: the peak is a few px wide as it is, and of a peak that is much narrower too few hypotheses know.
"""


class IntensityParameters(SizedCueParameters):
    """Parameters of the intensity cue."""

    form: Literal["correlation", "difference"] = Field(
        default="correlation",
        description="What is compared: the pattern around its own mean (`correlation`, indifferent to "
        "contrast) or gray values one by one (`difference`, the form of the thesis).",
    )
    grid: int = Field(
        default=10, ge=3, le=64, description="Cells of the grid per side; each holds the mean of its pixels."
    )
    sd_pattern: float = Field(
        default=0.5,
        gt=0,
        description="`correlation`: standard deviation of the distance between patterns, each scaled to "
        "length 1 (the distance squared is 2 (1 - correlation)).",
    )
    sd_level_gray: float = Field(
        default=25.0,
        gt=0,
        description="`correlation`: standard deviation of the mean brightness, in gray levels of 255.",
    )
    sd_texture_gray: float = Field(
        default=8.0,
        gt=0,
        description="`correlation`: contrast below which a pattern counts as noise, in gray levels of 255.",
    )
    sd_gray: float = Field(
        default=25.0,
        gt=0,
        description="`difference`: standard deviation of a cell's value, in gray levels of 255.",
    )
    sd_mask: float = Field(
        default=0.5,
        gt=0,
        description="Standard deviation of the Gaussian mask that favours the centre, in half sides.",
    )
    sharpness: float = Field(
        default=1.0, gt=0, description="Factor on the log-likelihood before the floor (no unit)."
    )
    coarse: int = Field(
        default=0,
        ge=0,
        le=16,
        description="Cells per side of a coarse first comparison of every hypothesis; 0: none (count). It "
        "saves time for grids of 16 cells and more.",
    )
    coarse_below: float = Field(
        default=0.05,
        gt=0,
        lt=1,
        description="Likelihood by the first comparison below which a hypothesis keeps it (share of the "
        "best).",
    )


@dataclass(frozen=True)
class IntensityCue:
    """Compares resampled gray patches.

    Reference: `grid` (G, G) mean gray of each cell, rows top to bottom; `known` (G, G) the share of each cell
    that lay inside the frame when learnt; `size` (2,) width and height in pixels; `sharper` () factor on the
    exponent; with a first look also `coarse` and `coarse_known` (C, C), the
    same of its cells.
    """

    parameters: IntensityParameters
    gray: GrayPlane
    context: ClassVar[float] = 0.0

    @property
    def needs(self) -> tuple[Plane, ...]:
        """The gray plane."""
        return (self.gray,)

    @property
    def _cells(self) -> tuple[int, ...]:
        """Cells per side of the looks."""
        fine, coarse = self.parameters.grid, self.parameters.coarse
        return (fine, coarse) if coarse else (fine,)

    def learn(self, planes: Planes, box: Floats) -> Reference:
        """The patch under the centre box (4,)."""
        from bayesnet_track.vision.kernels.patch_kernels import patch_means

        learnt: dict[str, Floats] = {}
        for cells, (grid, share_name) in zip(self._cells, LOOKS, strict=False):
            means, shares = np.zeros((cells, cells)), np.zeros((cells, cells))
            if not planes.region.is_empty:
                sampling = box_integral(planes, self.gray, np.asarray(box, dtype=np.float64))
                patch_means(*sampling, means, shares)
            learnt |= {grid: means, share_name: shares}
        return {**learnt, "size": np.array(box[2:], dtype=np.float64), SHARPER: np.array(1.0)}

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        """Linear (eq. 2.15), cell by cell; what only one of the two has seen counts as far as it was seen."""
        blended: dict[str, Floats] = {}
        for _, (grid, share_name) in zip(self._cells, LOOKS, strict=False):
            weight_old, weight_new = (1.0 - rate) * old[share_name], rate * new[share_name]
            total, total_weight = weight_old * old[grid] + weight_new * new[grid], weight_old + weight_new
            blended[grid] = np.divide(total, total_weight, out=np.array(old[grid]), where=total_weight > 0)
            blended[share_name] = total_weight
        size = (1.0 - rate) * old["size"] + rate * new["size"]
        return {**blended, **relax(old, new, rate), "size": size}

    def adapt(self, reference: Reference, attempt: int) -> Reference | None:
        """A sharper comparison; None at once when the reference has seen nothing."""
        return sharpen(reference, attempt, STEP) if self._weights(reference["known"]).sum() > 0.0 else None

    def log_likelihood(self, planes: Planes, hypotheses: Hypotheses, reference: Reference) -> Floats:
        """(N,) log-likelihood. Cells outside the frame count as unmatched; a box outside is at the floor.

        All 0 when the reference has seen nothing (it lay outside the frame). With `coarse`, from coarse to
        fine: only hypotheses that are good enough at the first look are compared on the whole grid.
        """
        return self.log_likelihood_of_each([planes], hypotheses, np.array([0, len(hypotheses)]), [reference])

    def log_likelihood_of_each(
        self, planes: Sequence[Planes], hypotheses: Hypotheses, starts: Ints, references: Sequence[Reference]
    ) -> Floats:
        """`log_likelihood` of several targets at once."""
        settings, counts = self.parameters, np.diff(starts)
        boxes = np.ascontiguousarray(hypotheses.boxes, dtype=np.float64)
        sizes = np.repeat(column(references, "size"), counts, axis=0).T
        penalty = log_size_penalty(boxes, sizes, settings.sd_log_area, settings.sd_log_aspect)
        sharpness = np.repeat(settings.sharpness * column(references, SHARPER, 1.0), counts)
        *first, last_look = [LOOKS[k] for k in range(len(self._cells))][::-1]
        if first:
            log = self._look(planes, boxes, starts, references, first[0])
            fine = sharpness * log + penalty >= np.log(settings.coarse_below)
            begins = np.concatenate([[0], np.cumsum(fine)])[starts]
            log[fine] = self._look(planes, boxes[fine], begins, references, last_look)
        else:
            log = self._look(planes, boxes, starts, references, last_look)
        log = floored(sharpness * log + penalty, settings.floor)
        for t, reference in enumerate(references):
            if self._weights(reference["known"]).sum() <= 0.0:
                log[starts[t] : starts[t + 1]] = 0.0
        return log

    def _look(
        self,
        planes: Sequence[Planes],
        boxes: Floats,
        starts: Ints,
        references: Sequence[Reference],
        names: tuple[str, str],
    ) -> Floats:
        """(N,) log-likelihood by the cells of one grid, before sharpness, size and floor."""
        from bayesnet_track.vision.kernels.patch_kernels import MOMENTS, patch_moments

        grids, shares = (column(references, name) for name in names)
        moments = np.zeros((len(boxes), MOMENTS))
        sampled, sampled_planes = None, None
        for t, (grid, share) in enumerate(zip(grids, shares, strict=True)):
            part, weights = slice(starts[t], starts[t + 1]), self._weights(share)
            total = weights.sum()
            if starts[t] == starts[t + 1] or planes[t].region.is_empty or total <= 0.0:
                continue
            if planes[t] is not sampled_planes:
                sampled_planes, sampled = planes[t], box_integral(planes[t], self.gray, boxes)
            assert sampled is not None
            integral, _, origin, frame = sampled
            patch_moments(
                integral, boxes[part], origin, frame, for_reading(grid), weights / total, moments[part]
            )
        log = (
            self._correlation(moments) if self.parameters.form == "correlation" else self._difference(moments)
        )
        return np.where(moments[:, 0] > 0, np.minimum(log, 0.0), -np.inf)

    def _weights(self, shares: Floats) -> Floats:
        return _mask(len(shares), self.parameters.sd_mask) * shares

    def _correlation(self, moments: Floats) -> Floats:
        """-(1 - s rho) / sd^2 - (difference of means)^2 / (2 sd_level^2), s the share inside the frame.

        rho = (cov + e) / sqrt((var_r + e)(var_v + e)), e = sd_texture^2: the normalised correlation (thesis
        eq. 3.5) for patterns above the noise, near 0 for a flat and a textured one, and 1 only for patterns
        that are equal up to their mean.
        """
        settings = self.parameters
        share, mean_r, mean_v, rr, rv, vv = _central(moments)
        noise = settings.sd_texture_gray**2
        rho = (rv + noise) / np.sqrt((rr + noise) * (vv + noise))
        matched = share * np.clip(rho, 0.0, 1.0)
        level = (mean_r - mean_v) / settings.sd_level_gray
        return -(1.0 - matched) / settings.sd_pattern**2 - 0.5 * share * level**2

    def _difference(self, moments: Floats) -> Floats:
        """-sum W (I - Ref)^2 / (2 sd^2), sum W = 1: thesis eq. 3.8, corrected; outside counts as 5 sd off."""
        share, mean_r, mean_v, rr, rv, vv = _central(moments)
        square = share * (rr - 2.0 * rv + vv + (mean_r - mean_v) ** 2)
        return -0.5 * (square / self.parameters.sd_gray**2 + 25.0 * (1.0 - share))


def _central(moments: Floats) -> tuple[Floats, ...]:
    """Share inside, means of reference and patch, and their variances and covariance over the part inside."""
    share, r, v, rr, rv, vv = np.ascontiguousarray(moments.T)
    share = np.minimum(share, 1.0)
    inside = np.where(share > 0, share, 1.0)
    mean_r, mean_v = r / inside, v / inside
    return (
        share,
        mean_r,
        mean_v,
        np.maximum(rr / inside - mean_r**2, 0.0),
        rv / inside - mean_r * mean_v,
        np.maximum(vv / inside - mean_v**2, 0.0),
    )


@lru_cache(maxsize=16)
def _mask(cells: int, sd: float) -> Floats:
    """(G, G) Gaussian weights of the cells, by their centres' distance from the middle in half sides."""
    offset = (2.0 * np.arange(cells) + 1.0) / cells - 1.0
    line = np.exp(-0.5 * (offset / sd) ** 2)
    return read_only(np.outer(line, line))


def _make(parameters: IntensityParameters) -> IntensityCue:
    import cv2  # noqa: F401  (loaded when tracking starts, not at the first frame)

    from bayesnet_track.vision.kernels import patch_kernels  # noqa: F401

    return IntensityCue(parameters, GrayPlane())


CUE = CueDeclaration(
    name="intensity",
    summary="Gray pattern inside the box, compared with the target's.",
    parameters=IntensityParameters,
    make=_make,
    cost_ms=0.7,
    adapts=True,
)
