"""A camera as a source: true times from the clock, through OpenCV."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.runtime.frames import Damage, Picture, SourceError

DEFAULT_RATE = 30.0


class CameraReader:
    """Pictures of the camera with this index until it stops giving any.

    Times are those of arrival, in units of the rate that the camera declares (30 a second when it declares
    none). A picture that comes late by a frame or more counts as a gap.

    Raises:
        SourceError: there is no such camera.
    """

    gap_from = 2.0
    declared_frames: int | None = None

    def __init__(self, index: str) -> None:
        import cv2

        self._camera: Any = cv2.VideoCapture(int(index))
        if not self._camera.isOpened():
            raise SourceError(
                index,
                "no camera with this index can be opened",
                "index of a connected camera",
                "check the connection",
            )
        rate = float(self._camera.get(cv2.CAP_PROP_FPS))
        self.frame_interval_s = 1.0 / (rate if np.isfinite(rate) and rate > 0 else DEFAULT_RATE)

    def __iter__(self) -> Iterator[Picture | Damage]:
        began: float | None = None
        index = 0
        while True:
            ok, image = self._camera.read()
            now = time.monotonic()
            if not ok:
                yield Damage(index, "the camera stopped giving pictures")
                return
            began = now if began is None else began
            yield Picture(index, (now - began) / self.frame_interval_s, now - began, _given(image))
            index += 1

    def close(self) -> None:
        """Let go of the camera."""
        self._camera.release()


def _given(image: Any) -> Any:
    pixels: NDArray[np.uint8] = np.ascontiguousarray(image, dtype=np.uint8)
    return lambda: (pixels, True)
