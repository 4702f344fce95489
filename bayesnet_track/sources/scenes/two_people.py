"""Two people before a pair of cameras, each in light that deceives one cue after another."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.boxes import corner_from_centre
from bayesnet_track.sources.scenes.render import Movie, Sprite, Veil, shaded_cells
from bayesnet_track.sources.scenes.room import Room
from bayesnet_track.sources.scenes.scene import Scene, StereoView
from bayesnet_track.sources.scenes.silhouettes import PARTS, dress
from bayesnet_track.sources.scenes.stereo import CAMERA_HEIGHT_M, GEOMETRY, HEIGHT, NOISE_SD, WIDTH

Colour = tuple[float, float, float]

ROOM: Colour = (40.0, 75.0, 115.0)
GREEN: Colour = (90.0, 200.0, 80.0)
TAN: Colour = (70.0, 130.0, 200.0)
"""BGR. The hue of tan is that of the room; it is brighter by 61 gray levels."""

DAYLIGHT: Colour = (170.0, 10.0, 0.0)
"""Added on the left: green turns to cyan."""
GLARE: Colour = (90.0, 60.0, 25.0)
"""Added behind the right person: the room turns gray and as bright as tan."""

FAINT, LIVELY = 0.9, 0.7
"""Darkest shade of a surface: hardly an edge inside a silhouette, or texture enough for depth everywhere."""
PERSON_M, PANEL_M = (0.7, 1.7), (2.4, 2.3)
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
    left = _Standing(PERSON_M, np.linspace(-1.3, -0.7, frames), LEFT_DEPTH_M)
    right = _Standing(PERSON_M, np.linspace(0.8, 1.5, frames), RIGHT_DEPTH_M)
    surface = _faint(rng, 46, 48, ROOM)
    green = [shaded_cells(10, 8, GREEN, LIVELY, rng) for _ in PARTS]
    tan = [_faint(rng, 8, 6, TAN) for _ in PARTS]
    columns = np.arange(WIDTH)
    veils = (
        Veil(
            _light(GLARE, (columns - 175) / 15),
            _during([*((at, at + 1) for at in FLICKERS), GLARE_FRAMES], frames),
            1,
        ),
        Veil(_light(DAYLIGHT, (160 - columns) / 15), _during([DAYLIGHT_FRAMES], frames), 1 + 2 * len(PARTS)),
    )

    def movie(eye_m: float, noise: int) -> tuple[Movie, Floats]:
        background, depth = room.seen(GEOMETRY, eye_m, WIDTH, HEIGHT)
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
    for first, last in spans:
        strength[first : last + 1] = 1.0
    return strength
