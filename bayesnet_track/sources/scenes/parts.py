"""A person of two colours who walks behind a counter and under an awning: one part is seen at a time."""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.boxes import corner_from_centre
from bayesnet_track.sources.scenes.render import Movie, Sprite, gray_cells, shaded_cells, smooth_background
from bayesnet_track.sources.scenes.scene import Scene, ScenePart, visible_share

WIDTH, HEIGHT = 360, 240
SIZE = (52.0, 120.0)
HAIR = (40.0, 120.0, 235.0)
SHIRT = (90.0, 190.0, 70.0)
"""BGR: orange and green. Trousers are gray as everything else."""

HEAD = (0.0, -0.39, 0.44, 0.22)
TORSO = (0.0, -0.08, 0.62, 0.38)
LEGS = ((-0.15, 0.30, 0.24, 0.40), (0.15, 0.30, 0.24, 0.40))
"""Centres and sizes of the parts in those of the person's box, when she stands upright."""

COUNTER = (110.0, 162.0, 100.0, 129.0)
AWNING = (268.0, 58.0, 84.0, 84.0)
"""Centre boxes of what hides the person from the neck downward, and what hides her head."""


def person_parts(seed: int = 0, frames: int = 150) -> Scene:
    """The torso is behind a counter in about frames 20 to 73, the head behind an awning in 103 to 136.

    Where she is behind the counter she stops, turns and turns again, by a way that depends on the seed, so
    that only the head tells where the torso is; she goes under the awning with a change of speed, so that
    only the torso tells where the head is. Her head leans up to 2.5 px to the sides. 360x240 px, noise of
    sd 4. The parts `head` and `torso` have a truth of their own; hidden ones keep their boxes.
    """
    rng = np.random.Generator(np.random.Philox(seed))
    x, y = _walk(frames, rng)
    lean = 2.5 * np.sin(2 * np.pi * np.arange(frames) / 37.0 + rng.uniform(0.0, 2 * np.pi))
    body = np.column_stack([x, y, np.full((frames, 2), SIZE)])
    head, torso = _in(body, HEAD), _in(body, TORSO)
    head[:, 0] += lean
    hiding = tuple(np.tile(box, (frames, 1)) for box in (COUNTER, AWNING))
    sprites = (
        *(Sprite(gray_cells(8, 4, 60, 100, rng), _in(body, leg)) for leg in LEGS),
        Sprite(shaded_cells(7, 5, SHIRT, 0.5, rng), torso),
        Sprite(shaded_cells(4, 4, HAIR, 0.5, rng), head, is_round=True),
        Sprite(gray_cells(12, 10, 90, 150, rng), hiding[0]),
        Sprite(gray_cells(6, 9, 90, 150, rng), hiding[1]),
    )
    return Scene(
        "person_parts",
        WIDTH,
        HEIGHT,
        Movie(smooth_background(WIDTH, HEIGHT, 120.0, 40.0, rng), sprites, 4.0, seed),
        corner_from_centre(body),
        tuple(corner_from_centre(path) for path in hiding),
        visible_share(body, hiding, WIDTH, HEIGHT),
        parts={
            name: ScenePart(corner_from_centre(path), visible_share(path, hiding, WIDTH, HEIGHT))
            for name, path in (("head", head), ("torso", torso))
        },
    )


def _walk(frames: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """(n,) x and y of the person's centre: behind the counter to and fro, then on to the right."""
    turns = rng.uniform(-10.0, 10.0, 2)
    when = np.array([0.0, 36.0, 52.0, 66.0, 92.0, 108.0, 118.0, 150.0]) / 150.0 * frames
    where = [30.0, 128.0 + turns[0], 92.0 + turns[1] / 2, 124.0, 196.0, 258.0, 262.0, 332.0]
    at = np.arange(frames, dtype=np.float64)
    # Corners of the way are rounded over 5 frames: nobody turns at once.
    near = [np.interp(at + step, when, where) for step in (-2.0, -1.0, 0.0, 1.0, 2.0)]
    bob = 2.5 * np.sin(2 * np.pi * at / 14.0 + rng.uniform(0.0, 2 * np.pi))
    return np.mean(near, axis=0), 132.0 + bob


def _in(body: Floats, part: tuple[float, float, float, float]) -> Floats:
    """(n, 4) centre boxes of a part, given in sizes of the person's boxes (n, 4)."""
    x, y, w, h = part
    return np.column_stack(
        [body[:, 0] + x * body[:, 2], body[:, 1] + y * body[:, 3], w * body[:, 2], h * body[:, 3]]
    )
