"""The displacement-matrix tracker: a distribution of displacement for each of an object's points.

Section 3 of the General Distribution Filter. A point's patch is compared with the new picture at every
displacement in a range; the result is a matrix of probabilities, filtered from frame to frame as the grid
filter filters a velocity. The object moves by the mean of the sum of all matrices, and each point by the
probable displacement nearest to it, so that it stays on its feature of the picture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Bytes, Floats, Ints
from bayesnet_track.numerics.distributions import flatten, gaussian_taps, nearest_probable

UNSEEN = -12.0
"""Log-likelihoods below this are raised to it: a patch that fits nowhere says nothing."""

SEEN = 0.5
"""A point is seen where the difference to its patch has less than this share of the patch's own variance."""

CONTRAST = 0.3
"""The difference's sd is at most this share of the patch's own: a weak pattern has to fit the better."""


@dataclass(frozen=True)
class Matching:
    """How points are matched and filtered.

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
    """What one picture says of an object's motion.

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
    seen = squares.min(axis=(1, 2)) < SEEN * variances
    if not seen.any():
        return None
    scale = np.minimum(matching.sd_gray**2, np.maximum(CONTRAST**2 * variances, 1e-9))
    likelihood = np.exp(np.maximum(-squares / (2.0 * scale[:, None, None]), UNSEEN))
    measured = likelihood / likelihood.sum(axis=(1, 2), keepdims=True)
    joint = predict_matrices(points, dt, centre, matching) * likelihood
    evidence = joint.sum(axis=(1, 2), keepdims=True)
    feasible = evidence >= likelihood.mean(axis=(1, 2), keepdims=True)
    filtered = np.where(feasible, joint / np.maximum(evidence, 1e-300), measured)
    total = filtered[seen].mean(axis=0)
    mean, covariance = moments(total)
    motion = centre + mean
    chosen = centre + working_points(filtered, mean, matching)
    moved = points.at + np.rint(chosen * dt).astype(np.int64)
    now = Points(moved, points.patches, filtered, centre)
    return Displaced(now, measured, seen, total, motion, covariance)


def mean_squares(
    points: Points, image: Bytes, origin: tuple[int, int], dt: float, centre: Ints, matching: Matching
) -> Floats:
    """(N, K, K) mean squared difference of each patch and the picture at each displacement; inf outside."""
    from bayesnet_track.vision.kernels.displacement_kernels import match_patches

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
    for old in range(size):
        # Reflected at the ends, so that a matrix that knows nothing stays even.
        cells = (old + first + np.arange(len(taps))) % (2 * size)
        np.add.at(spread[:, old], np.where(cells < size, cells, 2 * size - 1 - cells), taps)
    known = np.clip(spread @ points.motion @ spread.T, 0.0, None)
    least = known.min(axis=(1, 2), keepdims=True)
    moved = np.broadcast_to(least, known.shape).copy()
    u, v = (int(c) for c in np.clip(centre - points.centre, -size, size))
    to, source = _overlap(u, size), _overlap(-u, size)
    to_rows, source_rows = _overlap(v, size), _overlap(-v, size)
    moved[:, to_rows, to] = known[:, source_rows, source]
    total = moved.sum(axis=(1, 2), keepdims=True)
    moved = np.where(total > 0, moved / np.where(total > 0, total, 1.0), 1.0 / size**2)
    return np.stack([flatten(matrix, matching.forget**dt) for matrix in moved])


def _overlap(shift: int, size: int) -> slice:
    """The cells of a line, moved by `shift`, that it shares with the line before, in its own count."""
    return slice(max(-shift, 0), size - max(shift, 0))


def moments(matrix: Floats) -> tuple[Floats, Floats]:
    """Mean (u, v) from the centre and covariance (2, 2) of probabilities (K, K), px per frame."""
    steps = np.arange(len(matrix)) - (len(matrix) - 1) / 2
    across, down = matrix.sum(axis=0), matrix.sum(axis=1)
    mean = np.array([across @ steps, down @ steps])
    u, v = steps - mean[0], steps - mean[1]
    mixed = v @ matrix @ u
    return mean, np.array([[across @ u**2, mixed], [mixed, down @ v**2]])


def working_points(filtered: Floats, motion: Floats, matching: Matching) -> Ints:
    """(N, 2) x_opt of each matrix, from its centre: its probable displacement nearest to the object's."""
    u, v = np.meshgrid(matching.steps, matching.steps)
    places = np.column_stack([u.ravel(), v.ravel()]).astype(np.float64)
    chosen = [nearest_probable(places, matrix.ravel(), motion, matching.epsilon) for matrix in filtered]
    return places[chosen].astype(np.int64)


def flat_motion(count: int, matching: Matching) -> Floats:
    """(N, K, K) matrices of points of which nothing is known."""
    size = len(matching.steps)
    return np.full((count, size, size), 1.0 / size**2)


def cut_patches(
    image: Bytes, origin: tuple[int, int], at: Ints, side: int
) -> tuple[Floats, NDArray[np.bool_]]:
    """(N, side, side) patches around points (zeros outside), and (N,) which lie wholly in the picture."""
    half = side // 2
    patches, whole = np.zeros((len(at), side, side)), np.zeros(len(at), dtype=bool)
    for n, (x, y) in enumerate(at - np.array(origin) - half):
        if x >= 0 and y >= 0 and x + side <= image.shape[1] and y + side <= image.shape[0]:
            patches[n], whole[n] = image[y : y + side, x : x + side], True
    return patches, whole
