"""A street with shadows, a cart that stands still, and light that changes: a trial for background models."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayesnet_track.numerics.arrays import Floats, Image
from bayesnet_track.sources.scenes.people import BODY_PARTS
from bayesnet_track.sources.scenes.scene import Movie, Scene, Sprite, assemble, flat, shaded_cells

WIDTH, HEIGHT, NOISE_SD = 320, 240, 4.0
GROUND = (128.0, 140.0, 150.0)
JACKETS = ((180.0, 70.0, 50.0), (50.0, 60.0, 200.0))
TROUSERS = (70.0, 45.0, 35.0)
SKIN = (130.0, 160.0, 215.0)
SHADE = 0.68
"""Share of the light that is left in a shadow."""


@dataclass(frozen=True, eq=False)
class ShadedMovie(Movie):
    """A movie with shadows on the ground and light of changing strength.

    Attributes:
        shadows: (n, 4) centre boxes of flat ellipses that leave `SHADE` of the background's light.
        light: (n,) factor on everything.
    """

    shadows: tuple[Floats, ...] = ()
    light: Floats | None = None

    def _render(self, index: int) -> Image:
        ground = self.background.copy()
        rows, columns = np.ogrid[: ground.shape[0], : ground.shape[1]]
        shade = np.ones(ground.shape[:2])
        for path in self.shadows:
            x, y, w, h = path[index]
            inside = ((columns - x) / (w / 2)) ** 2 + ((rows - y) / (h / 2)) ** 2 <= 1.0
            shade = np.where(inside, SHADE, shade)
        light = 1.0 if self.light is None else float(self.light[index])
        lit = tuple(replace(sprite, cells=sprite.cells * light) for sprite in self.sprites)
        frame = Movie(ground * (shade * light)[:, :, None], lit, self.noise_sd, self.seed)
        return frame[index]


def street(seed: int = 0, frames: int = 160, brighter_from: int = 100, gain: float = 1.35) -> Scene:
    """Two people who cross a street with their shadows beside them, and a cart that stands still.

    320x240 px, noise of sd 4. The first person, the target, is in the picture from frame 30 on, the second
    from frame 50; the light is `gain` times as strong from frame `brighter_from` on, at once.
    """
    rng = np.random.Generator(np.random.Philox(seed))
    at, size = np.arange(frames, dtype=np.float64), np.full((frames, 2), (32.0, 84.0))
    walks = (
        np.column_stack([-20.0 + 3.0 * (at - 24.0), np.full(frames, 120.0), size]),
        np.column_stack([340.0 - 2.6 * (at - 42.0), np.full(frames, 172.0), size]),
    )
    cart = Sprite(flat((60.0, 110.0, 120.0)), np.tile([236.0, 60.0, 44.0, 30.0], (frames, 1)))
    cells = shaded_cells(HEIGHT // 8, WIDTH // 8, GROUND, 0.75, rng)
    background: Floats = cells.repeat(8, axis=0).repeat(8, axis=1)
    sprites = (
        cart,
        *(part for walk, jacket in zip(walks, JACKETS, strict=True) for part in _dress(walk, jacket)),
    )
    feet = tuple(
        np.column_stack([walk[:, 0] + 34.0, walk[:, 1] + 36.0, np.full(frames, 76.0), np.full(frames, 15.0)])
        for walk in walks
    )
    light = np.where(at >= brighter_from, gain, 1.0)
    whole = tuple(Sprite(flat(jacket), walk) for walk, jacket in zip(walks, JACKETS, strict=True))
    scene = assemble("street", background, whole, target=0, noise_sd=NOISE_SD, seed=seed)
    movie = ShadedMovie(background, sprites, NOISE_SD, seed, shadows=feet, light=light)
    return replace(scene, frames=movie)


def _dress(path: Floats, jacket: tuple[float, float, float]) -> tuple[Sprite, ...]:
    """A person in a jacket and trousers."""
    colours = (SKIN, jacket, jacket, jacket, TROUSERS, TROUSERS, TROUSERS)
    return tuple(
        Sprite(
            flat(colour),
            np.column_stack(
                [path[:, 0] + x * path[:, 2], path[:, 1] + y * path[:, 3], w * path[:, 2], h * path[:, 3]]
            ),
            is_round,
        )
        for colour, (x, y, w, h, is_round) in zip(colours, BODY_PARTS, strict=True)
    )
