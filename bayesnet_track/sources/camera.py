"""A camera as a source: true times from the clock, through OpenCV."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from bayesnet_track.sources.entrances.levels import Levels, ValueRange
from bayesnet_track.sources.live import Image, LiveReader
from bayesnet_track.sources.paths import SourceError

DEFAULT_RATE = 30.0
MOST = 2**31 - 1


class Camera:
    """The pictures of the camera with this index, as they come.

    Raises:
        SourceError: there is no such camera.
    """

    def __init__(self, index: str, levels: Levels) -> None:
        import cv2

        self._levels = levels
        # OpenCV takes 32 bits, and Python reads no number of thousands of digits.
        number = int(index) if len(index) < len(str(MOST)) else MOST
        self._camera: Any = cv2.VideoCapture(number)
        if not self._camera.isOpened():
            raise SourceError(
                index,
                "no camera with this index can be opened",
                "index of a connected camera",
                "check the connection",
            )
        rate = float(self._camera.get(cv2.CAP_PROP_FPS))
        self.frame_interval_s = 1.0 / (rate if np.isfinite(rate) and rate > 0 else DEFAULT_RATE)

    def __iter__(self) -> Iterator[Image]:
        while True:
            ok, image = self._camera.read()
            if not ok:
                raise OSError("the camera stopped giving pictures")
            yield self._levels(image)

    def close(self) -> None:
        """Let go of the camera."""
        self._camera.release()


def camera_reader(index: str, value_range: ValueRange | None = None) -> LiveReader:
    """The newest pictures of a camera, in units of the rate that it declares (else 30 a second).

    Raises:
        SourceError: there is no such camera.
    """
    levels = Levels(f"camera {index}", value_range)
    first = Camera(index, levels)
    return LiveReader(lambda: Camera(index, levels), first.frame_interval_s, first)
