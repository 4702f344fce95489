"""A target that passes behind a textured column and is hidden for a stated number of frames."""

from __future__ import annotations

import numpy as np

from bayesnet_track.sources.scenes.render import ORANGE, Sprite, shaded_cells, smooth_background
from bayesnet_track.sources.scenes.scene import Scene, assemble

WIDTH, HEIGHT, SIDE, SPEED, FRAMES = 320, 240, 40.0, 4.0, 60
STEEL = (150.0, 125.0, 100.0)
"""BGR of the column: a dull blue."""


def occluder(seed: int = 0, hidden: int = 11) -> Scene:
    """An orange patterned square crosses from left to right at 4 px per frame, behind a column.

    It is hidden entirely in exactly `hidden` consecutive frames (1 .. 38), in the middle of the 60 frames;
    `seed` governs its height, its vertical drift (up to 1 px per frame), patterns and noise.

    Raises:
        ValueError: `hidden` outside 1 .. 38.
    """
    if not 1 <= hidden <= 38:
        raise ValueError(f"hidden must be 1 to 38 frames, not {hidden}")
    rng = np.random.Generator(np.random.Philox(seed))
    frame = np.arange(FRAMES)
    y = rng.uniform(90.0, 150.0) + (frame - FRAMES / 2) * rng.uniform(-1.0, 1.0)
    path = np.column_stack([40.0 + SPEED * frame, y, np.full((FRAMES, 2), SIDE)])
    # A quarter step of slack on either side: hidden at the first and the last of these frames, not beyond.
    first = (FRAMES - hidden) // 2
    middle = (path[first, 0] + path[first + hidden - 1, 0]) / 2
    width = SIDE + (hidden - 1) * SPEED + SPEED / 2
    column = np.tile([middle, (HEIGHT - 1) / 2, width, float(HEIGHT)], (FRAMES, 1))
    background = smooth_background(WIDTH, HEIGHT, 100.0, 12.0, rng)
    sprites = (
        Sprite(shaded_cells(8, 8, ORANGE, 0.45, rng), path),
        Sprite(shaded_cells(48, max(int(width / 5), 1), STEEL, 0.4, rng), column),
    )
    return assemble("occluder", background, sprites, target=0, noise_sd=4.0, seed=seed)
