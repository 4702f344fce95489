"""Detector: regions that move against the rest of the picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from bayesnet_track.numerics.arrays import Bytes, Floats
from bayesnet_track.observation.detector import (
    NOTHING,
    Detections,
    Detector,
    DetectorDeclaration,
    DetectorState,
)
from bayesnet_track.observation.planes import FramePair
from bayesnet_track.vision.detectors.selection import SURE, BlobParameters, regions, select
from bayesnet_track.vision.planes import gray

LEAST_SIDE = 16
"""Pictures with a shorter side are too small for the pyramid of the flow."""

MOST = 200
"""Regions that are looked at closely."""

LATTICE = 8
"""The camera's motion is fitted to the flow at every so many pixels, across and down."""

ROUNDS = 8
"""Rounds of the robust fit."""


class MotionDetectorParameters(BlobParameters):
    """Parameters of the motion segmentation."""

    min_speed_px: float = Field(
        default=1.0, gt=0, description="Least speed against the background (px per frame interval)."
    )
    min_change: float = Field(
        default=12.0,
        ge=1,
        le=255,
        description="A pixel has changed when its brightness differs by more than this (gray levels of 255).",
    )
    flow: Literal["fast", "fine"] = Field(
        default="fast",
        description="`fast` takes speeds of small targets for up to a third less than they are; `fine` takes "
        "several times as long.",
    )
    camera: Literal["still", "moving"] = Field(
        default="moving", description="Whether an affine motion of the whole picture is taken out."
    )
    clean_px: int = Field(
        default=2,
        ge=0,
        le=20,
        description="Regions are opened by a square that reaches this far: thinner ones vanish (px; 0: none "
        "do).",
    )


@dataclass(frozen=True, eq=False)
class Moved:
    """Regions that move between two frames against the rest.

    Attributes:
        flow: (H, W, 2) from the current frame back to the previous one, the camera's motion taken off, px.
        evidence: (H, W) half of `SURE` at the least speed, `SURE` from twice that on, 0 below.
        changed: (H, W) where the brightness is not what the camera's motion alone would give.
    """

    flow: NDArray[np.float32]
    evidence: Bytes
    changed: NDArray[np.bool_]


@dataclass(frozen=True)
class MotionDetector:
    """Compares the current frame with the one before; no state."""

    parameters: MotionDetectorParameters

    def start(self) -> DetectorState:
        """Nothing to remember: the previous frame comes with the current one."""
        return {}

    def detect(self, frames: FramePair, state: DetectorState) -> tuple[Detections, DetectorState]:
        """Moving regions; none without an earlier frame of the same size, or in one of a few pixels."""
        settings, frame, previous = self.parameters, frames.current, frames.previous
        if previous is None or previous.image.shape != frame.image.shape or frame.time <= previous.time:
            return NOTHING, state
        if min(frame.width, frame.height) < LEAST_SIDE:
            return NOTHING, state
        motion = _moving(gray(frame.image), gray(previous.image), frame.time - previous.time, settings)
        components = regions((motion.evidence > 0).astype(np.uint8), settings)
        tight = [
            _tighten(motion, components.numbers, int(number), corner)
            for number, corner in zip(components.kept[:MOST], components.corners, strict=False)
        ]
        rows = np.array([row for row in tight if row is not None]).reshape(-1, 5)
        return select(rows[:, :4], rows[:, 4], frame, settings), state


def _moving(current: Bytes, previous: Bytes, interval: float, settings: MotionDetectorParameters) -> Moved:
    """Mask of what moves between two gray images (H, W), `interval` frame intervals apart."""
    import cv2

    current, previous = (cv2.GaussianBlur(picture, (3, 3), 0) for picture in (current, previous))
    preset = cv2.DISOPTICAL_FLOW_PRESET_FAST if settings.flow == "fast" else cv2.DISOPTICAL_FLOW_PRESET_MEDIUM
    flow = cv2.DISOpticalFlow.create(preset).calc(current, previous, None)
    compensated = previous
    if settings.camera == "moving":
        rows, columns = (np.arange(size, dtype=np.float32) for size in current.shape)
        drift = _affine(flow).astype(np.float32)
        expected = drift[0] + drift[1] * columns[None, :, None] + drift[2] * rows[:, None, None]
        x_before, y_before = expected[..., 0] + columns, expected[..., 1] + rows[:, None]
        compensated = cv2.remap(
            previous, x_before, y_before, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        flow = flow - expected
        # what comes into the picture is new to it, not changed
        beyond = (
            (x_before < 0)
            | (y_before < 0)
            | (x_before > current.shape[1] - 1)
            | (y_before > current.shape[0] - 1)
        )
        flow[beyond], compensated[beyond] = 0.0, current[beyond]
    limit = settings.min_speed_px * interval
    speed = np.hypot(flow[..., 0], flow[..., 1])
    share = np.minimum(speed * np.float32(SURE / (2.0 * limit)), np.float32(SURE))
    evidence = np.where(speed >= limit, np.maximum(share, 1.0), 0.0).astype(np.uint8)
    return Moved(flow, evidence, cv2.absdiff(current, compensated) > settings.min_change)


def _tighten(
    motion: Moved, numbers: NDArray[np.int32], number: int, corner: NDArray[np.int64]
) -> tuple[float, float, float, float, float] | None:
    """Centre box and score of a region; None when nothing in it has changed: without texture flow is a guess.

    Flow spreads beyond a target. What has changed spans the target in both frames; its box now is without the
    strip that it left, as wide as it moved.
    """
    x, y, w, h = (int(value) for value in corner)
    window = (slice(y, y + h), slice(x, x + w))
    in_region = numbers[window] == number
    has_changed = in_region & motion.changed[window]
    if not has_changed.any():
        return None
    left_x, left_y = -np.median(motion.flow[window][has_changed], axis=0)
    columns, rows = (np.flatnonzero(has_changed.any(axis=axis)) for axis in (0, 1))
    low, high = np.array([columns[0], rows[0]]) - 0.5, np.array([columns[-1], rows[-1]]) + 0.5
    step = np.array([left_x, left_y])
    step = np.clip(step, -0.5 * (high - low), 0.5 * (high - low))
    low, high = low + np.maximum(step, 0.0), high + np.minimum(step, 0.0)
    begin, end = np.floor(low + 0.5).astype(int), np.ceil(high + 0.5).astype(int)
    part = (slice(begin[1], end[1]), slice(begin[0], end[0]))
    evidence = motion.evidence[window][part][in_region[part]].sum(dtype=np.int64)
    score = float(evidence) / (SURE * float(np.prod(end - begin)))
    centre, size = (low + high) / 2 + (x, y), high - low
    return float(centre[0]), float(centre[1]), float(size[0]), float(size[1]), score


def _affine(flow: NDArray[np.float32]) -> Floats:
    """(3, 2) coefficients of 1, x and y of the affine motion that most of a flow (H, W, 2) follows.

    Least squares, reweighted by 1 / (1 + (residual / scale)^2)^2 (Geman and McClure), the scale that of the
    median residual; starts from the median motion, so that less than half of the picture may move otherwise.
    """
    half = LATTICE // 2
    sampled = flow[half::LATTICE, half::LATTICE].astype(np.float64)
    y, x = np.mgrid[half : flow.shape[0] : LATTICE, half : flow.shape[1] : LATTICE].reshape(2, -1)
    values, base = sampled.reshape(-1, 2), np.column_stack([np.ones(x.size), x, y])
    scales = np.array([1.0, flow.shape[1], flow.shape[0]])
    base = base / scales
    fitted = np.zeros((3, 2))
    fitted[0] = np.median(values, axis=0)
    for _ in range(ROUNDS):
        residuals = np.hypot(*(values - np.einsum("nk,kc->nc", base, fitted)).T)
        scale = max(1.4826 * float(np.median(residuals)), 0.1)
        weight = 1.0 / (1.0 + (residuals / scale) ** 2) ** 2
        normal = np.einsum("nk,n,nj->kj", base, weight, base) + 1e-6 * weight.sum() * np.eye(3)
        fitted = np.linalg.solve(normal, np.einsum("nk,n,nc->kc", base, weight, values))
    return np.asarray(fitted / scales[:, None])


def _make(parameters: MotionDetectorParameters) -> Detector:
    import cv2  # noqa: F401  load before the first frame

    return MotionDetector(parameters)


DETECTOR = DetectorDeclaration(
    name="motion",
    summary="Regions that move against the rest of the image.",
    parameters=MotionDetectorParameters,
    make=_make,
    cost_ms=27.0,
)
