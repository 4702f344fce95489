"""Squares that move in straight lines and bounce at the borders (thesis Examples 1 to 3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.sources.scenes.render import ORANGE, Sprite, flat, gray_cells, smooth_background
from bayesnet_track.sources.scenes.scene import Scene, assemble

Point = tuple[float, float]

WIDTH, HEIGHT, SIDE, NOISE_SD = 320, 240, 40.0, 4.0


@dataclass(frozen=True)
class TwoSquares:
    """Where two squares start (centres, px) and how they move (px per frame)."""

    target: Point
    target_step: Point
    other: Point
    other_step: Point


STATED = TwoSquares((270.0, 190.0), (-4.0, -2.74), (50.0, 60.0), (3.5, 1.74))
"""The squares cross near frame 29 and meet again in frames 174 to 183."""


def bouncing(start: Point, step: Point, size: float, frames: int, width: int, height: int) -> Floats:
    """(frames, 4) centre boxes of a square that stays wholly inside the picture, reflected at its borders."""
    travelled = np.array(start) + np.arange(frames)[:, None] * np.array(step)
    low = size / 2 - 0.5
    room = np.array([width, height]) - size
    folded = np.abs((travelled - low + room) % (2 * room) - room)
    return np.column_stack([low + folded, np.full((frames, 2), size)])


def random_geometry(rng: np.random.Generator, frames: int = 200) -> TwoSquares:
    """Two squares that start apart and cross.

    Starts are uniform inside the picture, headings uniform, speeds uniform in 2 .. 5 px per frame. Drawn
    again until (a) the squares do not touch in the first 10 frames, (b) in some frame they overlap by at
    least half of a square's area, and (c) they do not touch in the last frame, so that it can be told which
    of them is held.
    """
    while True:
        starts = rng.uniform([SIDE / 2 - 0.5] * 2, [WIDTH - SIDE / 2 - 0.5, HEIGHT - SIDE / 2 - 0.5], (2, 2))
        heading, speed = rng.uniform(0.0, 2.0 * np.pi, 2), rng.uniform(2.0, 5.0, 2)
        steps = speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
        geometry = TwoSquares(_point(starts[0]), _point(steps[0]), _point(starts[1]), _point(steps[1]))
        target, other = _paths(geometry, frames)
        shared = np.prod(np.clip(SIDE - np.abs(target - other)[:, :2], 0.0, None), axis=1) / SIDE**2
        if shared[:10].max() == 0 and shared.max() >= 0.5 and shared[-1] == 0:
            return geometry


def two_squares(seed: int = 0, geometry: TwoSquares = STATED, frames: int = 200) -> Scene:
    """Two identical orange squares, one of them the target (thesis Example 1).

    320x240 px, squares of 40 px, noise of sd 4; `seed` governs background and noise only.
    """
    target, other = _paths(geometry, frames)
    background = smooth_background(WIDTH, HEIGHT, 100.0, 12.0, _rng(seed))
    sprites = (Sprite(flat(ORANGE), other), Sprite(flat(ORANGE), target))
    return assemble("two_squares", background, sprites, target=1, noise_sd=NOISE_SD, seed=seed)


def orange_and_gray(seed: int = 0, frames: int = 100) -> Scene:
    """An orange square, the target, that a gray patterned one hides in frame 23 (thesis Example 2)."""
    rng = _rng(seed)
    orange = bouncing((270.0, 190.0), (-4.0, -2.74), SIDE, frames, WIDTH, HEIGHT)
    meeting = orange[23, :2]
    step = (meeting - np.array([50.0, 60.0])) / 23
    gray = bouncing((50.0, 60.0), _point(step), SIDE + 4, frames, WIDTH, HEIGHT)
    background = smooth_background(WIDTH, HEIGHT, 100.0, 12.0, rng)
    sprites = (Sprite(flat(ORANGE), orange), Sprite(gray_cells(9, 9, 20, 235, rng), gray))
    return assemble(
        "orange_and_gray",
        background,
        sprites,
        target=0,
        noise_sd=NOISE_SD,
        seed=seed,
        plates=("orange", "gray"),
    )


def gray_square(seed: int = 0, frames: int = 120) -> Scene:
    """A gray patterned square on a gray hilly background: colour says nothing of it (thesis Figure 2.19)."""
    rng = _rng(seed)
    background = smooth_background(WIDTH, HEIGHT, 128.0, 70.0, rng, cell=8)
    path = bouncing((60.0, 70.0), (3.1, 2.2), SIDE, frames, WIDTH, HEIGHT)
    sprites = (Sprite(gray_cells(8, 8, 30, 225, rng), path),)
    return assemble("gray_square", background, sprites, target=0, noise_sd=NOISE_SD, seed=seed)


def _paths(geometry: TwoSquares, frames: int) -> tuple[Floats, Floats]:
    target = bouncing(geometry.target, geometry.target_step, SIDE, frames, WIDTH, HEIGHT)
    return target, bouncing(geometry.other, geometry.other_step, SIDE, frames, WIDTH, HEIGHT)


def _point(pair: Floats) -> Point:
    return float(pair[0]), float(pair[1])


def _rng(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(seed))
