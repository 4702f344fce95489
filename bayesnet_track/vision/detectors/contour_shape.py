"""Detector: closed contours that fit a shape model (thesis 3.3, from contours instead of hypotheses)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import Field, field_validator, model_validator

from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.boxes import centre_from_corner
from bayesnet_track.observation.detector import (
    NOTHING,
    Detections,
    Detector,
    DetectorDeclaration,
    DetectorError,
    DetectorParameters,
    DetectorState,
)
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Region
from bayesnet_track.vision.detectors.selection import select
from bayesnet_track.vision.planes import EdgePlane
from bayesnet_track.vision.shape import (
    COVER,
    ShapeModel,
    ShapeModelError,
    contours,
    fields,
    load_model,
    model_path,
)


class ContourShapeParameters(DetectorParameters):
    """Parameters of the contour detector."""

    model: str = Field(
        description="Shape model file of `bayesnet-track learn-shape`, or a PNG image of a silhouette (path)."
    )
    sd_distance: float = Field(
        default=0.1,
        gt=0,
        description="Standard deviation (root mean square over the box) of the distance from the contour, in "
        "half mean sides of the box, beyond what the model's modes allow.",
    )
    min_support: float = Field(
        default=0.6, gt=0, le=1, description="Least share of a contour that lies on edges (0..1)."
    )
    edge_gray: float = Field(
        default=8.0,
        gt=0,
        le=100,
        description="Gradient at which an edge starts, gray levels of 255 per pixel.",
    )
    blur_px: float = Field(
        default=1.0,
        ge=0,
        le=8,
        description="Standard deviation of the Gaussian that smooths the picture before the edges, pixels.",
    )
    close_px: int = Field(
        default=1, ge=0, le=10, description="Gaps of an outline up to twice as wide are closed (px)."
    )
    min_aspect: float = Field(default=0.2, gt=0, description="Least width of a box over its height.")
    max_aspect: float = Field(default=5.0, gt=0, description="Largest width of a box over its height.")
    max_candidates: int = Field(
        default=48,
        ge=1,
        le=500,
        description="Contours that are compared with the model, the largest (count).",
    )
    min_area_px: float = Field(default=200.0, ge=1, description="Least area of a detection's box (pixels).")

    @field_validator("model")
    @classmethod
    def _readable(cls, path: str) -> str:
        try:
            load_model(path)
        except ShapeModelError as error:
            raise ValueError(f"a shape model file is needed ({error})") from error
        return path

    @model_validator(mode="after")
    def _ordered(self) -> ContourShapeParameters:
        if not self.min_aspect < self.max_aspect:
            raise ValueError(f"min_aspect {self.min_aspect:g} is not below max_aspect {self.max_aspect:g}")
        return self


@dataclass(frozen=True)
class ContourShape:
    """Compares closed contours with a model; no state."""

    parameters: ContourShapeParameters
    model: ShapeModel

    def start(self) -> DetectorState:
        """Nothing to remember."""
        return {}

    def detect(self, frames: FramePair, state: DetectorState) -> tuple[Detections, DetectorState]:
        """Contours like the model's, scored by exp(-energy / 2) and the share on edges."""
        from bayesnet_track.vision.kernels.shape_kernels import score_shapes

        settings, frame = self.parameters, frames.current
        plane = EdgePlane(settings.edge_gray, settings.blur_px)
        points = PlaneCache(frames).planes([plane], Region(0, 0, frame.width, frame.height))[plane]
        edges = points[(points[:, 2] & 1) == 1, :2]
        boxes = self._candidates(edges, frame)
        if len(boxes) == 0:
            return NOTHING, state
        candidates = contours(edges, boxes, np.array([frame.width, frame.height], dtype=np.int64))
        energies, model = np.full(len(boxes), np.inf), self.model
        score_shapes(
            fields(candidates),
            boxes,
            COVER,
            np.arange(len(boxes)),
            boxes,
            model.mean,
            model.modes,
            model.variances,
            model.mean.size * settings.sd_distance**2,
            energies,
        )
        scores = np.where(
            candidates.support >= settings.min_support, np.exp(-0.5 * energies) * candidates.support, 0.0
        )
        return select(boxes, scores, frame, settings), state

    def _candidates(self, edges: Ints, frame: Frame) -> Floats:
        """(C, 4) centre boxes around closed contours, the largest first."""
        import cv2

        settings = self.parameters
        edge_mask = np.zeros((frame.height, frame.width), dtype=np.uint8)
        edge_mask[edges[:, 1], edges[:, 0]] = 1
        if settings.close_px > 0:
            side = 2 * settings.close_px + 1
            edge_mask = cv2.morphologyEx(edge_mask, cv2.MORPH_CLOSE, np.ones((side, side), np.uint8))
        # Edges are 8-connected lines: what they enclose is a 4-connected region of the rest.
        corners = [
            cv2.connectedComponentsWithStats(mask, connectivity=way)[2][1:, :4]
            for mask, way in ((edge_mask, 8), (1 - edge_mask, 4))
        ]
        inner = corners[1]
        open_ = (inner[:, :2] == 0).any(axis=1) | (inner[:, :2] + inner[:, 2:] == edge_mask.shape[::-1]).any(
            axis=1
        )
        inner = inner[~open_] + np.array([-1, -1, 2, 2])  # the line around it belongs to it
        rectangles = np.concatenate([corners[0], inner]).astype(np.float64)
        width, height = np.maximum(rectangles[:, 2:], 1.0).T
        fits = (width * height >= settings.min_area_px) & (width >= settings.min_aspect * height)
        fits &= (width <= settings.max_aspect * height) & (
            width * height <= settings.max_area_share * frame.width * frame.height
        )
        rectangles = np.unique(rectangles[fits], axis=0)
        rectangles = rectangles[np.argsort(-rectangles[:, 2] * rectangles[:, 3], kind="stable")][
            : settings.max_candidates
        ]
        return centre_from_corner(rectangles)


def _make(parameters: ContourShapeParameters) -> Detector:
    import cv2  # noqa: F401  load before the first frame

    from bayesnet_track.vision.kernels import shape_kernels  # noqa: F401

    try:
        return ContourShape(parameters, load_model(parameters.model))
    except ShapeModelError as error:
        raise DetectorError(str(error)) from error


DETECTOR = DetectorDeclaration(
    name="contour_shape",
    summary="Closed contours that fit a shape model.",
    parameters=ContourShapeParameters,
    make=_make,
    cost_ms=20.0,
    files=lambda parameters: (model_path(parameters.model),),
)
