"""Small pictures of a run's frames within a budget of bytes: as large and as many as fit."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Set
from dataclasses import dataclass
from itertools import chain, islice

import numpy as np

from bayesnet_track.numerics.arrays import Image

QUALITY = 50
"""JPEG: WebP as good would be a quarter smaller, and take 15 times as long."""
FULL_QUALITY = 85
SIZES = (
    (800, 1),
    (640, 1),
    (480, 1),
    (400, 1),
    (320, 1),
    (400, 2),
    (320, 2),
    (256, 2),
    (320, 3),
    (256, 3),
    (256, 4),
    (256, 6),
    (200, 8),
)
"""Width in px and step in frames, the best first; width is that of a square picture of the same area."""
SAMPLE = 6


@dataclass(frozen=True)
class Pictures:
    """Encoded pictures of some frames.

    Attributes:
        frames: index of each picture's frame, rising.
        data: one JPEG file per picture.
        step: about every how manyth frame has one.
        annotated: whether what is believed is drawn into them already.
    """

    frames: tuple[int, ...]
    data: tuple[bytes, ...]
    step: int = 1
    annotated: bool = False


def gather(
    images: Iterable[tuple[int, Image]],
    expected: int,
    wanted: Set[int] = frozenset(),
    budget: int = 7_000_000,
    annotated: bool = False,
) -> Pictures:
    """Pictures of `images` (frame, (H, W, 3) uint8 BGR) that take at most `budget` bytes together.

    Width and step are chosen by the first pictures and the `expected` number of frames, so that one pass over
    the source is enough. Where they turn out too large, every other picture goes, again and again; those of
    the frames `wanted` go last.
    """
    source = iter(images)
    first = list(islice(source, SAMPLE))
    if not first:
        return Pictures((), (), 1, annotated)
    width, step = _choose(first, expected, budget)
    kept: dict[int, bytes] = {}
    total = 0
    for frame, image in chain(first, source):
        if frame % step and frame not in wanted:
            continue
        kept[frame] = _encode(image, width)
        total += len(kept[frame])
        while total > budget and len(kept) > 1:
            step *= 2
            kept = _thin(kept, step, wanted)
            total = sum(map(len, kept.values()))
    frames = sorted(kept)
    return Pictures(tuple(frames), tuple(kept[frame] for frame in frames), step, annotated)


def whole(images: Iterable[tuple[int, Image]]) -> Iterator[tuple[int, bytes]]:
    """Every frame in its own size, as JPEG."""
    import cv2

    for frame, image in images:
        done, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, FULL_QUALITY])
        if done:
            yield frame, data.tobytes()


def _choose(sample: list[tuple[int, Image]], expected: int, budget: int) -> tuple[int, int]:
    """The best width and step that are likely to fit, with a margin for harder pictures to come."""
    for width, step in SIZES:
        mean = sum(len(_encode(image, width)) for _, image in sample) / len(sample)
        if 1.15 * mean * expected / step <= budget:
            return width, step
    return SIZES[-1]


def _thin(kept: dict[int, bytes], step: int, wanted: Set[int]) -> dict[int, bytes]:
    left = {frame: data for frame, data in kept.items() if frame % step == 0 or frame in wanted}
    return left if len(left) < len(kept) else dict(list(kept.items())[::2])


def _encode(image: Image, width: int) -> bytes:
    """A JPEG file no larger than asked for, and no larger than the picture."""
    import cv2

    rows, columns = image.shape[:2]
    scale = min(1.0, width / float(np.sqrt(rows * columns)))
    if scale < 1.0:
        size = (max(1, round(columns * scale)), max(1, round(rows * scale)))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    options = [cv2.IMWRITE_JPEG_QUALITY, QUALITY, cv2.IMWRITE_JPEG_OPTIMIZE, 1]
    done, data = cv2.imencode(".jpg", image, options)
    return data.tobytes() if done else b""
