"""Videos in which something happens to the target, made from real sequences: always the same for one seed.

    python benchmarks/event_videos.py DATA_FOLDER OUT_FOLDER --half both --kind "patch in front" --seed 21

Every video begins with `BEFORE` frames as they are. Then the target leaves the view (a window on the frames
moves away from it), a patch of another colour slides in front of it and moves with it, the frames are black,
or a copy of the target crosses behind it, as large and as bright in every frame. The command writes one of
each sequence as NAME/img/*.png and NAME/groundtruth.txt, which has no box where the target is hidden.
"""

from __future__ import annotations

import argparse
import random
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import cv2
import numpy as np
from measuring import Image
from numpy.typing import NDArray
from sequences import HALVES, Sequence, find_sequences

Boxes = NDArray[np.float64]

BEFORE = 15
"""Frames in which nothing happens, the first included."""
SLIDE = 5
"""Frames in which the patch, or the border of the view, comes over the target."""
AWAY = 30
"""Frames in which the target is away or hidden entirely."""
BLACK = 10
"""Black frames."""
CROSSING = 30
"""Frames in which the look-alike crosses from one side of the target to the other."""
FAR = 3.0
"""How far away it begins and ends, roots of the box's area."""
AFTER = 10
"""Frames after the event."""
BEYOND = 30
"""Frames after a crossing, so that it is seen how long the doubt lasts."""
LEAST_FRAMES = BEFORE + max(SLIDE + AWAY + SLIDE + AFTER, BLACK + 2 * AFTER, CROSSING + BEYOND)


@dataclass(frozen=True, eq=False)
class EventVideo:
    """One video.

    Attributes:
        sequence: what it was made of.
        images: its frames.
        truth: (n, 4) corner boxes of the target, in the coordinates of the video, seen or not.
        hidden: (n,) whether nothing of the target is to be seen.
        other: (n, 4) corner boxes of the look-alike; NaN where there is none.
    """

    sequence: str
    images: list[Image]
    truth: Boxes
    hidden: NDArray[np.bool_]
    other: Boxes


def make_videos(kind: str, sequences: list[Sequence], count: int, seed: int) -> list[EventVideo]:
    """The videos of one kind of `count` sequences, drawn by the seed among those that are long enough."""
    able = [one for one in sequences if len(one.files) >= LEAST_FRAMES]
    order = random.Random(seed).sample(able, len(able))
    found: list[EventVideo] = []
    for one in order:
        coin = random.Random(f"{seed} {kind} {one.name}")
        video = MAKERS[kind](one, coin) if len(found) < count else None
        if video is not None:
            found.append(video)
    return found


def leave(sequence: Sequence, coin: random.Random) -> EventVideo | None:
    """The view turns away from the target; None where the frame has no room for a view without it."""
    del coin
    images, truth = _cut(sequence, BEFORE + SLIDE + AWAY)
    size = np.array([images[0].shape[1], images[0].shape[0]])
    low, high = truth[:, :2].min(axis=0), (truth[:, :2] + truth[:, 2:]).max(axis=0)
    start_low = truth[:BEFORE, :2].min(axis=0)
    start_high = (truth[:BEFORE, :2] + truth[:BEFORE, 2:]).max(axis=0)
    room = np.concatenate([low - 2, size - high - 2])  # left of it, above, right of it, below
    side = int(np.argmax(room / np.tile(size, 2)))
    axis = side % 2
    span = int(min(room[side], 0.6 * size[axis]))
    if span < 1.2 * (start_high - start_low)[axis]:
        return None
    middle = (start_low[axis] + start_high[axis]) / 2
    first = int(np.clip(middle - span / 2, 0, size[axis] - span))
    last = int(low[axis] - 2 - span) if side < 2 else int(high[axis] + 2)
    last = int(np.clip(last, 0, size[axis] - span))
    path = [*[first] * BEFORE, *np.linspace(first, last, SLIDE + 1).astype(int)[1:], *[last] * AWAY]
    seen, moved = [], truth.copy()
    for index, at in enumerate(path):
        part = images[index][:, at : at + span] if axis == 0 else images[index][at : at + span]
        seen.append(np.ascontiguousarray(part))
        moved[index, axis] -= at
    out = (moved[:, axis] + moved[:, 2 + axis] <= 0) | (moved[:, axis] >= span)
    return EventVideo(sequence.name, seen, moved, out, np.full(truth.shape, np.nan))


def cover(sequence: Sequence, coin: random.Random) -> EventVideo:
    """A patch of the colour that is farthest from the target's slides over it, and away again."""
    images, truth = _cut(sequence, BEFORE + SLIDE + AWAY + SLIDE + AFTER)
    inside = np.linspace(1.3, 0.0, SLIDE + 1)[1:]
    offsets = [*inside, *[0.0] * (AWAY - 2), *-inside[::-1], -1.3]
    hidden = np.zeros(len(images), np.bool_)
    hidden[cover_target(images, truth, BEFORE, offsets, coin)] = True
    return EventVideo(sequence.name, images, truth, hidden, np.full(truth.shape, np.nan))


def cover_target(
    images: list[Image], truth: Boxes, first: int, offsets: list[float], coin: random.Random
) -> list[int]:
    """Fill a patch into the images from the `first` on, so many box widths beside the target.

    Returned are the frames in which it hides the target.
    """
    colour = _farthest(images[0], truth[0])
    grain = np.random.default_rng(coin.randrange(2**32))
    side, covered = coin.choice((-1, 1)), []
    for index, offset in enumerate(offsets, start=first):
        x, y, w, h = truth[index]
        left, top = x - 0.15 * w + side * offset * w, y - 0.15 * h
        _fill(images[index], (left, top, 1.3 * w, 1.3 * h), colour, grain)
        covered += [index] if offset == 0.0 else []
    return covered


def darken(sequence: Sequence, coin: random.Random) -> EventVideo:
    """Black frames."""
    del coin
    images, truth = _cut(sequence, BEFORE + BLACK + 2 * AFTER)
    hidden = np.zeros(len(images), np.bool_)
    hidden[BEFORE : BEFORE + BLACK] = True
    images = [np.zeros_like(image) if dark else image for image, dark in zip(images, hidden, strict=True)]
    return EventVideo(sequence.name, images, truth, hidden, np.full(truth.shape, np.nan))


def cross(sequence: Sequence, coin: random.Random) -> EventVideo:
    """A copy of the target as it looks in that very frame passes behind it."""
    images, truth = _cut(sequence, BEFORE + CROSSING + BEYOND)
    other = np.full(truth.shape, np.nan)
    side, above = coin.choice((-1, 1)), coin.choice((-1, 1))
    away = [*np.linspace(FAR, -FAR, CROSSING), *[-FAR] * BEYOND]
    for index, distance in enumerate(away, start=BEFORE):
        x, y, w, h = truth[index]
        place = x + side * distance * np.sqrt(w * h), y + 0.3 * above * h
        own = images[index].copy()
        _paste(images[index], own, truth[index], place)
        _paste(images[index], own, truth[index], (x, y))
        other[index] = (*place, w, h)
    return EventVideo(sequence.name, images, truth, np.zeros(len(images), np.bool_), other)


MAKERS: dict[str, Callable[[Sequence, random.Random], EventVideo | None]] = {
    "leaves": leave,
    "patch in front": cover,
    "black frames": darken,
    "look-alike": cross,
}


def _cut(sequence: Sequence, frames: int) -> tuple[list[Image], Boxes]:
    images = [image for image, _ in zip(sequence.images(), range(frames), strict=False)]
    return images, sequence.truth[: len(images)].copy()


def _farthest(image: Image, box: Boxes) -> Boxes:
    """(3,) the corner of the colour cube that is farthest from the mean colour in the box; gray in gray."""
    x, y, w, h = (round(float(value)) for value in box)
    part = image[max(y, 0) : max(y, 0) + h, max(x, 0) : max(x, 0) + w].reshape(-1, 3).astype(np.float64)
    mean = part.mean(axis=0)
    is_gray = bool((image == image[:, :, :1]).all())
    corners = np.array([(v, v, v) for v in (30, 225)] if is_gray else list(product((30, 225), repeat=3)))
    return np.asarray(corners[np.argmax(np.linalg.norm(corners - mean, axis=1))], np.float64)


def _fill(
    image: Image, box: tuple[float, float, float, float], colour: Boxes, grain: np.random.Generator
) -> None:
    rows, columns = _pixels(image, box)
    count = (rows.stop - rows.start, columns.stop - columns.start)
    noise = grain.normal(0.0, 6.0, (*count, 1))
    image[rows, columns] = np.clip(colour + noise, 0, 255).astype(np.uint8)


def _pixels(image: Image, box: tuple[float, float, float, float]) -> tuple[slice, slice]:
    x, y, w, h = box
    x0, x1 = (int(np.clip(round(v), 0, image.shape[1])) for v in (x, x + w))
    y0, y1 = (int(np.clip(round(v), 0, image.shape[0])) for v in (y, y + h))
    return slice(y0, y1), slice(x0, x1)


def _paste(image: Image, source: Image, box: Boxes, place: tuple[float, float]) -> None:
    """Lay the ellipse in the source's corner box (4,), soft at its rim, at the corner `place`."""
    rows, columns = _pixels(source, (box[0], box[1], box[2], box[3]))
    part = source[rows, columns].astype(np.float64)
    height, width = part.shape[:2]
    if height == 0 or width == 0:
        return
    down, across = np.mgrid[:height, :width]
    radius = np.hypot(
        (across - (width - 1) / 2) / max(width / 2, 1), (down - (height - 1) / 2) / max(height / 2, 1)
    )
    cover = np.clip((1.0 - radius) / 0.2 + 0.5, 0.0, 1.0)[:, :, None]
    left = round(float(place[0] + columns.start - box[0]))
    top = round(float(place[1] + rows.start - box[1]))
    x0, x1 = max(left, 0), min(left + width, image.shape[1])
    y0, y1 = max(top, 0), min(top + height, image.shape[0])
    if x1 <= x0 or y1 <= y0:
        return
    inner = np.s_[y0 - top : y1 - top, x0 - left : x1 - left]
    under = image[y0:y1, x0:x1].astype(np.float64)
    mixed = cover[inner] * part[inner] + (1.0 - cover[inner]) * under
    image[y0:y1, x0:x1] = np.round(mixed).astype(np.uint8)


def write_video(video: EventVideo, folder: Path) -> None:
    """Write it as a sequence of pictures with ground truth."""
    (folder / "img").mkdir(parents=True)
    for index, image in enumerate(video.images, start=1):
        cv2.imwrite(str(folder / "img" / f"{index:04}.png"), image)
    seen = np.where(video.hidden[:, None], np.nan, video.truth)
    np.savetxt(folder / "groundtruth.txt", seen, delimiter=",", fmt="%.3f")


def main() -> None:
    """Write the videos of one kind."""
    parser = argparse.ArgumentParser(description="Write videos in which something happens to the target.")
    parser.add_argument("data_folder", type=Path)
    parser.add_argument("out_folder", type=Path)
    parser.add_argument("--half", choices=(*HALVES, "both"), default="both")
    parser.add_argument("--kind", choices=(*MAKERS,), required=True)
    parser.add_argument("--seed", type=int, default=21)
    options = parser.parse_args()
    halves = HALVES if options.half == "both" else [options.half]
    for half in halves:
        sequences = find_sequences(options.data_folder, list(HALVES[half]), 150)
        for video in make_videos(options.kind, sequences, len(sequences), options.seed):
            write_video(video, options.out_folder / f"{video.sequence}_{options.kind.replace(' ', '_')}")


if __name__ == "__main__":
    main()
