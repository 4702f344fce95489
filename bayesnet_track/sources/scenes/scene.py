"""Scenes: their parts, rendered with area coverage and sensor noise, and the true boxes of the target."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Bools, Floats, Image
from bayesnet_track.numerics.boxes import CornerBox, corner_from_centre
from bayesnet_track.numerics.cameras import Camera
from bayesnet_track.observation.planes import RightEye, StereoGeometry


@dataclass(frozen=True, eq=False)
class StereoView:
    """The second eye of a scene, and its true depth.

    Attributes:
        right: the right pictures.
        geometry: the pair's.
        background_m: (H, W) depth of the left picture's background.
        paths: centre boxes (n, 4) in the left picture of everything that moves, the nearest last.
        depths_m: (n,) depth of each of these.
    """

    right: Movie
    geometry: StereoGeometry
    background_m: Floats
    paths: tuple[Floats, ...]
    depths_m: tuple[Floats, ...]

    def eye(self, index: int) -> RightEye:
        """The right eye of a frame."""
        return RightEye(self.right[index], self.geometry)

    def true_depth(self, index: int) -> Floats:
        """(H, W) depth in m of the left picture's pixels (of their centres)."""
        depth = self.background_m.copy()
        rows, columns = np.ogrid[: depth.shape[0], : depth.shape[1]]
        for path, depths in zip(self.paths, self.depths_m, strict=True):
            x, y, w, h = path[index]
            depth[(np.abs(columns - x) <= w / 2) & (np.abs(rows - y) <= h / 2)] = depths[index]
        return depth


@dataclass(frozen=True, eq=False)
class ScenePart:
    """Boxes of a part of the target.

    Attributes:
        truth: (n, 4) top-left corner boxes in px; a hidden part keeps its box.
        visible: (n,) share of its area that lies inside the picture and is not hidden.
    """

    truth: Floats
    visible: Floats


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """Ground truth on the ground of a scene.

    Attributes:
        camera: the camera that sees it.
        paths: (cars, n, 4) foot point x, y, width and height, m.
        seen: (cars, n) True where a detector can find the car: near enough, and mostly visible.
        detections: (rows, 6) frame, left, top, width, height in px, score; sorted by frame.
        frame_interval_s: seconds between frames.
    """

    camera: Camera
    paths: Floats
    seen: Bools
    detections: Floats
    frame_interval_s: float

    def truth_csv(self, end: int | None = None) -> str:
        """Text of a world truth file: t in seconds, id, x and y in m, while a car is seen."""
        rows = ["t,id,x,y"]
        for frame in range(self.paths.shape[1] if end is None else end):
            for car in np.flatnonzero(self.seen[:, frame]):
                x, y = self.paths[car, frame, :2]
                rows.append(f"{frame * self.frame_interval_s:.3f},{car + 1},{x:.4f},{y:.4f}")
        return "\n".join(rows) + "\n"

    def detections_mot(self) -> str:
        """Text of the detections as MOT lines, frames from 1."""
        return "".join(
            f"{int(frame) + 1},-1,{x:.2f},{y:.2f},{w:.2f},{h:.2f},{score:.3f}\n"
            for frame, x, y, w, h, score in self.detections
        )


@dataclass(frozen=True, eq=False)
class Scene:
    """A synthetic video with ground truth.

    Attributes:
        name: name of the scene.
        width: columns.
        height: rows.
        frames: sequence of (H, W, 3) uint8 BGR pictures; each is rendered when asked for, always the same.
        truth: (n, 4) top-left corner boxes x, y, w, h of the main target in px, as a ground-truth file holds
            them; an occluded target keeps its box.
        others: (n, 4) corner boxes of each further object.
        visible: (n,) share of the target's area that lies inside the picture and is not hidden.
        stereo: the second eye and the true depth, in scenes that have them.
        plates: what the target and the first of the others are called, where a graph may have a plate for
            each, or one for several; empty where only the target is meant to be tracked.
        parts: parts of the target by name, in scenes that have them.
        ground: where the objects are in metres, and the camera, in scenes that have them.
    """

    name: str
    width: int
    height: int
    frames: Movie
    truth: Floats
    others: tuple[Floats, ...]
    visible: Floats
    stereo: StereoView | None = None
    plates: tuple[str, ...] = ()
    parts: Mapping[str, ScenePart] = field(default_factory=dict)
    ground: GroundTruth | None = None

    @property
    def start_box(self) -> CornerBox:
        """The target's corner box in frame 0."""
        return _corner_box(self.truth)

    @property
    def starts(self) -> tuple[tuple[str, CornerBox], ...]:
        """Plate and corner box in frame 0 of each that is called something, the target first."""
        paths = (self.truth, *self.others)[: len(self.plates)]
        return tuple((plate, _corner_box(path)) for plate, path in zip(self.plates, paths, strict=True))

    @property
    def part_starts(self) -> tuple[tuple[str, CornerBox], ...]:
        """Name and corner box in frame 0 of each part, for graphs with a plate for each."""
        return tuple((name, _corner_box(part.truth)) for name, part in self.parts.items())


def _corner_box(path: Floats) -> CornerBox:
    x, y, w, h = (float(value) for value in path[0])
    return x, y, w, h


def assemble(
    name: str,
    background: Floats,
    sprites: tuple[Sprite, ...],
    target: int,
    noise_sd: float,
    seed: int,
    plates: tuple[str, ...] = (),
) -> Scene:
    """A scene whose main target is `sprites[target]`; later sprites hide earlier ones."""
    height, width = background.shape[:2]
    movie = Movie(background, sprites, noise_sd, seed)
    paths = [sprite.path for sprite in sprites]
    return Scene(
        name,
        width,
        height,
        movie,
        corner_from_centre(paths[target]),
        tuple(corner_from_centre(path) for i, path in enumerate(paths) if i != target),
        visible_share(paths[target], tuple(paths[target + 1 :]), width, height),
        plates=plates,
    )


def visible_share(path: Floats, nearer: tuple[Floats, ...], width: int, height: int) -> Floats:
    """(n,) share of each centre box (n, 4) inside the picture and outside every box of `nearer`."""
    return np.array(
        [
            _visible(box, [occluder[i] for occluder in nearer], width, height) / (box[2] * box[3])
            for i, box in enumerate(path)
        ]
    )


def _visible(box: Floats, nearer: list[Floats], width: int, height: int) -> float:
    """Visible area of one box: the plane is cut at every edge, so that each piece is hidden or not."""
    low, high = box[:2] - box[2:] / 2, box[:2] + box[2:] / 2
    low, high = np.maximum(low, -0.5), np.minimum(high, [width - 0.5, height - 0.5])
    if (high <= low).any():
        return 0.0
    bounds = [(occluder[:2] - occluder[2:] / 2, occluder[:2] + occluder[2:] / 2) for occluder in nearer]
    cuts = [
        np.unique(np.clip([low[k], high[k], *(edge[k] for pair in bounds for edge in pair)], low[k], high[k]))
        for k in (0, 1)
    ]
    middle = [(cut[1:] + cut[:-1]) / 2 for cut in cuts]
    open_ = np.ones((len(middle[0]), len(middle[1])), dtype=bool)
    for start, end in bounds:
        covered = [(middle[k] > start[k]) & (middle[k] < end[k]) for k in (0, 1)]
        open_ &= ~np.outer(*covered)
    return float(np.diff(cuts[0]) @ open_ @ np.diff(cuts[1]))


ORANGE = (30.0, 135.0, 240.0)
"""BGR; hue 30 degrees, far enough from 0 and 255 that the noise is not cut off."""


def smooth_background(
    width: int, height: int, base: float, swing: float, rng: np.random.Generator, cell: int = 16
) -> Floats:
    """(height, width, 3) gray hills: random values on a grid of `cell` px, bilinear between them.

    Values lie in base - swing .. base + swing; all three channels are equal.
    """
    grid = rng.integers(-1000, 1001, size=(height // cell + 2, width // cell + 2)) * (swing / 1000.0)
    gray = base + _between(width, cell).T @ grid.T @ _between(height, cell)
    return np.repeat(np.ascontiguousarray(gray.T)[:, :, None], 3, axis=2)


def _between(pixels: int, cell: int) -> Floats:
    """(grid points, pixels) bilinear weights."""
    cell_index, share = np.divmod(np.arange(pixels), cell)
    weights = np.zeros((pixels // cell + 2, pixels))
    weights[cell_index, np.arange(pixels)] = 1.0 - share / cell
    weights[cell_index + 1, np.arange(pixels)] += share / cell
    return weights


def flat(colour: tuple[float, float, float]) -> Floats:
    """(1, 1, 3): one colour."""
    return np.array(colour, dtype=np.float64).reshape(1, 1, 3)


def gray_cells(rows: int, columns: int, low: int, high: int, rng: np.random.Generator) -> Floats:
    """(rows, columns, 3): a gray level for each cell, low .. high."""
    levels = rng.integers(low, high + 1, size=(rows, columns, 1)).astype(np.float64)
    return np.repeat(levels, 3, axis=2)


def shaded_cells(
    rows: int, columns: int, colour: tuple[float, float, float], darkest: float, rng: np.random.Generator
) -> Floats:
    """(rows, columns, 3): one hue in many shades, each cell `colour` times darkest .. 1."""
    shade = darkest + (1.0 - darkest) * rng.integers(0, 1001, size=(rows, columns, 1)) / 1000.0
    return np.asarray(shade * np.array(colour), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Sprite:
    """A moving rectangle filled with a grid of flat cells.

    Attributes:
        cells: (rows, columns, 3) BGR values of its cells, which share its area evenly.
        path: (n, 4) centre box x, y, w, h in px for every frame; NaN where it is not there.
        is_round: only the ellipse inside the box is there.
    """

    cells: Floats
    path: Floats
    is_round: bool = False


@dataclass(frozen=True, eq=False)
class Veil:
    """Light that comes and goes, added to what is behind it; the camera's range cuts it off.

    Attributes:
        light: (H, W, 3) BGR at full strength.
        strength: (n,) share of it in every frame.
        above: number of sprites behind it, the first ones.
    """

    light: Floats
    strength: Floats
    above: int


def coverage(centre: float, size: float, cells: int, pixels: int) -> tuple[int, Floats]:
    """Length of each pixel that each cell of a segment covers.

    The segment [centre - size/2, centre + size/2] is cut into `cells` equal parts; pixel i spans
    [i - 0.5, i + 0.5]. Returns the first pixel touched and a matrix (pixels touched, cells) of covered
    lengths; the matrix is empty when the segment lies outside 0 .. pixels - 1.

    >>> coverage(1.25, 1.0, 1, 4)
    (1, array([[0.75],
           [0.25]]))
    """
    edges = centre - size / 2 + size * np.arange(cells + 1) / cells
    first = min(max(int(np.floor(edges[0] + 0.5)), 0), pixels)
    end = min(max(int(np.ceil(edges[-1] + 0.5)), first), pixels)
    left = np.arange(first, end)[:, None] - 0.5
    covered = np.minimum(edges[1:], left + 1.0) - np.maximum(edges[:-1], left)
    return first, np.clip(covered, 0.0, None)


def paint(canvas: Floats, sprite: Sprite, index: int) -> None:
    """Paint the sprite's box of frame `index` over `canvas` (H, W, 3), in place, exact to the sub-pixel."""
    x, y, w, h = sprite.path[index]
    if np.isnan(x):
        return
    rows, columns = sprite.cells.shape[:2]
    top, row_cover = coverage(y, h, rows, canvas.shape[0])
    left, column_cover = coverage(x, w, columns, canvas.shape[1])
    covered = np.outer(row_cover.sum(axis=1), column_cover.sum(axis=1))[:, :, None]
    colour = np.tensordot(
        np.tensordot(row_cover, sprite.cells, axes=(1, 0)), column_cover, axes=(1, 1)
    ).transpose(0, 2, 1)
    patch = canvas[top : top + row_cover.shape[0], left : left + column_cover.shape[0]]
    if sprite.is_round:
        rows_at = np.arange(top, top + len(row_cover), dtype=np.float64)
        columns_at = np.arange(left, left + len(column_cover), dtype=np.float64)
        ellipse = ellipse_share(sprite.path[index], rows_at, columns_at)
        colour = np.divide(colour, covered, out=colour, where=covered > 0) * ellipse
        covered = ellipse
    patch *= 1.0 - covered
    patch += colour


def ellipse_share(box: Floats, rows: Floats, columns: Floats) -> Floats:
    """(rows, columns, 1) share of each pixel, of 4 x 4 points, inside the ellipse of a centre box (4,)."""
    x, y, w, h = box
    parts = (np.arange(4) + 0.5) / 4 - 0.5
    y_squared = ((rows[:, None] + parts - y) / (h / 2)) ** 2
    x_squared = ((columns[:, None] + parts - x) / (w / 2)) ** 2
    is_inside = y_squared[:, :, None, None] + x_squared[None, None] <= 1.0
    return np.asarray(is_inside.mean(axis=(1, 3))[:, :, None])


@cache
def _noise_table(sd: float) -> NDArray[np.int16]:
    """65536 whole numbers, as often each as a Gaussian rounded to whole numbers has them."""
    limit = int(np.ceil(5 * sd)) + 1
    gauss = NormalDist(0.0, sd)
    cumulative = np.array([gauss.cdf(k + 0.5) for k in range(-limit, limit)] + [1.0])
    counts = np.diff(np.rint(cumulative * 65536).astype(np.int64), prepend=0)
    return np.repeat(np.arange(-limit, limit + 1, dtype=np.int16), counts)


@dataclass(frozen=True, eq=False)
class Movie:
    """The frames of a scene: a sequence that renders a picture when it is asked for.

    Attributes:
        background: (H, W, 3) BGR.
        sprites: painted in this order, so the last is nearest to the camera.
        noise_sd: sd of the independent noise of every pixel and channel, in gray levels.
        seed: seed of the noise.
        veils: light between and before the sprites.
    """

    background: Floats
    sprites: tuple[Sprite, ...]
    noise_sd: float
    seed: int
    veils: tuple[Veil, ...] = ()

    def __len__(self) -> int:
        return int(self.sprites[0].path.shape[0])

    def __getitem__(self, index: int) -> Image:
        if not -len(self) <= index < len(self):
            raise IndexError(f"frame {index} of a scene of {len(self)} frames")
        return self._render(index % len(self))

    def __iter__(self) -> Iterator[Image]:
        return (self._render(index) for index in range(len(self)))

    def _render(self, index: int) -> Image:
        canvas = self.background.copy()
        for count, sprite in enumerate(self.sprites):
            self._light(canvas, index, count)
            paint(canvas, sprite, index)
        self._light(canvas, index, len(self.sprites))
        np.rint(canvas, out=canvas)
        values = canvas.astype(np.int16)
        if self.noise_sd > 0:
            rng = np.random.Generator(np.random.SFC64((self.seed, index)))
            values += _noise_table(self.noise_sd)[rng.integers(0, 65536, size=values.shape, dtype=np.uint16)]
        return np.clip(values, 0, 255).astype(np.uint8)

    def _light(self, canvas: Floats, index: int, painted: int) -> None:
        """Add the veils that lie over exactly the first `painted` sprites."""
        for veil in self.veils:
            if veil.above == painted and veil.strength[index]:
                canvas += veil.strength[index] * veil.light
