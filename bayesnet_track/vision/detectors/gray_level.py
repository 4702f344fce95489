"""Detector: regions that stand out by their gray level (thesis 2.4, Example 2)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from bayesnet_track.numerics.arrays import Bytes
from bayesnet_track.observation.detector import Detections, Detector, DetectorDeclaration, DetectorState
from bayesnet_track.observation.planes import FramePair
from bayesnet_track.vision.detectors.selection import SURE, BlobParameters, blobs, select
from bayesnet_track.vision.planes import gray

SD_OF_MAD = 1.4826
"""Standard deviation of a Gaussian in median absolute deviations."""


class GrayLevelParameters(BlobParameters):
    """Parameters of the segmentation by gray level."""

    split: Literal["outliers", "bands", "otsu"] = Field(
        default="outliers",
        description="Targets are pixels far from the frame's usual level (`outliers`), within the given "
        "`bands`, or in any class of the multi-level threshold but the largest (`otsu`).",
    )
    spread: float = Field(
        default=3.5,
        gt=0,
        description="`outliers`: how far from the median a target is (robust standard deviations of the "
        "frame).",
    )
    min_difference: float = Field(
        default=12.0, ge=1, le=255, description="`outliers`: and at least so far (gray levels of 255)."
    )
    bands: tuple[tuple[int, int], ...] = Field(
        default=(), max_length=16, description="`bands`: lowest and highest gray level of each (0..255)."
    )
    levels: int = Field(default=3, ge=2, le=6, description="`otsu`: classes of gray level (count).")
    median_px: Literal[1, 3, 5] = Field(
        default=5, description="Side of the median filter on the frame, against noise (px)."
    )
    join_px: int = Field(
        default=4,
        ge=0,
        le=50,
        description="Regions are closed by a square that reaches this far: gaps up to twice as wide vanish "
        "(px).",
    )

    @field_validator("bands")
    @classmethod
    def _ordered(cls, bands: tuple[tuple[int, int], ...]) -> tuple[tuple[int, int], ...]:
        for low, high in bands:
            if not 0 <= low <= high <= 255:
                raise ValueError(
                    f"a band goes from its lowest level to its highest in 0..255, not {low}, {high}"
                )
        return bands

    @model_validator(mode="after")
    def _has_bands(self) -> GrayLevelParameters:
        if (self.split == "bands") != bool(self.bands):
            raise ValueError("`split: bands` and a list of bands belong together")
        return self


@dataclass(frozen=True)
class GrayLevel:
    """Segments each frame on its own; no state."""

    parameters: GrayLevelParameters

    def start(self) -> DetectorState:
        """Nothing to remember."""
        return {}

    def detect(self, frames: FramePair, state: DetectorState) -> tuple[Detections, DetectorState]:
        """The regions of the current frame; labelled by their band where there are several."""
        import cv2

        settings, frame = self.parameters, frames.current
        picture = gray(frame.image)
        if settings.median_px > 1:
            picture = cv2.medianBlur(picture, settings.median_px)
        parts_of_bands, names = [], []
        for name, evidence in self._evidence(picture):
            boxes, scores = blobs(evidence[picture], 1, settings)
            parts_of_bands.append((boxes, scores))
            names += [name] * len(boxes)
        boxes, scores = (np.concatenate(parts) for parts in zip(*parts_of_bands, strict=True))
        return select(boxes, scores, frame, settings, names), state

    def _evidence(self, picture: Bytes) -> list[tuple[str, Bytes]]:
        """Label and (256,) evidence of each gray level, for every kind of target."""
        settings, levels = self.parameters, np.arange(256)
        counts = np.bincount(picture.ravel(), minlength=256)
        if settings.split == "outliers":
            return [("", outliers(counts, settings.spread, settings.min_difference))]
        bands = list(settings.bands)
        if settings.split == "otsu":
            bands = otsu_bands(counts, settings.levels)
            bands.remove(max(bands, key=lambda band: int(counts[band[0] : band[1] + 1].sum())))
        tables = [((levels >= low) & (levels <= high)) * np.uint8(SURE) for low, high in bands]
        return [(f"{low}-{high}", table) for (low, high), table in zip(bands, tables, strict=True)]


def outliers(counts: NDArray[np.int64], spread: float, min_difference: float) -> Bytes:
    """(256,) evidence of each gray level of a histogram (256,): how far it is from the usual one.

    t = max(`spread` robust standard deviations, `min_difference`) around the median; 0 up to t,
    half of `SURE` from there on, `SURE` from 2 t on.
    """
    levels = np.arange(256)
    middle = _median(counts, levels)
    distance = np.abs(levels - middle)
    limit = max(spread * SD_OF_MAD * _median(counts, distance), min_difference)
    share = np.where(distance > limit, np.minimum(distance / (2.0 * limit), 1.0), 0.0)
    return np.asarray(np.rint(SURE * share), dtype=np.uint8)


def _median(counts: NDArray[np.int64], values: NDArray[np.int64]) -> int:
    order = np.argsort(values, kind="stable")
    cumulated = np.cumsum(counts[order])
    return int(values[order[np.searchsorted(cumulated, (cumulated[-1] + 1) // 2)]])


def otsu_bands(counts: NDArray[np.int64], levels: int) -> list[tuple[int, int]]:
    """The `levels` bands of gray level with the least variance inside them (Otsu 1979), exactly.

    By dynamic programming over the 256 values. Of equal splits the one with the lower thresholds.
    """
    values, weight = np.arange(256), counts.astype(np.float64)
    total, first = (np.concatenate([[0.0], np.cumsum(weight * power)]) for power in (1, values))
    mass, moment = total[None] - total[:, None], first[None] - first[:, None]
    # between-class variance of values low .. high - 1, up to a constant
    gain = np.divide(moment**2, mass, out=np.zeros_like(mass), where=mass > 0)
    gain[np.tril_indices(257)] = -np.inf  # a band holds at least one value
    gains, cuts = gain[0], []
    for _ in range(levels - 1):
        through = gains[:, None] + gain
        cuts.append(through.argmax(axis=0))
        gains = through.max(axis=0)
    ends = [256]
    for cut in reversed(cuts):
        ends.append(int(cut[ends[-1]]))
    edges = [0, *reversed(ends)]
    return [(low, high - 1) for low, high in pairwise(edges)]


def _make(parameters: GrayLevelParameters) -> Detector:
    import cv2  # noqa: F401  load before the first frame

    return GrayLevel(parameters)


DETECTOR = DetectorDeclaration(
    name="gray_level",
    summary="Regions that stand out by their gray level.",
    parameters=GrayLevelParameters,
    make=_make,
    cost_ms=7.0,
)
