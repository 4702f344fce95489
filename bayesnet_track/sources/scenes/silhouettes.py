"""A person, a board of the same colour, and a glare in which the person's outline cannot be seen."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.boxes import corner_from_centre
from bayesnet_track.sources.scenes.render import Movie, Sprite, flat, smooth_background
from bayesnet_track.sources.scenes.scene import Scene

Colour = tuple[float, float, float]

WIDTH, HEIGHT = 320, 240
CLOTHES: Colour = (60.0, 170.0, 230.0)
"""BGR of person and board; its brightness is 175.4."""

GLARE: Colour = (175.4, 175.4, 175.4)
"""BGR of the glare, as bright as the person: what stands before it differs in colour only."""

PARTS = (
    (0.0, -0.39, 0.44, 0.22, True),
    (0.0, -0.10, 0.60, 0.40, False),
    (-0.42, -0.12, 0.16, 0.36, False),
    (0.42, -0.12, 0.16, 0.36, False),
    (0.0, 0.14, 0.44, 0.12, False),
    (-0.15, 0.34, 0.22, 0.32, False),
    (0.15, 0.34, 0.22, 0.32, False),
)
"""Head, trunk, arms, hips, legs: centre and size in sizes of the person's box, and whether it is round."""


def person(path: Floats, colour: Colour = CLOTHES) -> tuple[Sprite, ...]:
    """A standing person of one colour that fills the centre boxes `path` (n, 4)."""
    return dress(path, (flat(colour),) * len(PARTS))


def dress(path: Floats, cells: Sequence[Floats]) -> tuple[Sprite, ...]:
    """A standing person that fills the centre boxes `path` (n, 4), with (rows, columns, 3) cells per part."""
    return tuple(
        Sprite(
            surface,
            np.column_stack(
                [
                    path[:, 0] + x * path[:, 2],
                    path[:, 1] + y * path[:, 3],
                    w * path[:, 2],
                    h * path[:, 3],
                ]
            ),
            is_round,
        )
        for surface, (x, y, w, h, is_round) in zip(cells, PARTS, strict=True)
    )


def person_and_board(seed: int = 0, frames: int = 120) -> Scene:
    """A person walks past a board of its size and colour, and then through a glare (thesis Figure 3.17).

    320x240 px, noise of sd 4. The board stands in the way until frame 30, 8 px ahead of the person then, and
    is carried off upward. The whole person is before the glare in frames 68 to 96.
    """
    rng = np.random.Generator(np.random.Philox(seed))
    time = np.arange(frames, dtype=np.float64)
    size = np.full((frames, 2), (40.0, 96.0))
    walker = np.column_stack([30.0 + 2.2 * time, np.full(frames, 130.0), size])
    ahead = walker[:, 0] + 48.0 + 2.2 * np.maximum(30.0 - time, 0.0)
    board = np.column_stack([ahead, 130.0 - 4.0 * np.maximum(time - 30.0, 0.0), size])
    light = np.tile([211.0, 128.0, 106.0, 150.0], (frames, 1))
    sprites = (Sprite(flat(GLARE), light), Sprite(flat(CLOTHES), board), *person(walker))
    background = smooth_background(WIDTH, HEIGHT, 90.0, 12.0, rng)
    inside = np.clip((np.minimum(walker[:, 0] + 20, WIDTH - 0.5) - (walker[:, 0] - 20)) / 40.0, 0.0, 1.0)
    return Scene(
        "person_and_board",
        WIDTH,
        HEIGHT,
        Movie(background, sprites, 4.0, seed),
        corner_from_centre(walker),
        (corner_from_centre(board),),
        inside,
    )
