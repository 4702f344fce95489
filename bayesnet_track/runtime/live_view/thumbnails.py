"""Small pictures of a run in progress: encoded beside it, at a limited rate and within a budget of bytes."""

from __future__ import annotations

import threading
import time
from bisect import bisect_right
from collections import deque
from collections.abc import Callable

import numpy as np

from bayesnet_track.numerics.arrays import Image

PER_SECOND = 20.0
WAITING = 4
"""Pictures that may wait for the encoder; one that comes when so many wait is left out."""

BUDGET = 64_000_000
AREA = 640 * 480
QUALITY = 72


class Thumbnails:
    """Pictures of frames, encoded by a thread of their own. Who offers one never waits.

    Args:
        notify: called by that thread whenever there is a new one.
        budget: bytes that all may take together; beyond it, every other of the older half goes.
        per_second: how many are taken at most, besides those that must be.
    """

    def __init__(
        self,
        notify: Callable[[], None] = lambda: None,
        budget: int = BUDGET,
        per_second: float = PER_SECOND,
    ) -> None:
        self._notify, self._budget, self._pause_s = notify, budget, 1.0 / per_second
        self._news = threading.Condition()
        self._waiting: deque[tuple[int, Image]] = deque()
        self._kept: dict[int, bytes] = {}
        self._order: list[int] = []
        self._musts: set[int] = set()
        self._size, self._due, self._is_closed = 0, 0.0, False
        threading.Thread(target=self._encode, name="thumbnails", daemon=True).start()

    def offer(self, frame: int, image: Image, must: bool = False) -> None:
        """Take the picture (H, W, 3) uint8 BGR of a frame, if it is time for one or it `must` be there."""
        now = time.monotonic()
        with self._news:
            full = len(self._waiting) >= (4 * WAITING if must else WAITING)
            if full or frame in self._kept or not (must or now >= self._due):
                return
            self._due = now + self._pause_s
            if must:
                self._musts.add(frame)
            self._waiting.append((frame, image))
            self._news.notify()

    def of(self, frame: int) -> tuple[int, bytes] | None:
        """The JPEG of the newest picture that is not later than `frame`, else the first, and its frame."""
        with self._news:
            if not self._order:
                return None
            found = self._order[max(0, bisect_right(self._order, frame) - 1)]
            return found, self._kept[found]

    @property
    def newest(self) -> int:
        """The last frame that has a picture; -1 where none has."""
        with self._news:
            return self._order[-1] if self._order else -1

    def close(self) -> None:
        """Encode no more."""
        with self._news:
            self._is_closed = True
            self._news.notify()

    def _encode(self) -> None:
        while True:
            with self._news:
                self._news.wait_for(lambda: self._waiting or self._is_closed)
                if self._is_closed:
                    return
                frame, image = self._waiting[0]
            data = encode(image)
            with self._news:
                self._waiting.popleft()
                if data and frame not in self._kept:
                    self._kept[frame] = data
                    self._order.insert(bisect_right(self._order, frame), frame)
                    self._size += len(data)
                    self._thin()
            self._notify()

    def _thin(self) -> None:
        """Every other of the older half goes; those that must be there only if nothing else is left to go."""
        while self._size > self._budget and len(self._order) > 2:
            half = self._order[: len(self._order) // 2]
            spare = [frame for frame in half if frame not in self._musts] or half
            for frame in spare[::2]:
                self._size -= len(self._kept.pop(frame))
            self._order = [frame for frame in self._order if frame in self._kept]


def encode(image: Image) -> bytes:
    """A JPEG of at most about 640 x 480 px; empty where there is none."""
    import cv2

    rows, columns = image.shape[:2]
    scale = float(np.sqrt(AREA / (rows * columns)))
    if scale < 1.0:
        size = (max(1, round(columns * scale)), max(1, round(rows * scale)))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    done, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return data.tobytes() if done else b""
