"""Scene: frames, the true boxes of its target, their visible share, and its view by a second camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.boxes import CornerBox, corner_from_centre
from bayesnet_track.observation.planes import RightEye, StereoGeometry
from bayesnet_track.sources.scenes.render import Movie, Sprite


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
        """What a frame carries of it."""
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
    """Where a part of the target is.

    Attributes:
        truth: (n, 4) top-left corner boxes in px; a hidden part keeps its box.
        visible: (n,) share of its area that lies inside the picture and is not hidden.
    """

    truth: Floats
    visible: Floats


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
            _visible(box, [other[i] for other in nearer], width, height) / (box[2] * box[3])
            for i, box in enumerate(path)
        ]
    )


def _visible(box: Floats, nearer: list[Floats], width: int, height: int) -> float:
    """Visible area of one box: the plane is cut at every edge, so that each piece is hidden or not."""
    low, high = box[:2] - box[2:] / 2, box[:2] + box[2:] / 2
    low, high = np.maximum(low, -0.5), np.minimum(high, [width - 0.5, height - 0.5])
    if (high <= low).any():
        return 0.0
    bounds = [(other[:2] - other[2:] / 2, other[:2] + other[2:] / 2) for other in nearer]
    cuts = [
        np.unique(np.clip([low[k], high[k], *(edge[k] for pair in bounds for edge in pair)], low[k], high[k]))
        for k in (0, 1)
    ]
    middle = [(cut[1:] + cut[:-1]) / 2 for cut in cuts]
    open_ = np.ones((len(middle[0]), len(middle[1])), dtype=bool)
    for start, end in bounds:
        inside = [(middle[k] > start[k]) & (middle[k] < end[k]) for k in (0, 1)]
        open_ &= ~np.outer(*inside)
    return float(np.diff(cuts[0]) @ open_ @ np.diff(cuts[1]))
