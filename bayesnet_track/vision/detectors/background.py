"""Detector: what differs from the usual picture, by a mixture of Gaussians at each pixel."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from bayesnet_track.observation.detector import (
    NOTHING,
    Detections,
    Detector,
    DetectorDeclaration,
    DetectorState,
)
from bayesnet_track.observation.planes import FramePair
from bayesnet_track.vision.detectors.selection import BlobParameters, blobs, select

EVERY = 4
"""The gain is taken from every so many pixels, across and down."""

GAIN = 4.0
"""Largest change of brightness that is followed, as a factor."""

MIN_SD, FIRST_SD = 4.0, 12.0
"""Least standard deviation of a Gaussian, and that with which it starts, gray levels of 255."""


class BackgroundParameters(BlobParameters):
    """Parameters of the background subtraction."""

    modes: int = Field(
        default=3, ge=2, le=5, description="Gaussians of each pixel: background, and what passes (count)."
    )
    memory_frames: float = Field(
        default=200.0,
        ge=2,
        description="How long the background is remembered: the learning rate is 1 - exp(-dt / memory) "
        "(frame intervals).",
    )
    warm_up_frames: float = Field(
        default=25.0, ge=0, description="Nothing is detected so long after the start (frame intervals)."
    )
    match_sd: float = Field(
        default=4.0,
        gt=0,
        description="A pixel belongs to a Gaussian within this distance (standard deviations).",
    )
    background_share: float = Field(
        default=0.6,
        gt=0,
        lt=1,
        description="The strongest Gaussians that have this weight together are background (0..1).",
    )
    shadows: bool = Field(default=True, description="Shadows on the background are not detected.")
    darkest: float = Field(
        default=0.5, gt=0, lt=1, description="A shadow leaves at least this share of the brightness (0..1)."
    )
    shadow_chroma: float = Field(
        default=6.0,
        gt=0,
        description="And changes the colour by this at most, beyond making it darker (root mean square, gray "
        "levels of 255).",
    )
    restart_above: float = Field(
        default=0.7,
        gt=0,
        le=1,
        description="Where more of the frame is foreground, the background is learnt anew (share of pixels).",
    )
    join_px: int = Field(
        default=3,
        ge=0,
        le=50,
        description="Regions are closed by a square that reaches this far: gaps up to twice as wide vanish "
        "(px).",
    )


@dataclass(frozen=True)
class _Background:
    """A picture of what is usual, learnt while it runs.

    State: ``weights`` (H, W, K), ``means`` (H, W, K, 3), ``variances`` (H, W, K) float32 of the mixtures, the
    strongest mode first; ``times`` (2,) float64, of the last frame and of the start, in frame intervals.
    """

    parameters: BackgroundParameters

    def start(self) -> DetectorState:
        """No picture yet."""
        return _empty(0, 0, self.parameters.modes, 0.0)

    def detect(self, frames: FramePair, state: DetectorState) -> tuple[Detections, DetectorState]:
        """Regions that are neither background nor shadow; none while the background is still learnt."""
        evidence, next_state = self.segment(frames, state)
        settings, frame = self.parameters, frames.current
        from bayesnet_track.vision.kernels.color_kernels import FOREGROUND

        if frame.time - next_state["times"][1] < settings.warm_up_frames or not evidence.any():
            return NOTHING, next_state
        return select(*blobs(evidence, FOREGROUND, settings), frame, settings), next_state

    def segment(self, frames: FramePair, state: DetectorState) -> tuple[NDArray[np.uint8], DetectorState]:
        """(H, W) evidence as `update_mixture` has it, and the state with this frame in it."""
        from bayesnet_track.vision.kernels.color_kernels import FOREGROUND, update_mixture

        settings, frame = self.parameters, frames.current
        evidence = np.zeros((frame.height, frame.width), dtype=np.uint8)
        elapsed = frame.time - float(state["times"][0])
        if state["weights"].shape[:2] != evidence.shape or elapsed <= 0:
            return evidence, self._first(frame.image, frame.time)
        image = np.ascontiguousarray(frame.image)
        next_state = {name: np.array(array) for name, array in state.items()}
        next_state["times"][0] = frame.time
        # At first every frame counts the same, as in a mean over all of them.
        rate = max(
            1.0 - math.exp(-elapsed / settings.memory_frames),
            elapsed / (frame.time - float(next_state["times"][1]) + 1.0),
        )
        update_mixture(
            image,
            gain_of(image, next_state["means"][:, :, 0]),
            min(rate, 1.0),
            next_state["weights"],
            next_state["means"],
            next_state["variances"],
            settings.match_sd**2,
            settings.background_share,
            MIN_SD**2,
            FIRST_SD**2,
            settings.darkest if settings.shadows else 1.0,
            settings.shadow_chroma**2,
            evidence,
        )
        if np.count_nonzero(evidence >= FOREGROUND) > settings.restart_above * evidence.size:
            return np.zeros_like(evidence), self._first(frame.image, frame.time)
        return evidence, next_state

    def _first(self, image: NDArray[np.uint8], time: float) -> DetectorState:
        state = _empty(image.shape[0], image.shape[1], self.parameters.modes, time)
        state["weights"][:, :, 0] = 1.0
        state["means"][:, :, 0] = image
        state["variances"][:] = FIRST_SD**2
        return state


def gain_of(image: NDArray[np.uint8], mean: NDArray[np.float32]) -> float:
    """Brightness of an image (H, W, 3) over that of the background (H, W, 3): the median over pixels.

    Of each pixel, I . B / B . B: the brightness distortion of Horprasert et al. (1999) with equal variances.
    """
    current, expected = (
        part[EVERY // 2 :: EVERY, EVERY // 2 :: EVERY].astype(np.float64).reshape(-1, 3)
        for part in (image, mean)
    )
    bright = (expected**2).sum(axis=1)
    is_bright = bright > 3 * 10.0**2  # of a black pixel there is no ratio
    if not is_bright.any():
        return 1.0
    ratio = float(np.median((current[is_bright] * expected[is_bright]).sum(axis=1) / bright[is_bright]))
    return min(max(ratio, 1.0 / GAIN), GAIN)


def _empty(rows: int, columns: int, modes: int, time: float) -> dict[str, NDArray[np.generic]]:
    return {
        "weights": np.zeros((rows, columns, modes), dtype=np.float32),
        "means": np.zeros((rows, columns, modes, 3), dtype=np.float32),
        "variances": np.zeros((rows, columns, modes), dtype=np.float32),
        "times": np.array([time, time], dtype=np.float64),
    }


def _make(parameters: BackgroundParameters) -> Detector:
    import cv2  # noqa: F401  load before the first frame

    from bayesnet_track.vision.kernels import color_kernels  # noqa: F401

    return _Background(parameters)


DETECTOR = DetectorDeclaration(
    name="background",
    summary="What differs from the usual image (the background), without shadows.",
    parameters=BackgroundParameters,
    make=_make,
    cost_ms=40.0,
)
