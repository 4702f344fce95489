"""Stereo scenes with true depth: people-sized blocks that walk through a room."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.planes import StereoGeometry
from bayesnet_track.sources.scenes.render import Movie, Sprite, gray_cells, shaded_cells
from bayesnet_track.sources.scenes.room import Pane, Room
from bayesnet_track.sources.scenes.scene import Scene, StereoView, assemble

WIDTH, HEIGHT, NOISE_SD = 320, 240, 2.0
GEOMETRY = StereoGeometry(focal_px=300.0, baseline_m=0.2, centre_x_px=159.5, centre_y_px=99.5)
CAMERA_HEIGHT_M = 1.2
PERSON_M = (0.5, 1.7)
"""Width and height of a block."""

BROWN, GREEN = (60.0, 110.0, 170.0), (90.0, 200.0, 80.0)


@dataclass(frozen=True, eq=False)
class Walker:
    """A block that walks.

    Attributes:
        cells: (rows, columns, 3) BGR cells of its surface.
        x_m, depth_m: (n,) where its middle is in every frame.
    """

    cells: Floats
    x_m: Floats
    depth_m: Floats

    def sprite(self, eye_m: float) -> Sprite:
        """As the eye at x = `eye_m` sees it."""
        scale = GEOMETRY.focal_px / self.depth_m
        width, height = PERSON_M
        x = GEOMETRY.centre_x_px + (self.x_m - eye_m) * scale
        y = GEOMETRY.centre_y_px + (CAMERA_HEIGHT_M - height / 2) * scale
        return Sprite(self.cells, np.column_stack([x, y, width * scale, height * scale]))


def person_stereo(seed: int = 0, frames: int = 150) -> Scene:
    """A person in the colours of the room walks there and back; from frame 60 on another one passes behind.

    The wall is 7 m away, the target 3.7 to 4.3 m, the other one 4.1 m and of another colour; they pass at
    frame 100, when the target is nearer by 0.3 m (after thesis Figure 3.12).
    """
    rng = _rng(seed)
    room = Room(7.0, CAMERA_HEIGHT_M, room_texture(rng, BROWN), room_texture(rng, BROWN), 0.1)
    at = np.arange(frames, dtype=np.float64)
    x = 0.9 * np.sin(2 * np.pi * (at - 20) / 150)
    target = Walker(clothes(rng, BROWN), x, 4.0 + 0.3 * np.sin(2 * np.pi * at / 110))
    other = Walker(clothes(rng, GREEN), -2.44 + 0.057 * (at - 60), np.full(frames, 4.1))
    return room_scene("person_stereo", room, (other, target), 1, seed)


def glass_wall(seed: int = 0, frames: int = 120) -> Scene:
    """A person walks in front of a wall with a pane of stripes that repeat, half transparent.

    After thesis Figure 3.19.
    """
    rng = _rng(seed)
    pane = Pane(-0.4, 2.2, 5.0, 0.12, 0.7)
    room = Room(7.0, CAMERA_HEIGHT_M, room_texture(rng, BROWN), room_texture(rng, BROWN), 0.1, pane)
    x = np.linspace(-1.0, 1.1, frames, dtype=np.float64)
    target = Walker(clothes(rng, GREEN), x, np.linspace(3.6, 4.6, frames, dtype=np.float64))
    return room_scene("glass_wall", room, (target,), 0, seed)


def room_scene(name: str, room: Room, walkers: tuple[Walker, ...], target: int, seed: int) -> Scene:
    """People who walk in a room, the nearest last, seen by both eyes; the target is `walkers[target]`."""
    eyes = (0.0, GEOMETRY.baseline_m)
    (left, depth), (right, _) = (room.seen(GEOMETRY, eye, WIDTH, HEIGHT) for eye in eyes)
    sprites, others = (tuple(walker.sprite(eye) for walker in walkers) for eye in eyes)
    scene = assemble(name, left, sprites, target, NOISE_SD, seed)
    view = StereoView(
        right=Movie(right, others, NOISE_SD, seed + (1 << 32)),
        geometry=GEOMETRY,
        background_m=depth,
        paths=tuple(sprite.path for sprite in sprites),
        depths_m=tuple(walker.depth_m for walker in walkers),
    )
    return replace(scene, stereo=view)


def room_texture(rng: np.random.Generator, colour: tuple[float, float, float]) -> Floats:
    """Cells of wall or floor, in shades of one colour."""
    return shaded_cells(160, 160, colour, 0.35, rng)


def clothes(rng: np.random.Generator, colour: tuple[float, float, float]) -> Floats:
    """Cells of 5 cm, in shades of one colour, with a little gray."""
    shades = shaded_cells(34, 10, colour, 0.35, rng)
    return np.asarray(0.8 * shades + 0.2 * gray_cells(34, 10, 20, 235, rng))


def _rng(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(seed))
