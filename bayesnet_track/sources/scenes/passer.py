"""People who pass each other in a room, for a pair of cameras: alike in depth, or alike in clothes."""

from __future__ import annotations

import numpy as np

from bayesnet_track.sources.scenes.room import Room
from bayesnet_track.sources.scenes.scene import Scene
from bayesnet_track.sources.scenes.stereo import (
    BROWN,
    CAMERA_HEIGHT_M,
    GEOMETRY,
    GREEN,
    WIDTH,
    Walker,
    clothes,
    room_scene,
    room_texture,
)


def person_color_stereo(seed: int = 0, frames: int = 150) -> Scene:
    """Somebody in green steps into the picture, stands beside the target, and leaves (thesis Figure 3.12).

    The target wears the colours of the room, walks to the right until frame 50 and back from frame 100 on.
    The other one, as far away as the target, comes in at frame 60, stands 0.6 m beside it in frames 66 to
    80, and has left at frame 88.
    """
    rng = np.random.Generator(np.random.Philox(seed))
    at = np.arange(frames, dtype=np.float64)
    target = np.interp(at, [0.0, 50.0, 100.0, 150.0], [0.2, 1.1, 1.1, 0.2])
    other = np.interp(at, [60.0, 66.0, 80.0, 88.0], [2.4, 1.7, 1.7, 2.4])
    depth = 3.9 + 0.1 * np.sin(2 * np.pi * at / 90)
    walkers = (Walker(clothes(rng, GREEN), other, depth), Walker(clothes(rng, BROWN), target, depth))
    return room_scene("person_color_stereo", _room(rng), walkers, 1, seed)


def person_same_clothes(seed: int = 0, frames: int = 150) -> Scene:
    """Somebody in the target's clothes steps up 0.4 m behind and beside it, and leaves: only depth can tell.

    The target wears green in a brown room and walks as in `person_color_stereo`; the other one comes and
    goes in the same frames.
    """
    rng = np.random.Generator(np.random.Philox(seed))
    at = np.arange(frames, dtype=np.float64)
    target = np.interp(at, [0.0, 50.0, 100.0, 150.0], [0.2, 1.1, 1.1, 0.2])
    other = np.interp(at, [60.0, 66.0, 80.0, 88.0], [2.64, 1.83, 1.83, 2.64])
    walkers = (
        Walker(clothes(rng, GREEN), other, np.full(frames, 4.3)),
        Walker(clothes(rng, GREEN), target, np.full(frames, 3.9)),
    )
    return room_scene("person_same_clothes", _room(rng), walkers, 1, seed)


def person_same_clothes_nearer(seed: int = 0, frames: int = 150) -> Scene:
    """Somebody in the target's clothes steps up beside it, nearer to the cameras, and leaves.

    The target wears green in a brown room, 3.9 m away, and walks until frame 50 and from frame 100 on. The
    other one, as tall, comes from the right by 0.1 m a frame, stands from one of frames 64 to 74 on for 8 to
    12 frames, and goes back. Being nearer (2.9 to 3.3 m, so larger by a fifth to a third) he fills any box of
    the target's size with the target's hue, and may hide a third of it. When, how long, how near and how far
    aside depend on the seed.
    """
    rng = np.random.Generator(np.random.Philox(seed))
    room = _room(rng)
    aside, near, comes = rng.uniform(0.4, 0.6), rng.uniform(2.9, 3.3), rng.uniform(64.0, 74.0)
    leaves = comes + rng.uniform(8.0, 12.0)
    at = np.arange(frames, dtype=np.float64)
    far = np.full(frames, 3.9)
    target = np.interp(at, [0.0, 50.0, 100.0, 150.0], [-0.9, 0.1, 0.1, -0.9])
    stands = (0.1 + aside) * near / far[0]  # `aside` as seen at the target's distance
    outside = (WIDTH / 2 + 30.0) * near / GEOMETRY.focal_px
    walk = (outside - stands) / 0.1
    other = np.interp(at, [comes - walk, comes, leaves, leaves + walk], [outside, stands, stands, outside])
    walkers = (
        Walker(clothes(rng, GREEN), target, far),
        Walker(clothes(rng, GREEN), other, np.full(frames, near)),
    )
    return room_scene("person_same_clothes_nearer", room, walkers, 0, seed)


def _room(rng: np.random.Generator) -> Room:
    return Room(7.0, CAMERA_HEIGHT_M, room_texture(rng, BROWN), room_texture(rng, BROWN), 0.1)
