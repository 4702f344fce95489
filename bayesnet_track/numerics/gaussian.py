"""Gaussians: factors of covariances, samples, quantiles, moments of weighted points, linear updates.

Sums run in a fixed order, so that results do not depend on the linear algebra library or its threads.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from bayesnet_track.numerics.arrays import Bools, Floats, Ints
from bayesnet_track.numerics.compiled import compiled


@compiled
def factor(matrix: Floats, lower: Floats, size: int) -> float:
    """Fill `lower` with Cholesky's factor of the first `size` rows and columns; half the log determinant."""
    half = 0.0
    for j in range(size):
        for i in range(j, size):
            value = matrix[i, j]
            for k in range(j):
                value -= lower[i, k] * lower[j, k]
            if i == j:
                lower[j, j] = math.sqrt(max(value, 1e-300))
                half += math.log(lower[j, j])
            else:
                lower[i, j] = value / lower[j, j]
    return half


@compiled
def fill_root(covariance: Floats, lower: Floats, remainder: Floats, scale: Floats, least_share: float) -> int:
    """Fill `lower` (D, K) as `numerics.gaussian.root` does; K."""
    size = covariance.shape[0]
    along = np.empty(size)  # a column of `lower`, its values one apart in memory
    for i in range(size):
        sd = math.sqrt(max(covariance[i, i], 0.0))
        scale[i] = sd if sd > 0 else 1.0
    for i in range(size):
        for j in range(size):
            remainder[i, j] = covariance[i, j] / (scale[i] * scale[j])
    width = 0
    for k in range(size):
        if remainder[k, k] > least_share:
            pivot = math.sqrt(remainder[k, k])
            for i in range(size):
                along[i] = remainder[i, k] / pivot
                lower[i, width] = along[i]
            for i in range(size):
                for j in range(size):
                    remainder[i, j] -= along[i] * along[j]
            width += 1
    for i in range(size):
        for k in range(width):
            lower[i, k] *= scale[i]
    return width


@compiled
def carry(
    transition: Floats, noise: Floats, mean: Floats, covariance: Floats, carried_mean: Floats, spread: Floats
) -> None:
    """Fill `carried_mean` (D,) with F m and `spread` (D, D) with F P F' + Q, exactly symmetric."""
    width = mean.shape[0]
    product = np.empty((width, width))
    for i in range(width):
        value = 0.0
        for k in range(width):
            value += transition[i, k] * mean[k]
        carried_mean[i] = value
        for j in range(width):
            value = 0.0
            for k in range(width):
                value += transition[i, k] * covariance[k, j]
            product[i, j] = value
    for i in range(width):
        for j in range(width):
            value = 0.0
            for k in range(width):
                value += product[i, k] * transition[j, k]
            spread[i, j] = value + noise[i, j]
    for i in range(width):
        for j in range(i):
            value = 0.5 * (spread[i, j] + spread[j, i])
            spread[i, j], spread[j, i] = value, value


@compiled
def stand_for(
    mean: Floats,
    covariance: Floats,
    half: Floats,
    bounds: tuple[float, float, float],
    unit: Floats,
    filled: tuple[Floats, Floats],
) -> bool:
    """Fill states (N, D) that stand for a Gaussian, by draws `half` (N // 2, D) of N(0, I).

    Their mean and covariance are its own, until centres are moved onto an image of the width and height in
    `bounds` (infinite: they go anywhere), and sizes to 1 px .. twice the image's. `filled` are the Gaussian's
    root (D, D) and the states; `unit` (N, D) is them in units of the root. True where each field keeps more
    than the share of its sd that is last in `bounds` when those before it are known; else all is worthless.
    """
    (lower, states), (image_width, image_height, least_share) = filled, bounds
    size, width, pairs = unit.shape[0], mean.shape[0], half.shape[0]
    white, room = np.zeros((width, width)), np.empty((width, width))
    for i in range(width):
        unit[size - 1, i] = 0.0  # that of an odd number has no opposite
        for k in range(i + 1, width):
            lower[i, k] = 0.0
        for k in range(i + 1):
            room[i, k] = covariance[i, k] / (math.sqrt(covariance[i, i]) * math.sqrt(covariance[k, k]))
    factor(room, lower, width)
    is_full = True
    for i in range(width):
        is_full = is_full and lower[i, i] > least_share  # not where it is NaN
        for k in range(i + 1):
            lower[i, k] *= math.sqrt(covariance[i, i])
            value = 0.0
            for n in range(pairs):
                value += half[n, i] * half[n, k]
            room[i, k] = 2.0 * value / size
    factor(room, white, width)
    for n in range(pairs):
        for i in range(width):
            value = half[n, i]
            for k in range(i):
                value -= white[i, k] * unit[n, k]
            unit[n, i] = value / white[i, i]
            unit[pairs + n, i] = -unit[n, i]
    for n in range(size):
        for i in range(width):
            value = mean[i]
            for k in range(i + 1):
                value += unit[n, k] * lower[i, k]
            states[n, i] = value
        for i in range(4):
            extent = image_height if i % 2 else image_width
            lowest = 0.0 if extent < np.inf else -np.inf
            low, high = (lowest, extent - 1.0) if i < 2 else (1.0, 2.0 * extent)
            if states[n, i] < low:
                states[n, i] = low
            elif states[n, i] > high:
                states[n, i] = high
    return is_full


@compiled
def correct_fields(
    mean: Floats, covariance: Floats, columns: Ints, measured: Floats, variances: Floats
) -> tuple[float, float]:
    """Update the mean (D,) and covariance (D, D) in place by K columns whose errors are independent.

    They are taken one after the other. Squared Mahalanobis distance of all, and their log-likelihood, as
    `numerics.gaussian.linear_update` has them.
    """
    size, column, d2, log_ratio = mean.shape[0], np.empty(mean.shape[0]), 0.0, 0.0
    for i in range(columns.shape[0]):
        k = columns[i]
        expected = covariance[k, k] + variances[i]
        innovation, share = measured[i] - mean[k], variances[i] / expected
        for a in range(size):
            column[a] = covariance[a, k]
        for a in range(size):
            gain = column[a] / expected
            mean[a] += gain * innovation
            for b in range(a + 1):
                # Of the field itself without the difference, which would round most there.
                value = share * column[a + b - k] if a == k or b == k else covariance[a, b] - gain * column[b]
                covariance[a, b], covariance[b, a] = value, value
        d2 += innovation * innovation / expected
        log_ratio += math.log(share)
    return d2, 0.5 * log_ratio - 0.5 * d2


@compiled
def independent_log(errors: Floats, variances: Floats, largest: float, log: Floats) -> None:
    """Fill `log` (N,) with -d^2 / 2 of `errors` (N, K) of `variances` (K,), each square at most `largest`."""
    for n in range(errors.shape[0]):
        d2 = 0.0
        for k in range(errors.shape[1]):
            sds = errors[n, k] / math.sqrt(variances[k])
            square = sds * sds
            d2 += square if square < largest else largest  # also where it is NaN
        log[n] = -0.5 * d2


ALONE = 1e-12
"""A field whose variance is less than this share of it when the fields before are known follows from them."""


@dataclass(frozen=True, eq=False)
class Updated:
    """A Gaussian after a measurement.

    Attributes:
        mean: (D,).
        covariance: (D, D), symmetric.
        d2: squared Mahalanobis distance of the innovation.
        log_likelihood: log of the prior's mean of exp(-e' R^-1 e / 2), e the measurement's error: 0 for a
            measurement of unlimited width. The density of the measurement is this over sqrt(|2 pi R|).
    """

    mean: Floats
    covariance: Floats
    d2: float
    log_likelihood: float


def symmetric(matrix: Floats) -> Floats:
    """(..., D, D) the mean of each matrix and its transpose."""
    return np.asarray(0.5 * (matrix + matrix.swapaxes(-1, -2)))


def adopt(
    mean: Floats, covariance: Floats, columns: Sequence[int], marginal: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """N(mean, covariance) of a state with another marginal of some columns: (K,) mean and (K, K) covariance.

    What the state is, given these columns, stays as it was (Jeffrey's rule).
    """
    block, (target, spread) = np.ix_(columns, columns), marginal
    scale = np.sqrt(np.diagonal(covariance)[list(columns)])  # an offset of .1 s beside a rate of 1e-5
    scaled = covariance[:, list(columns)] / scale
    gain = np.linalg.solve(covariance[block] / np.outer(scale, scale), scaled.T).T / scale
    updated = symmetric(covariance + gain @ (spread - covariance[block]) @ gain.T)
    updated[block] = spread
    shifted = mean + gain @ (target - mean[list(columns)])
    shifted[list(columns)] = target
    return shifted, updated


def root(covariance: Floats) -> Floats:
    """(D, K) A with A A' = covariance, K its rank: Cholesky's, without columns that would be 0.

    The first axis is along the first field and what it predicts of the others, and so on.

    >>> root(np.diag([4.0, 0.0])).tolist()
    [[2.0], [0.0]]
    """
    variances = covariance.diagonal()
    if variances.min(initial=1.0) > 0.0:  # the usual case, in a fifth of the time
        sds = np.sqrt(variances)
        try:
            lower = np.linalg.cholesky(covariance / (sds[:, None] * sds))
        except np.linalg.LinAlgError:
            return roots(covariance[None])[0]
        if lower.diagonal().min(initial=1.0) > math.sqrt(ALONE):
            return np.asarray(lower * sds[:, None])
    return roots(covariance[None])[0]


def roots(covariances: Floats) -> list[Floats]:
    """(T,) arrays (D, K), as `root` of each covariance (T, D, D).

    >>> [lower.shape for lower in roots(np.array([np.eye(2), np.diag([4.0, 0.0])]))]
    [(2, 2), (2, 1)]
    """
    sds = np.sqrt(np.maximum(np.diagonal(covariances, axis1=1, axis2=2), 0.0))
    # Of the correlations: px and px per frame may differ by orders of magnitude.
    scale = np.where(sds > 0, sds, 1.0)
    remainder = covariances / (scale[:, :, None] * scale[:, None, :])
    columns, is_kept = np.empty_like(remainder), np.empty(sds.shape, dtype=np.bool_)  # (T, K, D), (T, K)
    for k in range(sds.shape[1]):
        has = remainder[:, k, k] > ALONE
        pivots = np.sqrt(np.where(has, remainder[:, k, k], np.inf))
        columns[:, k], is_kept[:, k] = remainder[:, :, k] / pivots[:, None], has
        remainder = remainder - columns[:, k, :, None] * columns[:, k, None, :]
    columns *= scale[:, None, :]
    return [rows[mask].T for rows, mask in zip(columns, is_kept, strict=True)]


def linear_update(
    mean: Floats, covariance: Floats, innovation: Floats, observe: Floats, noise: Floats
) -> Updated:
    """The Kalman update, covariance in Joseph's form: a sum of squares, so that it stays positive.

    Args:
        mean: (D,) before.
        covariance: (D, D) before.
        innovation: (K,) measured less expected.
        observe: (K, D) H, what is measured of a state.
        noise: (K, K) R of the measurement, positive definite.
    """
    cross = covariance @ observe.T
    expected = symmetric(observe @ cross + noise)
    gain = np.linalg.solve(expected, cross.T).T
    complement = np.eye(len(mean)) - gain @ observe
    d2, log_likelihood = innovation_likelihood(innovation, expected, noise)
    updated = symmetric(complement @ covariance @ complement.T + gain @ noise @ gain.T)
    return Updated(mean + gain @ innovation, updated, d2, log_likelihood)


def update_by_fields(
    mean: Floats, covariance: Floats, columns: Sequence[int], measured: Floats, variances: Sequence[float]
) -> Updated:
    """`linear_update` by K columns of the state whose errors are independent: one after the other, as exact.

    >>> after = update_by_fields(np.zeros(2), np.diag([1.0, 4.0]), [1], np.array([10.0]), [4.0])
    >>> after.mean.tolist(), after.covariance.tolist(), after.d2
    ([0.0, 5.0], [[1.0, 0.0], [0.0, 2.0]], 12.5)
    """
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.compiled import plain

    updated, spread = np.array(mean), np.array(covariance, order="C")
    d2, log_likelihood = correct_fields(
        updated, spread, np.array(columns), plain(measured), np.array(variances)
    )
    return Updated(updated, spread, d2, log_likelihood)


def innovation_likelihood(innovation: Floats, expected: Floats, noise: Floats) -> tuple[float, float]:
    """d^2 of an innovation (K,) of covariance S, and log sqrt(|R| / |S|) - d^2 / 2."""
    d2 = float(innovation @ np.linalg.solve(expected, innovation))
    log_ratio = np.linalg.slogdet(noise)[1] - np.linalg.slogdet(expected)[1]
    return d2, 0.5 * float(log_ratio) - 0.5 * d2


# ------------------------------------------------------------------------------------ points


def standard_normals(size: int, width: int, rng: np.random.Generator) -> Floats:
    """(size, width) draws whose mean is 0 and whose covariance (divisor `size`) is the identity exactly.

    Antithetic pairs, so that every odd moment vanishes (an odd `size` has one draw at 0), then whitened.

    Raises:
        ValueError: fewer than 2 (width + 1) draws, which might not span the space.
    """
    if size < 2 * (width + 1):
        raise ValueError(f"{size} draws cannot stand for {width} dimensions; at least {2 * (width + 1)}")
    return whiten(rng.standard_normal((size // 2, width)), size)


def whiten(half: Floats, size: int) -> Floats:
    """(size, K) draws `half` (size // 2, K), their negatives, and 0 for an odd `size`; covariance I."""
    lower = np.linalg.cholesky((half.T @ half) * (2.0 / size))
    white = half @ np.linalg.inv(lower).T
    middle = (np.zeros((1, half.shape[1])),) if size % 2 else ()
    return np.concatenate([white, -white, *middle])


def sigma_points(width: int, scale: float) -> Floats:
    """(2 width + 1, width) the points of the unscented transform: 0 and +-sqrt(scale) on each axis."""
    offsets = math.sqrt(scale) * np.eye(width)
    return np.concatenate([np.zeros((1, width)), offsets, -offsets])


@dataclass(frozen=True, eq=False)
class Expectation:
    """Expected values of functions of T Gaussian states.

    Attributes:
        values: (T, K) their means.
        spread: (T, K, K) their covariances.
        cross: (T, D, K) covariances of state and values.
        is_known: (T,) whether the functions have values there.
        at_mean: (T, K) values at the mean.
    """

    values: Floats
    spread: Floats
    cross: Floats
    is_known: Bools
    at_mean: Floats


def weighted_moments(points: Floats, weights: Floats) -> tuple[Floats, Floats]:
    """(D,) mean and (D, D) covariance of points (N, D) of weights (N,) that sum to 1."""
    mean = weights @ points
    deviations = points - mean
    return np.asarray(mean), np.asarray((deviations * weights[:, None]).T @ deviations)


# ------------------------------------------------------------------------------------ chi-square


def chi_square_cdf(x: float, degrees: int) -> float:
    """Probability that a chi-square variable of `degrees` of freedom is at most x.

    >>> round(chi_square_cdf(9.2103, 2), 4)
    0.99
    """
    from scipy.special import chdtr  # here, because it takes long to import

    return float(chdtr(degrees, x)) if x > 0 else 0.0


@lru_cache(maxsize=64)
def chi_square_quantile(probability: float, degrees: int) -> float:
    """x below which a chi-square variable of `degrees` of freedom lies with a probability.

    >>> round(chi_square_quantile(0.95, 1), 4)
    3.8415
    """
    from scipy.special import gammaincinv

    return 2.0 * float(gammaincinv(0.5 * degrees, probability))
