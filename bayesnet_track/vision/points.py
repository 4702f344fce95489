"""Points of a target from frame to frame: corners that are followed, and distributions of displacement.

Positions are x, y in frame pixels. Images are cut around the target, their edges repeated outside the
frame, on regions that depend on the target alone.

Displacement matrices: Section 3 of the General Distribution Filter. A point's patch is compared with the new
picture at every displacement in a range; the result is a matrix of probabilities, filtered from frame to
frame as the grid filter filters a velocity. The object moves by the mean of the sum of all matrices, and each
point by the probable displacement nearest to it, so that it stays on its feature of the picture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Array, Bytes, Floats, Image, Ints
from bayesnet_track.numerics.distributions import flatten, gaussian_taps, nearest_probable
from bayesnet_track.observation.planes import Region, for_reading

COARSEST = 4
"""Pixels of the frame per pixel of the coarsest of the three pyramid levels."""
GRAY = np.array([0.114, 0.587, 0.299])
CLEARER = 4.0
"""A colour channel is followed instead of brightness where its corners score this many times as high."""
FEW = 3
"""So many points or fewer say nothing of size and rotation."""


@dataclass(frozen=True)
class Following:
    """Settings by which points are followed.

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
        """Margin around the target that an image must show."""
        return self.reach_px + COARSEST * (self.half_window_px + 6)


@dataclass(frozen=True, eq=False)
class PointMotion:
    """Motion of a set of points: z -> target + factor (z - source), z = x + iy.

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
        """Place to which the motion takes x, y."""
        place_after = self.target + self.factor * (complex(place[0], place[1]) - self.source)
        return np.array([place_after.real, place_after.imag])


def cut_region(image: Image, region: Region) -> Image:
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
    image: Image, origin: tuple[int, int], box: Floats, threshold: float, distance: float, max_count: int
) -> Floats:
    """(N, 2) the strongest Shi-Tomasi corners in a centre box (4,), at least `distance` px from each other.

    Ranked by the smaller eigenvalue of the gradient matrix (tracking chapter 3.1), which must exceed least^2
    (gray levels per px)^2.
    """
    scores, first = _scores(image, origin, box, threshold)
    rows, columns = np.nonzero(scores)
    strength = scores[rows, columns]
    order = np.argsort(-strength, kind="stable")
    places = np.column_stack([columns, rows])[order]
    accepted: list[NDArray[np.int64]] = []
    while len(places) and len(accepted) < max_count:
        accepted.append(places[0])
        places = places[((places - places[0]) ** 2).sum(axis=1) >= max(distance, 1.0) ** 2]
    corners: Floats = np.array(accepted, dtype=np.float64).reshape(-1, 2) + first
    return corners


def clearest_mix(image: Image, origin: tuple[int, int], box: Floats, threshold: float) -> Floats:
    """(3,) weights of B, G, R: brightness, or the one channel in which the box's corners are far stronger."""
    mixes: list[Floats] = [GRAY, *np.eye(3)]
    totals = [float(_scores(mix_channels(image, mix), origin, box, threshold)[0].sum()) for mix in mixes]
    clearest = int(np.argmax(totals))
    return mixes[clearest] if totals[clearest] > CLEARER * totals[0] else mixes[0]


def _scores(image: Image, origin: tuple[int, int], box: Floats, threshold: float) -> tuple[Floats, Floats]:
    """Corner scores of the whole pixels in a centre box as far as the picture goes, and x, y of the first."""
    from bayesnet_track.vision.kernels.flow_kernels import RIM, corner_scores

    extent = np.array(image.shape[1::-1])
    low = np.clip(np.ceil(box[:2] - box[2:] / 2 - origin).astype(int), 0, extent)
    high = np.clip(np.floor(box[:2] + box[2:] / 2 - origin).astype(int) + 1, low, extent)
    wide_low, wide_high = np.maximum(low - RIM, 0), np.minimum(high + RIM, extent)
    part = for_reading(image[wide_low[1] : wide_high[1], wide_low[0] : wide_high[0]])
    scores = np.zeros(part.shape)
    corner_scores(part, threshold**2, scores)
    start, end = low - wide_low, high - wide_low
    return scores[start[1] : end[1], start[0] : end[0]], np.asarray(low + np.array(origin, dtype=np.float64))


def patches_at(image: Image, origin: tuple[int, int], places: Floats, turns: Array, side: int) -> Floats:
    """(N, side, side) pixels around `places` (N, 2), each grid scaled and rotated by its complex turn."""
    import cv2

    if len(places) == 0:
        return np.zeros((0, side, side))
    step = np.arange(side) - side // 2
    centres = places[:, 0] + 1j * places[:, 1] - complex(*origin)
    square = step[None, :] + 1j * step[:, None]
    grid = (centres[:, None, None] + turns[:, None, None] * square).reshape(-1, side)
    x, y = grid.real.astype(np.float32), grid.imag.astype(np.float32)
    patches = cv2.remap(image.astype(np.float32), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(patches, np.float64).reshape(-1, side, side)


def correlations(first: Floats, second: Floats) -> Floats:
    """(N,) normalised correlation of patches (N, P, P); 0 where one of them is flat."""
    a, b = (p.reshape(len(p), first.shape[1] ** 2) for p in (first, second))
    a, b = a - a.mean(axis=1, keepdims=True), b - b.mean(axis=1, keepdims=True)
    size = np.sqrt((a**2).sum(axis=1) * (b**2).sum(axis=1))
    return np.asarray(np.where(size > 1e-6, (a * b).sum(axis=1) / np.maximum(size, 1e-6), 0.0))


def followed(
    previous: Image,
    current: Image,
    origin: tuple[int, int],
    guess: tuple[int, int],
    places: Floats,
    how: Following,
) -> tuple[Floats, NDArray[np.bool_]]:
    """(N, 2) where the points `places` are in `current`, and which came back when tracked back.

    `previous` is cut at `origin`, a multiple of 4, and `current` by `guess` further, also a
    multiple of 4.
    """
    import cv2

    from bayesnet_track.vision.kernels.flow_kernels import track_points

    middle, later = cv2.pyrDown(previous), cv2.pyrDown(current)
    flows, valid = np.zeros((len(places), 2)), np.zeros(len(places), np.uint8)
    track_points(
        cv2.pyrDown(middle),
        middle,
        for_reading(previous),
        cv2.pyrDown(later),
        later,
        for_reading(current),
        np.rint(places).astype(np.int64),
        np.array(origin, dtype=np.int64),
        2 * how.half_window_px + 1,
        float(how.reach_px),
        how.agree_px,
        flows,
        valid,
    )
    # The flow is that of the nearest pixel: rounding does not add up over frames.
    return places + flows + guess, valid == 1


def find_agreement(
    source: Floats, target: Floats, candidates: NDArray[np.bool_], how: Following
) -> PointMotion | None:
    """The translation or similarity that most candidates follow, fitted to them by least squares; or None."""
    from bayesnet_track.vision.kernels.flow_kernels import consensus

    agreeing = np.zeros(len(source), dtype=np.bool_)
    distance = 2.0 * how.half_window_px
    among = consensus(source[candidates], target[candidates], how.agree_px, distance, how.max_scale)
    agreeing[np.flatnonzero(candidates)[among]] = True
    if not agreeing.any():
        return None
    z, t = source[agreeing] @ [1, 1j], target[agreeing] @ [1, 1j]
    centre, target_centre = complex(z.mean()), complex(t.mean())
    spread = float((np.abs(z - centre) ** 2).sum())
    factor = 1.0 + 0.0j
    if len(z) > FEW and spread > 0:
        factor = complex((np.conj(z - centre) * (t - target_centre)).sum() / spread)
    squares = float((np.abs(t - target_centre - factor * (z - centre)) ** 2).sum())
    free = max(2 * len(z) - (4 if len(z) > FEW else 2), 1)
    return PointMotion(agreeing, target, factor, centre, target_centre, squares / free, spread)


UNSEEN = -12.0
"""Log-likelihoods below this are raised to it: a patch that fits nowhere says nothing."""

SEEN = 0.5
"""A point is seen where the difference to its patch has less than this share of the patch's own variance."""

CONTRAST = 0.3
"""The difference's sd is at most this share of the patch's own: a weak pattern has to fit the better."""


@dataclass(frozen=True)
class Matching:
    """Settings by which points are matched and filtered.

    Attributes:
        reach: largest displacement from the matrix' centre, px per frame in x and in y.
        sd_gray: sd of the difference between patch and picture, gray levels of 255.
        sd_motion_px: noise of a point's velocity, px per frame, per frame interval.
        forget: k of P^(1/k), per frame interval.
        epsilon: of the points' working point.
    """

    reach: int = 12
    sd_gray: float = 8.0
    sd_motion_px: float = 1.0
    forget: float = 1.0
    epsilon: float = 0.3

    @property
    def steps(self) -> Ints:
        """(K,) displacements of a matrix' rows and columns from its centre, px per frame."""
        return np.arange(-self.reach, self.reach + 1)


@dataclass(frozen=True, eq=False)
class Points:
    """N points of an object.

    Attributes:
        at: (N, 2) int64 x, y in px.
        patches: (N, P, P) gray values around them, P odd.
        motion: (N, K, K) probabilities of the displacement per frame, rows v, columns u.
        centre: (2,) int64 u, v of the matrices' middle cell, px per frame.
    """

    at: Ints
    patches: Floats
    motion: Floats
    centre: Ints

    def __len__(self) -> int:
        return len(self.at)


@dataclass(frozen=True, eq=False)
class Displaced:
    """Evidence of one image on an object's motion.

    Attributes:
        points: the points where they are now, with filtered matrices; their patches are the old ones.
        measured: (N, K, K) matrices of this picture alone, normalised.
        seen: (N,) whether a point's patch fits anywhere.
        total: (K, K) P_sum, the sum of the filtered matrices of the points seen, scaled to sum to 1.
        motion: (2,) its mean, the object's displacement, px per frame.
        covariance: (2, 2) of P_sum, whose trace is the paper's MSE.
    """

    points: Points
    measured: Floats
    seen: NDArray[np.bool_]
    total: Floats
    motion: Floats
    covariance: Floats


def displace(
    points: Points, image: Bytes, origin: tuple[int, int], dt: float, centre: Ints, matching: Matching
) -> Displaced | None:
    """The points after `dt` frame intervals, found in a gray picture whose first pixel is at `origin` (x, y).

    Displacements are looked for around `centre` (u, v), whole px per frame. A point whose measurement is less
    probable under its filtered prediction than under none (gamma < 1, U the range of the matrix) starts again
    from the measurement. None when no point is seen.
    """
    squares = mean_squares(points, image, origin, dt, centre, matching)
    variances = points.patches.var(axis=(1, 2))
    visible = squares.min(axis=(1, 2)) < SEEN * variances
    if not visible.any():
        return None
    scale = np.minimum(matching.sd_gray**2, np.maximum(CONTRAST**2 * variances, 1e-9))
    likelihood = np.exp(np.maximum(-squares / (2.0 * scale[:, None, None]), UNSEEN))
    measured = likelihood / likelihood.sum(axis=(1, 2), keepdims=True)
    joint = predict_matrices(points, dt, centre, matching) * likelihood
    evidence = joint.sum(axis=(1, 2), keepdims=True)
    feasible = evidence >= likelihood.mean(axis=(1, 2), keepdims=True)
    filtered = np.where(feasible, joint / np.maximum(evidence, 1e-300), measured)
    total = filtered[visible].mean(axis=0)
    mean, covariance = matrix_moments(total)
    motion = centre + mean
    displacements = centre + working_points(filtered, mean, matching)
    places = points.at + np.rint(displacements * dt).astype(np.int64)
    points_after = Points(places, points.patches, filtered, centre)
    return Displaced(points_after, measured, visible, total, motion, covariance)


def mean_squares(
    points: Points, image: Bytes, origin: tuple[int, int], dt: float, centre: Ints, matching: Matching
) -> Floats:
    """(N, K, K) mean squared difference of each patch and the picture at each displacement; inf outside."""
    from bayesnet_track.vision.kernels.dense_flow_kernels import match_patches

    squares = np.empty((len(points), len(matching.steps), len(matching.steps)))
    match_patches(
        np.ascontiguousarray(image),
        np.array(origin, dtype=np.int64),
        points.at,
        points.patches,
        np.rint((matching.steps + centre[0]) * dt).astype(np.int64),
        np.rint((matching.steps + centre[1]) * dt).astype(np.int64),
        squares,
    )
    return squares


def predict_matrices(points: Points, dt: float, centre: Ints, matching: Matching) -> Floats:
    """The matrices before the next measurement, moved to `centre`, spread by noise, flattened by `forget`.

    What comes into the range from outside has the least probability of the matrix.
    """
    size = points.motion.shape[1]
    first, taps = gaussian_taps(0.0, float(np.sqrt(dt)) * matching.sd_motion_px)
    spread = np.zeros((size, size))
    for column in range(size):
        # Reflected at the ends, so that a matrix that knows nothing stays even.
        cells = (column + first + np.arange(len(taps))) % (2 * size)
        np.add.at(spread[:, column], np.where(cells < size, cells, 2 * size - 1 - cells), taps)
    spread_matrices = np.clip(spread @ points.motion @ spread.T, 0.0, None)
    floor = spread_matrices.min(axis=(1, 2), keepdims=True)
    shifted = np.broadcast_to(floor, spread_matrices.shape).copy()
    u, v = (int(c) for c in np.clip(centre - points.centre, -size, size))
    to, source = _overlap(u, size), _overlap(-u, size)
    to_rows, source_rows = _overlap(v, size), _overlap(-v, size)
    shifted[:, to_rows, to] = spread_matrices[:, source_rows, source]
    total = shifted.sum(axis=(1, 2), keepdims=True)
    shifted = np.where(total > 0, shifted / np.where(total > 0, total, 1.0), 1.0 / size**2)
    return np.stack([flatten(matrix, matching.forget**dt) for matrix in shifted])


def _overlap(shift: int, size: int) -> slice:
    """The cells of a line, moved by `shift`, that it shares with the line before, in its own count."""
    return slice(max(-shift, 0), size - max(shift, 0))


def matrix_moments(matrix: Floats) -> tuple[Floats, Floats]:
    """Mean (u, v) from the centre and covariance (2, 2) of probabilities (K, K), px per frame."""
    steps = np.arange(len(matrix)) - (len(matrix) - 1) / 2
    column_sums, row_sums = matrix.sum(axis=0), matrix.sum(axis=1)
    mean = np.array([column_sums @ steps, row_sums @ steps])
    u, v = steps - mean[0], steps - mean[1]
    mixed = v @ matrix @ u
    return mean, np.array([[column_sums @ u**2, mixed], [mixed, row_sums @ v**2]])


def working_points(filtered: Floats, motion: Floats, matching: Matching) -> Ints:
    """(N, 2) x_opt of each matrix, from its centre: its probable displacement nearest to the object's."""
    u, v = np.meshgrid(matching.steps, matching.steps)
    places = np.column_stack([u.ravel(), v.ravel()]).astype(np.float64)
    indices = [nearest_probable(places, matrix.ravel(), motion, matching.epsilon) for matrix in filtered]
    return places[indices].astype(np.int64)


def flat_motion(count: int, matching: Matching) -> Floats:
    """(N, K, K) matrices of points of which nothing is known."""
    size = len(matching.steps)
    return np.full((count, size, size), 1.0 / size**2)


def cut_patches(
    image: Bytes, origin: tuple[int, int], places: Ints, side: int
) -> tuple[Floats, NDArray[np.bool_]]:
    """(N, side, side) patches around points (zeros outside), and (N,) which lie wholly in the picture."""
    half = side // 2
    patches, is_whole = np.zeros((len(places), side, side)), np.zeros(len(places), dtype=bool)
    for n, (x, y) in enumerate(places - np.array(origin) - half):
        if x >= 0 and y >= 0 and x + side <= image.shape[1] and y + side <= image.shape[0]:
            patches[n], is_whole[n] = image[y : y + side, x : x + side], True
    return patches, is_whole
