"""Points of a target from picture to picture: Shi-Tomasi corners, Lucas-Kanade, and what they agree on.

Positions are x, y in frame pixels. Pictures are cut around the target, their edges repeated outside the
frame, on regions that depend on the target alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Array, Floats, Image
from bayesnet_track.observation.planes import Region
from bayesnet_track.observation.shared import for_reading

COARSEST = 4
"""Pixels of the frame per pixel of the coarsest of the three pyramid levels."""
GRAY = np.array([0.114, 0.587, 0.299])
CLEARER = 4.0
"""A colour channel is followed instead of brightness where its corners score this many times as high."""
FEW = 3
"""So many points or fewer say nothing of size and rotation."""


@dataclass(frozen=True)
class Following:
    """How points are followed.

    Attributes:
        half_window_px: the matched patch reaches this far around a point, on each pyramid level.
        reach_px: largest displacement from the predicted one, in x and in y.
        agree_px: largest distance between a point and where tracking there and back takes it, and between a
            point and where the others say that it is.
        max_scale: largest change of size, as a factor.
        min_correlation: of a point's patch with what it was when the point was chosen.
    """

    half_window_px: int
    reach_px: int
    agree_px: float
    max_scale: float
    min_correlation: float

    @property
    def margin(self) -> int:
        """How far beyond the target a picture must reach."""
        return self.reach_px + COARSEST * (self.half_window_px + 6)


@dataclass(frozen=True, eq=False)
class PointMotion:
    """How a set of points moved: z -> target + factor (z - source), z = x + iy.

    Attributes:
        kept: (N,) True for the points that moved so.
        places: (N, 2) where they all are now.
        factor: complex: scale and rotation; 1 when so few are left that they say nothing of it.
        source, target: complex: mean of the points kept, before and after.
        variance: px^2, of a point about where the motion takes it, per coordinate.
        spread: px^2, sum of the squared distances of the points kept from their mean.
    """

    kept: NDArray[np.bool_]
    places: Floats
    factor: complex
    source: complex
    target: complex
    variance: float
    spread: float

    def of(self, place: Floats) -> Floats:
        """Where the motion takes x, y."""
        moved = self.target + self.factor * (complex(place[0], place[1]) - self.source)
        return np.array([moved.real, moved.imag])


def cut(image: Image, region: Region) -> Image:
    """The picture on a region, edge pixels repeated outside the frame; empty where it misses the frame."""
    import cv2

    rows, columns = image.shape[:2]
    x0, y0, x1, y1 = max(region.x0, 0), max(region.y0, 0), min(region.x1, columns), min(region.y1, rows)
    if x1 <= x0 or y1 <= y0:
        return np.zeros((0, 0, 3), np.uint8)
    pads = (y0 - region.y0, region.y1 - y1, x0 - region.x0, region.x1 - x1)
    return np.asarray(cv2.copyMakeBorder(image[y0:y1, x0:x1], *pads, cv2.BORDER_REPLICATE), np.uint8)


def mix_channels(image: Image, mix: Floats) -> Image:
    """(rows, columns) uint8: the weighted sum of the channels."""
    import cv2

    if image.size == 0:
        return np.zeros(image.shape[:2], np.uint8)
    return np.asarray(cv2.transform(image, mix[None]), np.uint8).reshape(image.shape[:2])


def corners_in(
    image: Image, origin: tuple[int, int], box: Floats, least: float, apart: float, most: int
) -> Floats:
    """(N, 2) the strongest Shi-Tomasi corners in a centre box (4,), at least `apart` px from each other.

    Ranked by the smaller eigenvalue of the gradient matrix (tracking chapter 3.1), which must exceed least^2
    (gray levels per px)^2.
    """
    scores, first = _scores(image, origin, box, least)
    rows, columns = np.nonzero(scores)
    strength = scores[rows, columns]
    order = np.argsort(-strength, kind="stable")
    places = np.column_stack([columns, rows])[order]
    found: list[NDArray[np.int64]] = []
    while len(places) and len(found) < most:
        found.append(places[0])
        places = places[((places - places[0]) ** 2).sum(axis=1) >= max(apart, 1.0) ** 2]
    corners: Floats = np.array(found, dtype=np.float64).reshape(-1, 2) + first
    return corners


def clearest_mix(image: Image, origin: tuple[int, int], box: Floats, least: float) -> Floats:
    """(3,) weights of B, G, R: brightness, or the one channel in which the box's corners are far stronger."""
    mixes: list[Floats] = [GRAY, *np.eye(3)]
    totals = [float(_scores(mix_channels(image, mix), origin, box, least)[0].sum()) for mix in mixes]
    best = int(np.argmax(totals))
    return mixes[best] if totals[best] > CLEARER * totals[0] else mixes[0]


def _scores(image: Image, origin: tuple[int, int], box: Floats, least: float) -> tuple[Floats, Floats]:
    """Corner scores of the whole pixels in a centre box as far as the picture goes, and x, y of the first."""
    from bayesnet_track.vision.kernels.corner_kernels import RIM, corner_scores

    extent = np.array(image.shape[1::-1])
    low = np.clip(np.ceil(box[:2] - box[2:] / 2 - origin).astype(int), 0, extent)
    high = np.clip(np.floor(box[:2] + box[2:] / 2 - origin).astype(int) + 1, low, extent)
    wide_low, wide_high = np.maximum(low - RIM, 0), np.minimum(high + RIM, extent)
    part = for_reading(image[wide_low[1] : wide_high[1], wide_low[0] : wide_high[0]])
    scores = np.zeros(part.shape)
    corner_scores(part, least**2, scores)
    start, end = low - wide_low, high - wide_low
    return scores[start[1] : end[1], start[0] : end[0]], np.asarray(low + np.array(origin, dtype=np.float64))


def patches_at(image: Image, origin: tuple[int, int], at: Floats, turns: Array, side: int) -> Floats:
    """(N, side, side) pixels around places `at` (N, 2), each grid scaled and rotated by its complex turn."""
    import cv2

    if len(at) == 0:
        return np.zeros((0, side, side))
    step = np.arange(side) - side // 2
    centres = at[:, 0] + 1j * at[:, 1] - complex(*origin)
    square = step[None, :] + 1j * step[:, None]
    grid = (centres[:, None, None] + turns[:, None, None] * square).reshape(-1, side)
    x, y = grid.real.astype(np.float32), grid.imag.astype(np.float32)
    found = cv2.remap(image.astype(np.float32), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found, np.float64).reshape(-1, side, side)


def correlations(one: Floats, other: Floats) -> Floats:
    """(N,) normalised correlation of patches (N, P, P); 0 where one of them is flat."""
    a, b = (p.reshape(len(p), one.shape[1] ** 2) for p in (one, other))
    a, b = a - a.mean(axis=1, keepdims=True), b - b.mean(axis=1, keepdims=True)
    size = np.sqrt((a**2).sum(axis=1) * (b**2).sum(axis=1))
    return np.asarray(np.where(size > 1e-6, (a * b).sum(axis=1) / np.maximum(size, 1e-6), 0.0))


def followed(
    before: Image, now: Image, origin: tuple[int, int], guess: tuple[int, int], at: Floats, how: Following
) -> tuple[Floats, NDArray[np.bool_]]:
    """(N, 2) where the points `at` are in the picture `now`, and which of them came back when tracked back.

    `before` is cut at `origin`, a multiple of 4, and `now` by `guess` further, as large, a multiple of 4 too.
    """
    import cv2

    from bayesnet_track.vision.kernels.flow_kernels import track_points

    middle, later = cv2.pyrDown(before), cv2.pyrDown(now)
    flows, valid = np.zeros((len(at), 2)), np.zeros(len(at), np.uint8)
    track_points(
        cv2.pyrDown(middle),
        middle,
        for_reading(before),
        cv2.pyrDown(later),
        later,
        for_reading(now),
        np.rint(at).astype(np.int64),
        np.array(origin, dtype=np.int64),
        2 * how.half_window_px + 1,
        float(how.reach_px),
        how.agree_px,
        flows,
        valid,
    )
    # The flow is that of the nearest pixel: rounding does not add up over frames.
    return at + flows + guess, valid == 1


def find_agreement(
    source: Floats, target: Floats, candidates: NDArray[np.bool_], how: Following
) -> PointMotion | None:
    """The translation or similarity that most candidates follow, fitted to them by least squares; or None."""
    from bayesnet_track.vision.kernels.similarity_kernels import consensus

    kept = np.zeros(len(source), dtype=np.bool_)
    apart = 2.0 * how.half_window_px
    among = consensus(source[candidates], target[candidates], how.agree_px, apart, how.max_scale)
    kept[np.flatnonzero(candidates)[among]] = True
    if not kept.any():
        return None
    z, t = source[kept] @ [1, 1j], target[kept] @ [1, 1j]
    centre, moved = complex(z.mean()), complex(t.mean())
    spread = float((np.abs(z - centre) ** 2).sum())
    factor = 1.0 + 0.0j
    if len(z) > FEW and spread > 0:
        factor = complex((np.conj(z - centre) * (t - moved)).sum() / spread)
    squares = float((np.abs(t - moved - factor * (z - centre)) ** 2).sum())
    free = max(2 * len(z) - (4 if len(z) > FEW else 2), 1)
    return PointMotion(kept, target, factor, centre, moved, squares / free, spread)
