"""Detector: regions in the hues of a target, by the back-projection of its histogram."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.detector import (
    NOTHING,
    Detections,
    Detector,
    DetectorDeclaration,
    DetectorError,
    DetectorState,
)
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Region, region_of_boxes
from bayesnet_track.vision.detectors.selection import SURE, BlobParameters, blobs, select
from bayesnet_track.vision.planes import HueBins

RARE = 0.002
"""A hue of so small a share of the pixels says little about whose it is."""


class ColorBackprojectionParameters(BlobParameters):
    """Parameters of the colour back-projection."""

    hue_deg: float | None = Field(
        default=None, ge=0, le=360, description="Hue to look for: 0 red, 120 green, 240 blue (degrees)."
    )
    sd_hue_deg: float = Field(
        default=12.0, gt=0, le=90, description="Standard deviation of that hue (degrees)."
    )
    picture: str | None = Field(
        default=None, description="Picture of the target, filled by it, to take the hues from instead (path)."
    )
    bins: int = Field(default=32, ge=8, le=128, description="Bins of hue round the circle (count).")
    min_chroma: int = Field(
        default=30,
        ge=1,
        le=255,
        description="Pixels with a smaller difference of largest and smallest channel have no hue (of 255).",
    )
    above: float = Field(
        default=0.4, gt=0, lt=1, description="Least smoothed back-projection of a target's pixel (0..1)."
    )
    smooth_px: int = Field(
        default=1,
        ge=0,
        le=20,
        description="The back-projection is averaged over a square of this reach (px).",
    )

    @field_validator("picture")
    @classmethod
    def _readable(cls, path: str | None) -> str | None:
        if path is not None:
            from pathlib import Path

            if not Path(path).is_file():
                raise ValueError(f"a picture file is needed; {path} is not there")
        return path

    @model_validator(mode="after")
    def _one_source(self) -> ColorBackprojectionParameters:
        if self.hue_deg is not None and self.picture is not None:
            raise ValueError("give hue_deg or picture, not both")
        return self


@dataclass(frozen=True)
class ColorBackprojection:
    """State: ``shares`` (bins + 1,) of the target's hues, without hue last; all 0 when none is known."""

    parameters: ColorBackprojectionParameters
    shares: Floats

    def start(self) -> DetectorState:
        """The hues of the parameters."""
        return {"shares": np.array(self.shares)}

    def knows_target(self, state: DetectorState) -> bool:
        """True if it has hues to look for."""
        return bool(state["shares"][:-1].sum() > 0)

    def learn(self, frames: FramePair, box: Floats, state: DetectorState) -> DetectorState:
        """The hues inside the centre box (4,).

        Raises:
            DetectorError: nothing of the box is inside the frame, or nothing in it has a hue.
        """
        region = region_of_boxes(np.asarray(box, dtype=np.float64)[None]).within(frames.current)
        shares = self._shares(frames, region)
        if not shares[:-1].any():
            raise DetectorError("nothing inside the box has a hue to look for")
        return {"shares": shares}

    def detect(self, frames: FramePair, state: DetectorState) -> tuple[Detections, DetectorState]:
        """Regions in these hues; none in a gray frame, or while no hues are known."""
        import cv2

        settings, frame = self.parameters, frames.current
        if not (frame.has_color and self.knows_target(state)):
            return NOTHING, state
        cells = self._cells(frames, Region(0, 0, frame.width, frame.height))
        evidence = _back_projection(state["shares"], _shares_of(cells, settings.bins))[cells]
        if settings.smooth_px > 0:
            side = 2 * settings.smooth_px + 1
            evidence = cv2.blur(evidence, (side, side))
        boxes, scores = blobs(evidence, max(round(SURE * settings.above), 1), settings)
        return select(boxes, scores, frame, settings), state

    def _shares(self, frames: FramePair, region: Region) -> Floats:
        return _shares_of(self._cells(frames, region), self.parameters.bins)

    def _cells(self, frames: FramePair, region: Region) -> NDArray[np.uint8]:
        plane = HueBins(self.parameters.bins, self.parameters.min_chroma)
        return PlaneCache(frames).planes([plane], region)[plane]


def _shares_of(cells: NDArray[np.uint8], bins: int) -> Floats:
    """(bins + 1,) share of the pixels in each bin, without hue last; all 0 of no pixels."""
    counts = np.bincount(cells.ravel(), minlength=bins + 1)
    return counts / max(cells.size, 1)


def _back_projection(target: Floats, frame: Floats) -> NDArray[np.uint8]:
    """(bins + 1,) evidence max(0, q - b) / (q + b + RARE) of each bin, 0 .. `SURE`; 0 without hue.

    q is the bin's share of the target, b its share of the whole frame.
    """
    contrast = np.maximum(target - frame, 0.0) / (target + frame + RARE)
    contrast[-1] = 0.0
    return np.rint(SURE * contrast).astype(np.uint8)


def hue_shares(hue_deg: float, sd_deg: float, bins: int) -> Floats:
    """(bins + 1,) a Gaussian round the circle of hue, read at the middle of each bin."""
    difference = ((np.arange(bins) + 0.5) * 360.0 / bins - hue_deg + 180.0) % 360.0 - 180.0
    height = np.exp(-0.5 * (difference / max(sd_deg, 180.0 / bins)) ** 2)
    return np.append(height / height.sum(), 0.0)


def _make(parameters: ColorBackprojectionParameters) -> Detector:
    import cv2

    from bayesnet_track.vision.kernels import color_kernels  # noqa: F401  load before the first frame

    nothing = np.zeros(parameters.bins + 1)
    if parameters.hue_deg is not None:
        return ColorBackprojection(
            parameters, hue_shares(parameters.hue_deg, parameters.sd_hue_deg, parameters.bins)
        )
    detector = ColorBackprojection(parameters, nothing)
    if parameters.picture is None:
        return detector
    from bayesnet_track.observation.image_files import PictureError, read_checked

    try:
        data = np.frombuffer(read_checked(Path(parameters.picture)), np.uint8)
        image = cv2.imdecode(data, cv2.IMREAD_COLOR)
    except (PictureError, cv2.error) as error:
        raise DetectorError(f"{parameters.picture}: not a picture that can be read: {error}") from error
    if image is None:
        raise DetectorError(f"{parameters.picture}: not a picture that can be read")
    frame = Frame(0, 0.0, np.asarray(image, dtype=np.uint8))
    box = np.array([(frame.width - 1) / 2, (frame.height - 1) / 2, frame.width, frame.height])
    learnt = detector.learn(FramePair(frame, None), box, detector.start())
    return ColorBackprojection(parameters, learnt["shares"])


DETECTOR = DetectorDeclaration(
    name="color_backprojection",
    summary="Regions in the hues of a target.",
    parameters=ColorBackprojectionParameters,
    make=_make,
    needs_color=True,
    cost_ms=8.0,
)
