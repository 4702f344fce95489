"""Many discs alike that cross each other's ways at random."""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.sources.scenes.render import ORANGE, Sprite, flat, smooth_background
from bayesnet_track.sources.scenes.scene import Scene, assemble

WIDTH, HEIGHT, SIDE, NOISE_SD = 640, 480, 28.0, 4.0
SPEEDS = (1.5, 4.0)
TURN_SD = 0.06
"""Change of heading per frame, radians."""
BORDER, TURN_BACK = 60.0, 0.25
"""Distance from a border, px, from which on it turns away, and how strongly at the border itself."""

REFUSED = 400
"""Places in a row that are not free, after which there is no room."""


def crowd(seed: int = 0, count: int = 10, frames: int = 200) -> Scene:
    """`count` orange discs, all alike, on winding ways from border to border; the first is the target.

    640x480 px, discs of 28 px, speeds uniform in 1.5 .. 4 px per frame, headings a random walk. None touches
    another in the first 5 frames; a later one hides an earlier one.

    Raises:
        ValueError: so many find no place apart from each other.
    """
    rng = np.random.Generator(np.random.Philox(seed))
    paths: list[Floats] = []
    refused = 0
    while len(paths) < count:
        inset = np.full(2, (SIDE - 1) / 2)
        places = winding(rng, frames, inset, np.array([WIDTH, HEIGHT]) - 1 - inset, SPEEDS)
        begins = places[:5]
        if all(np.abs(begins - other[:5, :2]).max(axis=1).min() > SIDE + 2 for other in paths):
            paths.append(np.column_stack([places, np.full((frames, 2), SIDE)]))
            refused = 0
        elif (refused := refused + 1) == REFUSED:
            raise ValueError(f"no room for {count} discs")
    background = smooth_background(WIDTH, HEIGHT, 100.0, 12.0, rng)
    sprites = tuple(Sprite(flat(ORANGE), path, is_round=True) for path in paths)
    return assemble("crowd", background, sprites, 0, NOISE_SD, seed, plates=("disc",) * count)


def winding(
    rng: np.random.Generator, frames: int, low: Floats, high: Floats, speeds: tuple[float, float]
) -> Floats:
    """(frames, 2) places that turn a little in each frame, and away from the borders `low` and `high` (2,).

    Place, heading and speed, in px per frame, are drawn once; they never leave the borders.
    """
    place, speed, heading = rng.uniform(low, high), rng.uniform(*speeds), rng.uniform(0.0, 2 * np.pi)
    turns = rng.normal(0.0, TURN_SD, frames)
    path = np.empty((frames, 2))
    for frame in range(frames):
        path[frame] = place
        ahead = speed * np.array([np.cos(heading + turns[frame]), np.sin(heading + turns[frame])])
        inward = np.clip(low + BORDER - place, 0.0, None) - np.clip(place - high + BORDER, 0.0, None)
        ahead += inward * (speed / BORDER) * TURN_BACK
        heading = float(np.arctan2(ahead[1], ahead[0]))
        place = np.clip(place + speed * ahead / np.linalg.norm(ahead), low, high)
    return path
