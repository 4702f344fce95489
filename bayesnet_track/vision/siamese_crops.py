"""Crops of a frame for a Siamese network, its map in pixels of the frame, and the memory of its answers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Bytes, Floats, Singles
from bayesnet_track.observation.planes import for_reading
from bayesnet_track.vision.siamese_networks import SEARCH, TEMPLATE, Networks, Response

TILE = 0.8
"""Distance of the crops' centres on the lattice, in sides of the square that the template shows."""
WIDE = 1.5
"""How much coarser a wide crop is than the template."""
NEAR = 1.1
"""How far from the middle of a crop off the lattice boxes are read in it, in the same distances."""
LARGE = 2
"""Times its shown side from which on a square that extends beyond the image is not built at full size."""


@dataclass(frozen=True)
class Crop:
    """A square of a frame, `side` px from column `left` and row `top`; the network sees `shown` px.

    Each of these covers as much as `coarse` px of the template.
    """

    left: int
    top: int
    side: int
    shown: int = SEARCH
    coarse: float = 1.0

    def cut(self, image: Bytes) -> Bytes:
        """(shown, shown, 3) of an (H, W, 3) image; beyond the image is its mean colour."""
        import cv2

        height, width = image.shape[:2]
        x0, y0 = max(self.left, 0), max(self.top, 0)
        x1, y1 = min(self.left + self.side, width), min(self.top + self.side, height)
        part = image[y0:y1, x0:x1]
        if x1 <= x0 or y1 <= y0:
            part = np.full((1, 1, 3), _mean_color(image), np.uint8)
        elif part.shape[:2] != (self.side, self.side):
            sides = (y0 - self.top, self.top + self.side - y1, x0 - self.left, self.left + self.side - x1)
            color = _mean_color(image).tolist()
            if self.side > LARGE * self.shown:
                return self._reduced(part, (sides[2], sides[0]), color)
            part = np.asarray(cv2.copyMakeBorder(part, *sides, cv2.BORDER_CONSTANT, value=color), np.uint8)
        return np.asarray(
            cv2.resize(part, (self.shown, self.shown), interpolation=cv2.INTER_LINEAR), np.uint8
        )

    def _reduced(self, part: Bytes, corner: tuple[int, int], color: list[int]) -> Bytes:
        """(shown, shown, 3) of the square with `part` at column and row `corner`, and a colour elsewhere."""
        import cv2

        # Samples where `resize` would sample the whole square, which could take hundreds of megabytes.
        times = self.side / self.shown
        shift = 0.5 * times - 0.5
        back = np.array([[times, 0.0, shift - corner[0]], [0.0, times, shift - corner[1]]])
        sampling = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        size = (self.shown, self.shown)
        return np.asarray(cv2.warpAffine(part, back, size, flags=sampling, borderValue=color), np.uint8)

    def boxes(self, response: Response) -> Floats:
        """(S * S, 4) centre boxes in the frame, px, row by row; sides of no extent are left tiny."""
        from bayesnet_track.vision.kernels.correlation_kernels import read_boxes

        sides = for_reading(response.sides)
        boxes = np.empty((sides.shape[1] * sides.shape[2], 4))
        read_boxes(sides, (self.left - 0.5, self.top - 0.5), self.side, self.shown, response.stride, boxes)
        return boxes


def _mean_color(image: Bytes) -> Bytes:
    """(3,) of a frame."""
    import cv2

    return np.rint(cv2.mean(image)[:3]).astype(np.uint8)


def context_side(size: Floats) -> float:
    """Side of the square that the template shows, px, for a target of w, h: half their sum around it."""
    w, h = size.tolist()
    return max(math.sqrt((w + 0.5 * (w + h)) * (h + 0.5 * (w + h))), 2.0)


def template_crop(box: Floats) -> Crop:
    """Crop of the template of a target in a centre box (4,)."""
    return _crop_around(box[0], box[1], context_side(box[2:]), TEMPLATE)


def search_crop(x: float, y: float, size: Floats, side: int = SEARCH) -> Crop:
    """Crop to search around a place for a target of this size, at the template's scale, in `side` px."""
    return _crop_around(x, y, context_side(size), side)


def wide_crop(x: float, y: float, size: Floats) -> Crop:
    """Crop to search if a target of this size may be far from the place: SEARCH px of a coarser scale."""
    return _crop_around(x, y, context_side(size), SEARCH, WIDE)


def _crop_around(x: float, y: float, context: float, side: int, coarse: float = 1.0) -> Crop:
    width = max(round(coarse * context * side / TEMPLATE), 1)
    return Crop(round(x - (width - 1) / 2), round(y - (width - 1) / 2), width, side, coarse)


def crops_for(
    boxes: Floats, is_asked: NDArray[np.bool_], place: Floats, size: Floats, limit: int
) -> Iterator[tuple[Crop, NDArray[np.intp]]]:
    """Search crops, and which of the centre boxes (N, 4), where `is_asked`, are to be read in each.

    The crops' centres are on a lattice around `place`: whichever boxes there are, one is read in the same
    crop. Where more than `limit` would be needed, each crop is centred on the median of the boxes that
    remain, and takes those near it; after `limit` crops the rest is left out.
    """
    reach = TILE * context_side(size)
    tiles = np.rint((boxes[:, :2] - place) / reach)
    remaining = np.flatnonzero(is_asked)
    tile_of = tiles[remaining] @ [2.0**20, 1.0]  # one number is sorted faster than two
    knots, first, tile_numbers = np.unique(tile_of, return_index=True, return_inverse=True)
    if len(knots) <= limit:
        for k, knot in enumerate(tiles[remaining[first]]):
            x, y = place + knot * reach
            yield search_crop(float(x), float(y), size), remaining[tile_numbers == k]
        return
    for _ in range(limit):
        if not len(remaining):
            return
        x, y = np.median(boxes[remaining, :2], axis=0)
        is_near = (np.abs(boxes[remaining, :2] - [x, y]) <= NEAR * reach).all(axis=1)
        yield search_crop(float(x), float(y), size), remaining[is_near]
        remaining = remaining[~is_near] if is_near.any() else remaining[:0]


CELL = 4
"""Side of the cells of `plain_correlator`, px of the network."""
CHANCE = 0.5
"""Correlations below this are chance: nothing is said to be there."""


def plain_correlator() -> Networks:
    """A stand-in without model files: correlation of the pixels in the template's middle."""
    import cv2

    def cells(crop: Bytes) -> Singles:
        side = len(crop) // CELL
        return np.asarray(cv2.resize(crop, (side, side), interpolation=cv2.INTER_AREA), np.float32)

    def describe(crop: Bytes) -> Singles:
        quarter = TEMPLATE // CELL // 4
        return np.ascontiguousarray(cells(crop)[quarter:-quarter, quarter:-quarter])

    def compare(template: Singles, crop: Bytes, size: Floats) -> Response:
        target_side = max(round(len(template) * context_side(size) / TEMPLATE), 2)
        if abs(target_side - len(template)) > 1:  # the crop is not at the template's scale
            template = np.asarray(
                cv2.resize(template, (target_side, target_side), interpolation=cv2.INTER_AREA)
            )
        likeness = cv2.matchTemplate(cells(crop), template, cv2.TM_CCOEFF_NORMED)
        likeness = np.nan_to_num(np.asarray(likeness, np.float32), nan=0.0, posinf=0.0, neginf=0.0)
        if np.ptp(template, axis=(0, 1)).max() < 1.0:  # OpenCV says 1 where both are flat
            likeness[:] = 0.0
        likeness[likeness < CHANCE] = 0.0
        sides = np.empty((4, *likeness.shape), np.float32)
        sides[:] = np.tile(size / 2, 2)[:, None, None]
        return Response(np.clip(likeness, 0.0, 1.0) ** 2, sides, CELL)

    return Networks(describe, compare)


LEAST = 1e-4
"""Proposals of a smaller probability are left out."""
FLAT = 8
"""Gray levels between the darkest and the brightest of a crop in which nothing is to be seen."""
TEMPLATES = 256
"""Templates whose descriptions are kept."""

Proposals = tuple[Floats, Floats]
"""(M, 4) centre boxes in the frame, px; (M,) log-probabilities, the largest first."""


class Memory:
    """A network with its answers: a pure function of what it is given, that is quick the second time.

    Threads may share it; OpenCV's networks themselves hold what they work on, so that one runs at a time.
    """

    def __init__(self, networks: Networks) -> None:
        self._networks = networks
        self._described: dict[bytes, Singles] = {}
        self._image: Bytes | None = None
        self._answers: dict[tuple[Crop, bytes, bytes], Proposals] = {}
        self._lock = Lock()

    def proposals(self, image: Bytes, crop: Crop, template: Bytes, size: Floats) -> Proposals:
        """Proposals of the network in a crop of a frame for a target of w, h `size` px."""
        content = template.tobytes()
        key = (crop, content, size.tobytes())
        with self._lock:
            if self._image is not image:
                self._image = image
                self._answers.clear()
            proposals = self._answers.get(key)
            if proposals is None:
                proposals = self._answers[key] = self._evaluate(image, crop, content, template, size)
            return proposals

    def _evaluate(self, image: Bytes, crop: Crop, content: bytes, template: Bytes, size: Floats) -> Proposals:
        features = self._described.get(content)
        if features is None:
            if len(self._described) >= TEMPLATES:
                self._described.clear()
            features = self._described[content] = self._networks.describe(template)
        pixels = crop.cut(image)
        if int(pixels.max()) - int(pixels.min()) < FLAT:
            return np.empty((0, 4)), np.empty(0)
        expected = size * TEMPLATE / context_side(size) / crop.coarse
        response = self._networks.compare(features, pixels, expected)
        probabilities = response.probabilities.reshape(-1).astype(np.float64)
        order = np.argsort(-probabilities, kind="stable")
        order = order[probabilities[order] >= LEAST]
        return crop.boxes(response)[order], np.log(probabilities[order])
