"""A ball that flies through a room and behind a pillar (after the tracking chapter's figures 3.11-3.12)."""

from __future__ import annotations

import numpy as np

from bayesnet_track.sources.scenes.render import ORANGE, Sprite, paint, shaded_cells, smooth_background
from bayesnet_track.sources.scenes.scene import Scene, assemble

WIDTH, HEIGHT, BALL, FRAMES = 320, 240, 26.0, 50
SPEED, GRAVITY = 5.2, 0.16
"""px per frame across, px per frame^2 down."""
WALL, FLOOR, STEEL, WINDOW = (150, 165, 170), (85, 100, 105), (140, 118, 95), (190, 150, 90)
"""BGR of the papered wall, the floor, the pillar, and a window: not one of the ball's hue."""


def flying_ball(seed: int = 0, hidden: int = 8) -> Scene:
    """An orange ball of 26 px, the target, on a parabola from left to right; a pillar hides it on its way.

    320x240 px, 50 frames. The ball is hidden entirely in exactly `hidden` consecutive frames (1 .. 20) in the
    middle of its flight. `seed` governs where it starts, how steeply, patterns and noise.

    Raises:
        ValueError: `hidden` outside 1 .. 20.
    """
    if not 1 <= hidden <= 20:
        raise ValueError(f"hidden must be 1 to 20 frames, not {hidden}")
    rng = np.random.Generator(np.random.Philox(seed))
    frame = np.arange(FRAMES)
    top, turn = rng.uniform(50.0, 90.0), rng.uniform(0.3, 0.6) * FRAMES
    x = rng.uniform(24.0, 32.0) + SPEED * frame
    y = top + GRAVITY / 2 * (frame - turn) ** 2
    path = np.column_stack([x, y, np.full((FRAMES, 2), BALL)])
    first = (FRAMES - hidden) // 2
    # A quarter step of slack on either side: hidden at the first and the last of these frames, not beyond.
    middle = (x[first] + x[first + hidden - 1]) / 2
    width = BALL + (hidden - 1) * SPEED + SPEED / 2
    room = smooth_background(WIDTH, HEIGHT, 120.0, 10.0, rng)
    for cells, box in (
        (shaded_cells(24, 40, WALL, 0.8, rng), (159.5, 95.5, 320.0, 192.0)),
        (shaded_cells(6, 10, FLOOR, 0.6, rng), (159.5, 215.5, 320.0, 48.0)),
        (shaded_cells(4, 4, WINDOW, 0.8, rng), (262.0, 70.0, 60.0, 70.0)),
    ):
        paint(room, Sprite(cells, np.array([box])), 0)
    column = np.tile([middle, (HEIGHT - 1) / 2, width, float(HEIGHT)], (FRAMES, 1))
    sprites = (
        Sprite(shaded_cells(7, 7, ORANGE, 0.7, rng), path, is_round=True),
        Sprite(shaded_cells(40, max(int(width / 6), 1), STEEL, 0.6, rng), column),
    )
    return assemble("flying_ball", room, sprites, target=0, noise_sd=4.0, seed=seed)
