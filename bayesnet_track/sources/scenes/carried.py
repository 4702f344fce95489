"""A person picks up a box, carries it, now and then behind the body, and puts it down."""

from __future__ import annotations

import numpy as np

from bayesnet_track.sources.scenes.render import ORANGE, Sprite, shaded_cells, smooth_background
from bayesnet_track.sources.scenes.scene import Scene, assemble

WIDTH, HEIGHT, FRAMES, NOISE_SD = 320, 240, 180, 4.0
GREEN = (70.0, 190.0, 60.0)
"""BGR of the person's clothes."""
PERSON, BOX = (44.0, 110.0), (28.0, 28.0)

PICKED, BEHIND, SHOWN, PUT = 30, 60, 100, 130
"""Frames: the box leaves the floor; is wholly behind the person from here; until here; is on the floor."""


def carried_box(seed: int = 0) -> Scene:
    """An orange box, the target, stands on the floor; a person in green carries it to another place.

    320x240 px, 180 frames. The person reaches it at frame 30, carries it at the side, and behind the body,
    wholly hidden, in frames 60 to 99, in which the person walks on and turns back. The box stands on
    the floor again from frame 130 on, and the person leaves it. Speeds, turns and places depend on the seed.
    """
    rng = np.random.Generator(np.random.Philox(seed))
    stands, side = rng.uniform(95.0, 115.0), 30.0
    there = stands - side + rng.uniform(15.0, 25.0)
    far, back = there + rng.uniform(70.0, 95.0), rng.uniform(20.0, 40.0)
    turn = int(rng.integers(78, 88))
    at = np.arange(FRAMES, dtype=np.float64)
    places = [stands - side - 50.0, stands - side, stands - side, there, far, far - back, far - back, 60.0]
    person_x = np.interp(at, [0, PICKED - 4, PICKED + 4, BEHIND - 4, turn, SHOWN, PUT + 4, FRAMES], places)
    person_y = np.full(FRAMES, 150.0) + 2.0 * np.sin(2 * np.pi * at / 14)
    floor = 150.0 + PERSON[1] / 2 - BOX[1] / 2
    aside = np.interp(
        at, [PICKED, BEHIND - 16, BEHIND, SHOWN - 1, SHOWN + 16, PUT], [side, side, 0, 0, side, side]
    )
    lifted = np.interp(at, [PICKED, PICKED + 16, PUT - 16, PUT], [0.0, 1.0, 1.0, 0.0])
    held = np.column_stack([person_x + aside, floor * (1 - lifted) + (person_y + 8.0) * lifted])
    held[:PICKED], held[PUT:] = held[PICKED], held[PUT]
    box = np.column_stack([held, np.tile(BOX, (FRAMES, 1))])
    person = np.column_stack([person_x, person_y, np.tile(PERSON, (FRAMES, 1))])
    background = smooth_background(WIDTH, HEIGHT, 100.0, 12.0, rng)
    sprites = (
        Sprite(shaded_cells(4, 4, ORANGE, 0.7, rng), box),
        Sprite(shaded_cells(10, 4, GREEN, 0.7, rng), person),
    )
    return assemble("carried_box", background, sprites, 0, NOISE_SD, seed, plates=("box", "person"))
