"""Discrete distributions, tests on samples, Markov chains of few states.

From "A general filter for measurements with any probability distribution" (the General Distribution Filter).

Targets differ by far more than one standard deviation can hold: the flow of a rigid car changes by 0.1 px
from frame to frame, that of a runner by 5 px. A cue that remembers how much its own target varied needs only
a standard deviation to start with.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from bayesnet_track.numerics.arrays import Array, Floats

REACH = 7.0
"""Sds at which the kernel of Gaussian noise ends: 3e-12 of its mass lies further out."""

SUBCELL = 1.0
"""Sd in cells from which samples of the Gaussian are a kernel: their moments err by 2 exp(-2 pi^2) = 5e-9."""


@lru_cache(maxsize=4096)
def gaussian_taps(shift: float, sd: float) -> tuple[int, Floats]:
    """A kernel on whole cells that moves mass by `shift` and spreads it by `sd`, both in cells.

    Returns:
        The cell of the first tap, and the taps, which sum to 1.

    Mean and variance are those asked for. Below one cell of sd, where samples of the Gaussian would be
    biased, seven taps have its moments up to the sixth (some are slightly negative then: exact on densities
    that are wider than a cell); a pure shift is Lagrange interpolation of the sixth degree.

    >>> first, taps = gaussian_taps(2.25, 0.0)
    >>> cells = first + np.arange(len(taps))
    >>> round(float(taps @ cells), 12), abs(round(float(taps @ (cells - 2.25) ** 2), 12))
    (2.25, 0.0)
    """
    base = round(shift)
    fraction = shift - base
    if sd >= SUBCELL:
        reach = int(np.ceil(REACH * sd))
        taps = np.exp(-0.5 * ((np.arange(-reach, reach + 1) - fraction) / sd) ** 2)
        taps /= taps.sum()
    else:
        reach = 3
        moments = [1.0, fraction]
        for n in range(2, 7):
            moments.append(fraction * moments[-1] + (n - 1) * sd**2 * moments[-2])
        taps = _from_moments() @ np.array(moments)
    taps.setflags(write=False)
    return base - reach, taps


@lru_cache(maxsize=1)
def _from_moments() -> Floats:
    """(7, 7): moments 0 to 6 -> weights of the cells -3 .. 3."""
    return np.linalg.inv(np.vander(np.arange(-3.0, 4.0), increasing=True).T)


def spreading_matrix(size: int, factor: float, sd: float) -> Floats:
    """(size, size) of p(new cell | old cell) for new = factor old + noise of `sd`, in cells from the middle.

    Columns sum to 1. What would leave the axis stays in its last cell. As mass moves and not a density, the
    factor 1 / |det Phi| of eq. 2 (corrected) is in the spacing of the moved cells.
    """
    matrix = np.zeros((size, size))
    middle = (size - 1) / 2
    for column in range(size):
        first, taps = gaussian_taps(factor * (column - middle) + middle, sd)
        cells = np.clip(first + np.arange(len(taps)), 0, size - 1)
        np.add.at(matrix[:, column], cells, taps)
    return matrix


def flatten(mass: Floats, k: float) -> Floats:
    """The distribution P^(1/k), normalised: exponentially less weight for older measurements (1.5).

    Right for masses of cells of one size, which are densities; a Gaussian's sd grows by sqrt(k). Raising the
    weights of particles to 1/k is not the same: they are not densities.
    """
    if k == 1.0:
        return mass
    flat = (mass / mass.max()) ** (1.0 / k)
    return np.asarray(flat / flat.sum())


def feasibility(prior: Floats, likelihood: Floats, mean_likelihood: float) -> float:
    """gamma = E L under the prior / the mean of L over a region U: eq. 5 of the General Distribution Filter.

    `prior` and `likelihood` are of the same cells (or of samples and their weights). It depends on U, which
    must be stated with it. NaN when the likelihood is 0 all over U.
    """
    return float((prior * likelihood).sum() / mean_likelihood) if mean_likelihood > 0 else float("nan")


def false_reset_level(prior: Floats, likelihood: Floats, rate: float) -> float:
    """The level of gamma below which a share `rate` of the frames of a right prediction falls.

    A right prediction puts the likelihood's peak at z as the prior, widened by the peak's error, says.
    So the frame's own likelihood is moved to every z, gamma(z) is taken there, and its quantile under that
    predictive distribution is the level. The peak's error is that of the Gaussian which has the same cells
    above half of its height; below, a likelihood is often nothing but a floor. U is the whole of the arrays;
    what is moved across their border has the least likelihood that was seen.

    Args:
        prior: masses of the cells of U, any number of dimensions, summing to 1.
        likelihood: of the same cells.
        rate: share of frames.

    Returns:
        The level; 0 (never) when the likelihood is the same everywhere.
    """
    floor, peak = float(likelihood.min()), np.unravel_index(int(np.argmax(likelihood)), likelihood.shape)
    excess = likelihood - floor
    if excess.max() <= 0:
        return 0.0
    sizes, axes = tuple(2 * n for n in prior.shape), tuple(range(prior.ndim))
    # Correlations by FFT over arrays padded to twice the size, so that nothing wraps round.
    region = tuple(slice(0, n) for n in prior.shape)
    centred = np.zeros(sizes)
    centred[region] = excess
    centred = np.roll(centred, [-int(place) for place in peak], axes)
    prior_transform = np.fft.rfftn(prior, sizes, axes)
    error = np.fft.rfftn(_peak_error(excess, peak, sizes), sizes, axes)
    expected = (
        np.fft.irfftn(prior_transform * np.conj(np.fft.rfftn(centred, sizes, axes)), sizes, axes)[region]
        + floor
    )
    chance = np.clip(np.fft.irfftn(prior_transform * error, sizes, axes)[region], 0.0, None)
    gammas = expected.ravel() / likelihood.mean()
    order = np.argsort(gammas)
    cumulative = np.cumsum(chance.ravel()[order])
    return float(gammas[order][np.searchsorted(cumulative, rate * cumulative[-1])])


def _peak_error(excess: Floats, peak: tuple[np.intp, ...], sizes: tuple[int, ...]) -> Floats:
    """Masses (sizes) of a Gaussian around cell 0, as wide as what is above half of the peak.

    An even ellipsoid of d dimensions has variance a^2 / (d + 2) along a half axis a, and a Gaussian falls to
    half at a^2 = 2 ln 2 sd^2. A cell's own 1 / 12 is added.
    """
    axes = [k for k, size in enumerate(excess.shape) if size > 1]
    if not axes:
        return np.ones(sizes)
    offsets = np.argwhere(excess >= 0.5 * excess.max())[:, axes] - np.array([peak[k] for k in axes])
    spread = (len(axes) + 2) / (2.0 * np.log(2.0)) * (offsets.T @ offsets) / len(offsets) + np.eye(
        len(axes)
    ) / 12.0
    steps = np.meshgrid(*(np.fft.fftfreq(size, 1.0 / size) for size in sizes), indexing="ij")
    deviations = np.stack([steps[k] for k in axes], axis=-1)
    return np.asarray(np.exp(-0.5 * np.einsum("...k,kl,...l", deviations, np.linalg.inv(spread), deviations)))


def nearest_probable(points: Floats, weights: Floats, toward: Floats, epsilon: float) -> int:
    """argmin |s - toward| over {s : P(s) >= epsilon max P}: the working point x_opt (1.3, corrected).

    epsilon = 1 leaves the most probable points; epsilon -> 0 gives the point nearest to `toward`.

    Args:
        points: (N, K).
        weights: (N,) their probability densities, up to a factor.
        toward: (K,) the external vector.
        epsilon: 0 .. 1.

    >>> points = np.array([[0.0], [1.0], [5.0]])
    >>> [nearest_probable(points, np.array([1.0, 0.4, 0.9]), np.array([2.0]), e) for e in (1.0, 0.8, 0.3)]
    [0, 0, 1]
    """
    squared_distances = np.sum((points - toward) ** 2, axis=1)
    return int(np.argmin(np.where(weights >= epsilon * weights.max(), squared_distances, np.inf)))


_EXACT = 1e12
"""Trials from which on the sampling error, below 1e-6, counts for nothing."""


@lru_cache(maxsize=64)
def vouched_share(share: float, trials: float, confidence: float) -> float:
    """The largest share p0 that the test with `confidence` still grants: the lower Clopper-Pearson bound.

    Args:
        share: share of the sample that has the property, 0 to 1.
        trials: its effective size, above 0; inf when `share` is exact.
        confidence: one-sided, 0.5 to 1.

    Returns:
        p at which P(X >= share * trials) of X ~ Binomial(trials, p) is 1 - confidence, between whole numbers
        continued as the incomplete beta function; `share` itself when exact.

    >>> round(vouched_share(1.0, 29, 0.95), 4), vouched_share(0.7, float("inf"), 0.95)
    (0.9019, 0.7)
    """
    share = min(max(share, 0.0), 1.0)
    successes = share * trials
    if trials >= _EXACT or successes == 0.0:
        return share
    from scipy.special import betaincinv  # here, because it takes long to import

    return float(betaincinv(successes, trials - successes + 1.0, 1.0 - confidence))


DIGITS = 6
"""Decimals of a p-value."""


def p_value(value: Floats, weights: Floats, means: Floats, covariances: Floats) -> float:
    """Probability that a draw lies farther out than `value` (K,), 0 to 1; uniform where it is a draw.

    Of one Gaussian, far out means a large Mahalanobis distance. Of a mixture, fields are taken one after the
    other: u_k = P(draw_k <= value_k | draw_1..k-1 = value_1..k-1) are uniform and independent (Rosenblatt
    1952). The sum of their squared normal quantiles takes the place of the squared distance, which it is of
    one Gaussian.

    Args:
        value: (K,).
        weights: (N,) of the components, which sum to 1.
        means: (N, K).
        covariances: (N, K, K), or (1, K, K) of all.
    """
    from scipy.special import chdtrc, ndtr, ndtri  # here, because it takes long to import

    lower = np.linalg.cholesky(covariances)
    whitened = np.linalg.solve(lower, (value - means)[..., None])[..., 0]
    if len(means) == 1:
        return round(float(chdtrc(len(value), whitened[0] @ whitened[0])), DIGITS)
    squared, log = 0.0, np.log(np.maximum(weights, 1e-300))
    for k in range(len(value)):
        shares = np.exp(log - log.max())
        shares /= shares.sum()
        lower_tail, upper_tail = float(shares @ ndtr(whitened[:, k])), float(shares @ ndtr(-whitened[:, k]))
        squared += float(ndtri(max(min(lower_tail, upper_tail), 1e-300))) ** 2
        log = log - 0.5 * whitened[:, k] ** 2 - np.log(lower[:, k, k])
    return round(float(chdtrc(len(value), squared)), DIGITS)


def p_after(values: Floats, noises: Floats, means: Floats, covariances: Floats) -> Floats:
    """(T,) as `p_value`, from the Gaussians of the measured fields after Kalman updates by one value each.

    With r = value - mean, d^2 = r' (R - P)^-1 r is the squared distance of the innovation before the update.

    Args:
        values: (T, K).
        noises: (T, K, K) R.
        means: (T, K) after.
        covariances: (T, K, K) P, after.
    """
    residual = values - means
    d2 = np.einsum("tk,tk->t", residual, np.linalg.solve(noises - covariances, residual[..., None])[..., 0])
    return p_beyond(np.maximum(d2, 0.0), values.shape[1])


def p_beyond(d2: Floats, degrees: int) -> Floats:
    """(T,) probabilities that draws of a Gaussian of so many fields lie beyond squared distances (T,)."""
    from scipy.special import chdtrc

    return np.asarray(np.round(chdtrc(degrees, d2), DIGITS))


_REACH = 9.0
"""Sds at which a Gaussian is taken to end: 2e-19 of its mass lies further out."""


def weighted_mass_in_disc(points: Floats, weights: Floats, centre: Floats, radius: float) -> float:
    """Share of the weights (N,), summing to 1, whose points (N, 2) lie within `radius` of `centre`.

    >>> weighted_mass_in_disc(np.array([[0.0, 3], [4, 0]]), np.array([0.25, 0.75]), np.zeros(2), 3.0)
    0.25
    """
    offsets = points - centre
    in_disc = np.einsum("nk,nk->n", offsets, offsets) <= radius * radius
    return min(float(weights[in_disc].sum()), 1.0)


def gaussian_mass_in_disc(offset: Floats, covariance: Floats, radius: float) -> float:
    """Mass of N(offset, covariance), (2,) and (2, 2), within `radius` of the origin; error below 1e-9.

    On the principal axes, along the narrower one: the integral of phi(u / s1) / s1 times the normal mass of
    the chord there, with u = radius sin(theta), which takes the root out of the chord's ends.

    >>> round(gaussian_mass_in_disc(np.zeros(2), np.eye(2), 1.0), 9), round(1 - math.exp(-0.5), 9)
    (0.39346934, 0.39346934)
    """
    from scipy.special import ndtr  # here, because it takes long to import

    variances, axes = np.linalg.eigh(covariance)
    (a, b), (s1, s2) = axes.T @ offset, np.sqrt(np.maximum(variances, (1e-9 * radius) ** 2))
    low, high = max(-radius, a - _REACH * s1), min(radius, a + _REACH * s1)
    if low >= high:
        return 0.0
    start, end = math.asin(low / radius), math.asin(high / radius)
    nodes, weights = _gauss_legendre()
    theta = 0.5 * (end - start) * nodes + 0.5 * (end + start)
    u, chord = radius * np.sin(theta), radius * np.cos(theta)
    density = np.exp(-0.5 * ((u - a) / s1) ** 2) / (s1 * math.sqrt(2.0 * math.pi))
    ends = ndtr((chord - b) / s2) - ndtr((-chord - b) / s2)
    return min(max(float(0.5 * (end - start) * np.sum(weights * density * ends * chord)), 0.0), 1.0)


@lru_cache(maxsize=1)
def _gauss_legendre() -> tuple[Floats, Floats]:
    nodes, weights = np.polynomial.legendre.leggauss(160)
    return nodes, weights


SPREAD = "spread"
"""Name, in a reference, of the factors (k,) on the cue's k standard deviations."""

BOUNDS = (0.1, 30.0)
"""Least and largest factor: a rendered target does not vary at all, and a wrong match by any amount."""

MEAN_DEVIATION = float(np.sqrt(2.0 / np.pi))
"""Mean absolute deviation of a Gaussian, in standard deviations."""


def spread_of(reference: Mapping[str, Array], count: int) -> Floats:
    """The factors (count,); 1 in a reference without them."""
    return np.asarray(reference.get(SPREAD, np.ones(count)), dtype=np.float64)


def start_spread(count: int, frames: float | None) -> dict[str, Array]:
    """`SPREAD` alone, of a target of which nothing is known yet; nothing where sds do not follow."""
    return {} if frames is None else {SPREAD: np.ones(count)}


def follow_spread(
    reference: Mapping[str, Array], errors: Sequence[Floats], sds: Sequence[float], frames: float | None
) -> dict[str, Array]:
    """`SPREAD` alone, moved toward what the errors (n,) of each standard deviation say, over so many frames.

    Each factor is the mean absolute error of the last frames over that of a Gaussian with the standard
    deviation. One without errors in this frame stays. Nothing where sds do not follow (`frames` is None).

    >>> follow_spread({}, [np.array([-4.0, 4.0]), np.empty(0)], [1.0, 1.0], 5.0)["spread"].round(3).tolist()
    [1.727, 1.0]
    """
    if frames is None:
        return {}
    factors, share = spread_of(reference, len(sds)).copy(), -np.expm1(-1.0 / frames)
    for k, (residuals, sd) in enumerate(zip(errors, sds, strict=True)):
        if len(residuals):
            factors[k] += share * (np.abs(residuals).mean() / (MEAN_DEVIATION * sd) - factors[k])
    return {SPREAD: np.clip(factors, *BOUNDS)}


Rows = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class Chain:
    """A chain of K states.

    Attributes:
        rows: (K, K) rates per frame interval, each row summing to 0; or the transition matrix of one frame
            interval, each row summing to 1.
        by_rates: whether they are rates.
    """

    rows: Rows
    by_rates: bool

    def over(self, dt: float) -> Floats:
        """(K, K) probabilities of the state `dt` frame intervals later, by the state before; read-only.

        By rates it is exact for any `dt`. A matrix is raised to the whole part of `dt`; what is left of it is
        the share of one more step.
        """
        return _over(self, dt)

    def stationary(self) -> Floats:
        """(K,) shares of time in the long run."""
        matrix = self.over(1.0)
        size = len(matrix)
        system = np.concatenate([matrix.T - np.eye(size), np.ones((1, size))])
        shares = np.linalg.lstsq(system, np.append(np.zeros(size), 1.0), rcond=None)[0]
        shares = np.maximum(shares, 0.0)
        return np.asarray(shares / shares.sum())


@lru_cache(maxsize=256)
def _over(chain: Chain, dt: float) -> Floats:
    matrix = np.array(chain.rows)
    if chain.by_rates:
        from scipy.linalg import expm  # here, because it takes long to import

        transition = np.maximum(expm(matrix * dt), 0.0)
    else:
        power = int(dt)
        step = (1.0 - (dt - power)) * np.eye(len(matrix)) + (dt - power) * matrix
        transition = np.linalg.matrix_power(matrix, power) @ step
    transition = np.asarray(transition / transition.sum(axis=1, keepdims=True))
    transition.setflags(write=False)
    return transition
