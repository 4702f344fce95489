"""Scenes for a pair of cameras with true depth: a room, people who pass, light that deceives cues."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.boxes import corner_from_centre
from bayesnet_track.observation.planes import StereoGeometry
from bayesnet_track.sources.scenes.people import BODY_PARTS, dress
from bayesnet_track.sources.scenes.scene import (
    Movie,
    Scene,
    Sprite,
    StereoView,
    Veil,
    assemble,
    gray_cells,
    shaded_cells,
)

FINER = 2
"""Rays per pixel and direction."""
STRIPES = (60.0, 200.0)
"""Gray levels of a pane's pattern."""


@dataclass(frozen=True)
class Pane:
    """A pane parallel to the picture, with a pattern that repeats, before the wall.

    Attributes:
        left_m, right_m: its edges.
        depth_m: its distance.
        period_m: width of one stripe and the gap beside it.
        opacity: share of the stripes in what is seen; the rest is what is behind the pane.
    """

    left_m: float
    right_m: float
    depth_m: float
    period_m: float
    opacity: float


@dataclass(frozen=True, eq=False)
class Room:
    """A floor and a wall with random texture, and maybe a pane.

    Attributes:
        wall_m: distance of the wall.
        camera_height_m: height of both cameras above the floor, which they look along.
        wall, floor: (rows, columns, 3) BGR values on a lattice of `cell_m`, repeated.
        cell_m: its spacing; values in between are bilinear.
        pane: a pane, or None.
    """

    wall_m: float
    camera_height_m: float
    wall: Floats
    floor: Floats
    cell_m: float
    pane: Pane | None = None

    def render(
        self, geometry: StereoGeometry, eye_m: float, width: int, height: int
    ) -> tuple[Floats, Floats]:
        """The picture (H, W, 3) BGR of the eye at x = `eye_m`, and the depth (H, W) in m of its pixels."""
        offsets = (np.arange(FINER) + 0.5) / FINER - 0.5
        columns = (np.arange(width)[:, None] + offsets).ravel()
        rows = (np.arange(height)[:, None] + offsets).ravel()
        colour, _ = self._rays(geometry, eye_m, columns, rows)
        centres = np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64)
        _, depth = self._rays(geometry, eye_m, *centres)
        return colour.reshape(height, FINER, width, FINER, 3).mean(axis=(1, 3)), depth

    def _rays(
        self, geometry: StereoGeometry, eye_m: float, columns: Floats, rows: Floats
    ) -> tuple[Floats, Floats]:
        """Colour (rows, columns, 3) and depth (rows, columns) where each ray ends."""
        ray_x = (columns - geometry.centre_x_px) / geometry.focal_px
        ray_y = (rows - geometry.centre_y_px) / geometry.focal_px
        with np.errstate(divide="ignore"):
            depth_of_row = np.where(ray_y > 0, self.camera_height_m / ray_y, np.inf)
        on_floor = depth_of_row < self.wall_m
        colour, depth = np.empty((len(rows), len(columns), 3)), np.empty((len(rows), len(columns)))
        depth[:] = np.minimum(depth_of_row, self.wall_m)[:, None]
        x = eye_m + ray_x * depth
        colour[on_floor] = self._sampled(self.floor, x[on_floor], depth[on_floor])
        wall = ray_y[~on_floor, None] * np.full(len(columns), self.wall_m)
        colour[~on_floor] = self._sampled(self.wall, x[~on_floor], wall)
        if self.pane is not None:
            pane = self.pane
            x = eye_m + ray_x * pane.depth_m
            in_pane = (x >= pane.left_m) & (x < pane.right_m) & (depth > pane.depth_m)
            stripe = np.where(x / pane.period_m % 1.0 < 0.5, *STRIPES)[None, :, None]
            mixed = pane.opacity * stripe + (1.0 - pane.opacity) * colour
            colour = np.where(in_pane[..., None], mixed, colour)
            depth = np.where(in_pane, pane.depth_m, depth)
        return colour, depth

    def _sampled(self, texture: Floats, u: Floats, v: Floats) -> Floats:
        """Bilinear values of `texture` at (u, v) in m."""
        rows, columns = texture.shape[:2]
        (u0, du), (v0, dv) = np.divmod(u / self.cell_m, 1.0), np.divmod(v / self.cell_m, 1.0)
        i, j = u0.astype(np.int64) % columns, v0.astype(np.int64) % rows
        i1, j1 = (i + 1) % columns, (j + 1) % rows
        du, dv = du[..., None], dv[..., None]
        upper = (1 - du) * texture[j, i] + du * texture[j, i1]
        lower = (1 - du) * texture[j1, i] + du * texture[j1, i1]
        return np.asarray((1 - dv) * upper + dv * lower)


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
        """The person as the eye at x = `eye_m` sees it."""
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
    time = np.arange(frames, dtype=np.float64)
    x = 0.9 * np.sin(2 * np.pi * (time - 20) / 150)
    target = Walker(clothes(rng, BROWN), x, 4.0 + 0.3 * np.sin(2 * np.pi * time / 110))
    passer = Walker(clothes(rng, GREEN), -2.44 + 0.057 * (time - 60), np.full(frames, 4.1))
    return room_scene("person_stereo", room, (passer, target), 1, seed)


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
    (left, depth), (right, _) = (room.render(GEOMETRY, eye, WIDTH, HEIGHT) for eye in eyes)
    sprites, right_sprites = (tuple(walker.sprite(eye) for walker in walkers) for eye in eyes)
    scene = assemble(name, left, sprites, target, NOISE_SD, seed)
    view = StereoView(
        right=Movie(right, right_sprites, NOISE_SD, seed + (1 << 32)),
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


def person_color_stereo(seed: int = 0, frames: int = 150) -> Scene:
    """Somebody in green steps into the picture, stands beside the target, and leaves (thesis Figure 3.12).

    The target wears the colours of the room, walks to the right until frame 50 and back from frame 100 on.
    The other one, as far away as the target, comes in at frame 60, stands 0.6 m beside it in frames 66 to
    80, and has left at frame 88.
    """
    rng = np.random.Generator(np.random.Philox(seed))
    time = np.arange(frames, dtype=np.float64)
    target = np.interp(time, [0.0, 50.0, 100.0, 150.0], [0.2, 1.1, 1.1, 0.2])
    passer = np.interp(time, [60.0, 66.0, 80.0, 88.0], [2.4, 1.7, 1.7, 2.4])
    depth = 3.9 + 0.1 * np.sin(2 * np.pi * time / 90)
    walkers = (Walker(clothes(rng, GREEN), passer, depth), Walker(clothes(rng, BROWN), target, depth))
    return room_scene("person_color_stereo", _room(rng), walkers, 1, seed)


def person_same_clothes(seed: int = 0, frames: int = 150) -> Scene:
    """Somebody in the target's clothes steps up 0.4 m behind and beside it, and leaves: only depth can tell.

    The target wears green in a brown room and walks as in `person_color_stereo`; the other one comes and
    goes in the same frames.
    """
    rng = np.random.Generator(np.random.Philox(seed))
    time = np.arange(frames, dtype=np.float64)
    target = np.interp(time, [0.0, 50.0, 100.0, 150.0], [0.2, 1.1, 1.1, 0.2])
    passer = np.interp(time, [60.0, 66.0, 80.0, 88.0], [2.64, 1.83, 1.83, 2.64])
    walkers = (
        Walker(clothes(rng, GREEN), passer, np.full(frames, 4.3)),
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
    aside, passer_depth, comes = rng.uniform(0.4, 0.6), rng.uniform(2.9, 3.3), rng.uniform(64.0, 74.0)
    leaves = comes + rng.uniform(8.0, 12.0)
    time = np.arange(frames, dtype=np.float64)
    target_depth = np.full(frames, 3.9)
    target = np.interp(time, [0.0, 50.0, 100.0, 150.0], [-0.9, 0.1, 0.1, -0.9])
    stands = (0.1 + aside) * passer_depth / target_depth[0]  # `aside` as seen at the target's distance
    entry_x = (WIDTH / 2 + 30.0) * passer_depth / GEOMETRY.focal_px
    walk = (entry_x - stands) / 0.1
    passer = np.interp(time, [comes - walk, comes, leaves, leaves + walk], [entry_x, stands, stands, entry_x])
    walkers = (
        Walker(clothes(rng, GREEN), target, target_depth),
        Walker(clothes(rng, GREEN), passer, np.full(frames, passer_depth)),
    )
    return room_scene("person_same_clothes_nearer", room, walkers, 0, seed)


def _room(rng: np.random.Generator) -> Room:
    return Room(7.0, CAMERA_HEIGHT_M, room_texture(rng, BROWN), room_texture(rng, BROWN), 0.1)


Colour = tuple[float, float, float]

ROOM: Colour = (40.0, 75.0, 115.0)
JACKET: Colour = (90.0, 200.0, 80.0)
TAN: Colour = (70.0, 130.0, 200.0)
"""BGR. The hue of tan is that of the room; it is brighter by 61 gray levels."""

DAYLIGHT: Colour = (170.0, 10.0, 0.0)
"""Added on the left: green turns to cyan."""
GLARE: Colour = (90.0, 60.0, 25.0)
"""Added behind the right person: the room turns gray and as bright as tan."""

FAINT, LIVELY = 0.9, 0.7
"""Darkest shade of a surface: hardly an edge inside a silhouette, or texture enough for depth everywhere."""
STANDING_M, PANEL_M = (0.7, 1.7), (2.4, 2.3)
LEFT_DEPTH_M, RIGHT_DEPTH_M, PANEL_DEPTH_M = 4.0, 4.1, 4.4

DAYLIGHT_FRAMES = (58, 70)
FLICKERS = (30, 50)
"""First of two frames of glare."""
GLARE_FRAMES = (76, 100)


@dataclass(frozen=True, eq=False)
class _Standing:
    """An upright thing that stands on the floor: width and height, and where its middle is in each frame."""

    size_m: tuple[float, float]
    x_m: Floats
    depth_m: float

    def path(self, eye_m: float) -> Floats:
        """(n, 4) centre boxes for the eye at x = `eye_m`."""
        scale = GEOMETRY.focal_px / self.depth_m
        width, height = self.size_m
        x = GEOMETRY.centre_x_px + (self.x_m - eye_m) * scale
        y = GEOMETRY.centre_y_px + (CAMERA_HEIGHT_M - height / 2) * scale
        return np.column_stack([x, np.full((len(x), 3), (y, width * scale, height * scale))])


def two_people_color_stereo_shape(seed: int = 0, frames: int = 120) -> Scene:
    """Two people walk without meeting (thesis Figures 3.17 to 3.21): plates `left` and `right`.

    The left one wears green. In frames 58 to 70 daylight changes all colours on that side. The right one
    wears the colour of the room and walks before a panel 0.3 m behind. In frames 30, 31, 50, 51 and in 76 to
    100 a glare makes what is behind as bright as the clothes, so that no outline can be seen there.
    """
    rng = np.random.Generator(np.random.Philox(seed))
    room = Room(7.0, CAMERA_HEIGHT_M, _faint(rng, 160, 160, ROOM), _faint(rng, 160, 160, ROOM), 0.1)
    panel = _Standing(PANEL_M, np.full(frames, 1.3), PANEL_DEPTH_M)
    left = _Standing(STANDING_M, np.linspace(-1.3, -0.7, frames), LEFT_DEPTH_M)
    right = _Standing(STANDING_M, np.linspace(0.8, 1.5, frames), RIGHT_DEPTH_M)
    surface = _faint(rng, 46, 48, ROOM)
    green = [shaded_cells(10, 8, JACKET, LIVELY, rng) for _ in BODY_PARTS]
    tan = [_faint(rng, 8, 6, TAN) for _ in BODY_PARTS]
    columns = np.arange(WIDTH)
    veils = (
        Veil(
            _light(GLARE, (columns - 175) / 15),
            _during([*((frame, frame + 1) for frame in FLICKERS), GLARE_FRAMES], frames),
            1,
        ),
        Veil(
            _light(DAYLIGHT, (160 - columns) / 15),
            _during([DAYLIGHT_FRAMES], frames),
            1 + 2 * len(BODY_PARTS),
        ),
    )

    def movie(eye_m: float, noise: int) -> tuple[Movie, Floats]:
        background, depth = room.render(GEOMETRY, eye_m, WIDTH, HEIGHT)
        people = (*dress(right.path(eye_m), tan), *dress(left.path(eye_m), green))
        return Movie(background, (Sprite(surface, panel.path(eye_m)), *people), NOISE_SD, noise, veils), depth

    (picture, depth), (other_eye, _) = movie(0.0, seed), movie(GEOMETRY.baseline_m, seed + (1 << 32))
    standing = (panel, right, left)
    view = StereoView(
        right=other_eye,
        geometry=GEOMETRY,
        background_m=depth,
        paths=tuple(thing.path(0.0) for thing in standing),
        depths_m=tuple(np.full(frames, thing.depth_m) for thing in standing),
    )
    return Scene(
        "two_people_color_stereo_shape",
        WIDTH,
        HEIGHT,
        picture,
        corner_from_centre(left.path(0.0)),
        (corner_from_centre(right.path(0.0)),),
        np.ones(frames),
        view,
        ("left", "right"),
    )


def _faint(rng: np.random.Generator, rows: int, columns: int, colour: Colour) -> Floats:
    return shaded_cells(rows, columns, colour, FAINT, rng)


def _light(colour: Colour, share: Floats) -> Floats:
    """(H, W, 3): `colour` times the share of each column (W,), cut to 0 .. 1."""
    return np.tile(np.clip(share, 0.0, 1.0)[None, :, None] * np.array(colour), (HEIGHT, 1, 1))


def _during(spans: Iterable[tuple[int, int]], frames: int) -> Floats:
    """(n,) 1 from the first to the last frame of each span, 0 elsewhere."""
    strength = np.zeros(frames)
    for first, final in spans:
        strength[first : final + 1] = 1.0
    return strength
