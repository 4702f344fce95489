"""Two children who throw a ball to each other (after thesis Figure 5.9)."""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.sources.scenes.render import ORANGE, Sprite, shaded_cells, smooth_background
from bayesnet_track.sources.scenes.scene import Scene, assemble

WIDTH, HEIGHT, FRAMES, BALL = 320, 240, 45, 22.0
LEFT, RIGHT = (64.0, 132.0), (252.0, 136.0)
CHILD = (46.0, 130.0)
FLIGHTS = ((3, 7), (23, 27))
"""First and last frame of the ball in the air: from the left child to the right one, and back."""

HAIR, SKIN, TROUSERS = (45.0, 42.0, 45.0), (172.0, 180.0, 198.0), (110.0, 75.0, 60.0)
GREEN, BLUE = (90.0, 150.0, 70.0), (190.0, 110.0, 60.0)


def ball_between_children(seed: int = 0) -> Scene:
    """An orange ball, the target, flies between two children; the first of `others` is the left child.

    320x240 px. The children sway by a few px. The ball of 22 px rests in the left child's hands, moves by
    some 32 px per frame in frames 3 to 7, rests with the right child, and comes back in frames 23 to 27, so
    that a random walk fits it while it is held and fails while it flies. `seed` governs sway, patterns and
    noise.
    """
    rng = np.random.Generator(np.random.Philox(seed))
    left, right = _sway(LEFT, rng), _sway(RIGHT, rng)
    background = smooth_background(WIDTH, HEIGHT, 110.0, 18.0, rng)
    thrown = _boxes(_throw(left, right), BALL, BALL)
    sprites = (
        Sprite(_clothes(GREEN, rng), _boxes(left, *CHILD)),
        Sprite(_clothes(BLUE, rng), _boxes(right, *CHILD)),
        Sprite(shaded_cells(6, 6, ORANGE, 0.75, rng), thrown, is_round=True),
    )
    return assemble(
        "ball_between_children", background, sprites, 2, noise_sd=4.0, seed=seed, plates=("ball", "child")
    )


def _sway(centre: tuple[float, float], rng: np.random.Generator) -> Floats:
    """(FRAMES, 2) a slow swing about a place, up to 4 px wide."""
    phase, period = rng.uniform(0, 2 * np.pi, 2), rng.uniform(18.0, 30.0, 2)
    turn = 2 * np.pi * np.arange(FRAMES)[:, None] / period + phase
    return np.asarray(np.array(centre) + np.array([4.0, 1.5]) * np.sin(turn))


def _throw(left: Floats, right: Floats) -> Floats:
    """(FRAMES, 2) the ball's path: in a child's hands, or on an arc between them."""
    hands = np.array([24.0, -8.0])
    held = {True: left + hands, False: right + hands * [-1, 1]}
    path, is_left = np.empty((FRAMES, 2)), True
    starts = dict(FLIGHTS)
    frame = 0
    while frame < FRAMES:
        if frame not in starts:
            path[frame] = held[is_left][frame]
            frame += 1
            continue
        last = starts[frame]
        begin, end = held[is_left][frame - 1], held[not is_left][last + 1]
        share = np.arange(1, last - frame + 2) / (last - frame + 2)
        arc = begin + share[:, None] * (end - begin)
        arc[:, 1] -= 4 * 45.0 * share * (1 - share)
        path[frame : last + 1] = arc
        is_left, frame = not is_left, last + 1
    return path


def _clothes(shirt: tuple[float, float, float], rng: np.random.Generator) -> Floats:
    """(13, 5, 3): hair, face, a shirt and trousers, each in shades."""
    parts = ((1, HAIR), (2, SKIN), (5, shirt), (5, TROUSERS))
    return np.concatenate([shaded_cells(rows, 5, colour, 0.7, rng) for rows, colour in parts])


def _boxes(centres: Floats, w: float, h: float) -> Floats:
    return np.column_stack([centres, np.full((len(centres), 2), [w, h])])
