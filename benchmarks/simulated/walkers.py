"""People who come and go, cross each other's ways and run side by side: a crowd of known ground truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.boxes import corner_from_centre
from bayesnet_track.sources.scenes.scene import Movie, Sprite, flat, smooth_background
from bayesnet_track.sources.scenes.shapes import winding

Kind = Literal["crossing", "beside"]

LEAST_WIDTH, LEAST_HEIGHT = 720, 480
HEIGHTS_PX, WIDTH_SHARE = (60.0, 100.0), 0.4
SPEEDS_PX = (2.0, 4.0)
LEG = 45
"""Frames before and after the middle of a crossing, or of a run side by side."""
LEAST_ANGLE, CLOSEST = np.pi / 2, 0.25
"""Between the ways of a crossing, radians; how far from each other they may pass, in widths."""
BESIDE, APART, TOGETHER = 1.1, 3.0, 25
"""Distance side by side and at the ends of a run, in mean widths; half the frames side by side."""
NOISE_SD = 4.0


@dataclass(frozen=True)
class CrowdSettings:
    """What a crowd is made of.

    Attributes:
        width: columns of the image.
        height: rows.
        frames: number of frames.
        alone: people who wander from frame 0 on.
        births: mean number of people per frame who come later, anywhere in the image.
        life: mean number of frames until one of them is gone, exponentially distributed.
        crossings: pairs whose ways cross, further people.
        beside: pairs who run side by side for a while, further people.
    """

    width: int = 1280
    height: int = 720
    frames: int = 300
    alone: int = 10
    births: float = 0.05
    life: float = 200.0
    crossings: int = 4
    beside: int = 2

    def __post_init__(self) -> None:
        if self.width < LEAST_WIDTH or self.height < LEAST_HEIGHT:
            least = f"{LEAST_WIDTH}x{LEAST_HEIGHT}"
            raise ValueError(f"image {self.width}x{self.height} px; a crowd needs at least {least}")
        min_frames = 2 * LEG + 1 if self.crossings or self.beside else 1
        if self.frames < min_frames:
            raise ValueError(f"{self.frames} frames; these people need at least {min_frames}")
        for name in ("alone", "births", "crossings", "beside"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ValueError(f"{name} {getattr(self, name):g}; expected a number from 0 on")
        if not 0 < self.life < np.inf:
            raise ValueError(f"life {self.life:g}; expected a number of frames above 0")
        if not self.alone + self.crossings + self.beside:
            raise ValueError("nobody in frame 0 and no pairs; expected at least one of them")


@dataclass(frozen=True)
class Encounter:
    """Two people who meet.

    Attributes:
        kind: whether their ways cross, or they run side by side.
        first: number of one, from 0.
        second: number of the other.
        frame: the middle of it.
    """

    kind: Kind
    first: int
    second: int
    frame: int


@dataclass(frozen=True, eq=False)
class Crowd:
    """Where everybody is, exactly.

    Attributes:
        settings: what it was made of.
        seed: the seed.
        boxes: (frames, n, 4) centre boxes in px, inside the image; NaN where one is not there. A later one is
            nearer to the camera.
        encounters: the pairs.
    """

    settings: CrowdSettings
    seed: int
    boxes: Floats
    encounters: tuple[Encounter, ...]

    def mot_text(self) -> str:
        """Its ground truth as MOT, exact to the last bit; identities from 1."""
        lines = []
        for frame, boxes in enumerate(self.boxes):
            for one in np.flatnonzero(np.isfinite(boxes[:, 0])):
                numbers = ",".join(f"{float(value)!r}" for value in corner_from_centre(boxes[one]))
                lines.append(f"{frame + 1},{one + 1},{numbers},1,-1,-1,-1\n")
        return "".join(lines)

    def movie(self) -> Movie:
        """Its pictures: flat coloured boxes on a blurred background, with noise."""
        rng = np.random.Generator(np.random.Philox(key=[self.seed, 1]))
        background = smooth_background(self.settings.width, self.settings.height, 100.0, 12.0, rng)
        colours = rng.uniform(20, 235, (self.boxes.shape[1], 3))
        sprites = tuple(
            Sprite(flat((float(b), float(g), float(r))), self.boxes[:, one])
            for one, (b, g, r) in enumerate(colours)
        )
        return Movie(background, sprites, NOISE_SD, self.seed)


def make_crowd(settings: CrowdSettings, seed: int = 0) -> Crowd:
    """The crowd of these settings and seed, always the same.

    Raises:
        ValueError: a negative seed.
    """
    if seed < 0:
        raise ValueError(f"a seed is 0 or more, not {seed}")
    rng = np.random.Generator(np.random.Philox(key=[seed, 0]))
    walks, encounters = [], []
    births = rng.poisson(settings.births, settings.frames - 1)
    starts = [0] * settings.alone + np.repeat(np.arange(1, settings.frames), births).tolist()
    walks += [_alone(rng, settings, start) for start in starts]
    kinds: dict[Kind, int] = {"crossing": settings.crossings, "beside": settings.beside}
    for kind in (kind for kind, count in kinds.items() for _ in range(count)):
        middle = int(rng.integers(LEG, settings.frames - LEG))
        encounters.append(Encounter(kind, len(walks), len(walks) + 1, middle))
        walks += [
            _place(path, middle - LEG, settings.frames)
            for path in (_crossing if kind == "crossing" else _beside)(rng, settings)
        ]
    return Crowd(settings, seed, np.stack(walks, axis=1), tuple(encounters))


def _alone(rng: np.random.Generator, settings: CrowdSettings, start: int) -> Floats:
    """(frames, 4) boxes of one who wanders from `start` on until its life ends."""
    size = _size(rng)
    there = min(1 + int(rng.exponential(settings.life)), settings.frames - start)
    low, high = (size - 1) / 2, np.array([settings.width, settings.height]) - 1 - (size - 1) / 2
    path = winding(rng, there, low, high, SPEEDS_PX)
    return _place(np.column_stack([path, np.tile(size, (there, 1))]), start, settings.frames)


def _crossing(rng: np.random.Generator, settings: CrowdSettings) -> tuple[Floats, Floats]:
    """(2 LEG + 1, 4) boxes of two on straight ways, which are close to one point in the middle frame."""
    sizes, middle = (_size(rng), _size(rng)), _middle(rng, settings, 0.0)
    heading = rng.uniform(0, 2 * np.pi)
    headings = (heading, heading + rng.uniform(LEAST_ANGLE, 2 * np.pi - LEAST_ANGLE))
    aside = CLOSEST * min(sizes[0][0], sizes[1][0]) * rng.uniform(-1, 1, 2) / np.sqrt(2)
    first, second = (
        _straight(at, angle, float(rng.uniform(*SPEEDS_PX)), size)
        for at, angle, size in zip((middle, middle + aside), headings, sizes, strict=True)
    )
    return first, second


def _beside(rng: np.random.Generator, settings: CrowdSettings) -> tuple[Floats, Floats]:
    """(2 LEG + 1, 4) boxes of two who come near, run side by side in the middle, and part again."""
    sizes = (_size(rng), _size(rng))
    width = (sizes[0][0] + sizes[1][0]) / 2
    middle = _middle(rng, settings, APART * width)
    heading = rng.choice([-1, 1]) * np.pi / 2 + rng.uniform(-np.pi / 4, np.pi / 4)
    first = _straight(middle, heading, float(rng.uniform(*SPEEDS_PX)), sizes[0])
    away = np.abs(np.arange(-LEG, LEG + 1))
    between = np.interp(away, [TOGETHER, LEG], [BESIDE * width, APART * width]) * rng.choice([-1, 1])
    second = np.column_stack([first[:, 0] + between, first[:, 1], np.tile(sizes[1], (len(first), 1))])
    return first, second


def _straight(at: Floats, heading: float, speed: float, size: Floats) -> Floats:
    way = speed * np.array([np.cos(heading), np.sin(heading)])
    steps = np.arange(-LEG, LEG + 1)[:, None]
    return np.column_stack([at + steps * way, np.tile(size, (len(steps), 1))])


def _middle(rng: np.random.Generator, settings: CrowdSettings, aside: float) -> Floats:
    """A point so far from the borders that nobody leaves the image, not even one `aside` of it."""
    reach = LEG * SPEEDS_PX[1]
    margin = np.array([reach + aside + WIDTH_SHARE * HEIGHTS_PX[1], reach + 0.6 * HEIGHTS_PX[1]])
    image = np.array([settings.width, settings.height], dtype=np.float64)
    return rng.uniform(margin, image - margin)


def _size(rng: np.random.Generator) -> Floats:
    height = rng.uniform(*HEIGHTS_PX)
    return np.array([WIDTH_SHARE * height, height])


def _place(path: Floats, start: int, frames: int) -> Floats:
    """(frames, 4): the path (n, 4) from frame `start` on, NaN before and after."""
    whole = np.full((frames, 4), np.nan)
    whole[start : start + len(path)] = path
    return whole
