"""Discrete distributions: kernels of noise, adaptivity, feasibility and working points.

From "A general filter for measurements with any probability distribution" (the General Distribution Filter).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from bayesnet_track.numerics.arrays import Floats

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
    rest = shift - base
    if sd >= SUBCELL:
        reach = int(np.ceil(REACH * sd))
        taps = np.exp(-0.5 * ((np.arange(-reach, reach + 1) - rest) / sd) ** 2)
        taps /= taps.sum()
    else:
        reach = 3
        moments = [1.0, rest]
        for n in range(2, 7):
            moments.append(rest * moments[-1] + (n - 1) * sd**2 * moments[-2])
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
    for old in range(size):
        first, taps = gaussian_taps(factor * (old - middle) + middle, sd)
        cells = np.clip(first + np.arange(len(taps)), 0, size - 1)
        np.add.at(matrix[:, old], cells, taps)
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
    above = likelihood - floor
    if above.max() <= 0:
        return 0.0
    sizes, axes = tuple(2 * n for n in prior.shape), tuple(range(prior.ndim))
    # Correlations by FFT over arrays padded to twice the size, so that nothing wraps round.
    inside = tuple(slice(0, n) for n in prior.shape)
    centred = np.zeros(sizes)
    centred[inside] = above
    centred = np.roll(centred, [-int(at) for at in peak], axes)
    known = np.fft.rfftn(prior, sizes, axes)
    error = np.fft.rfftn(_peak_error(above, peak, sizes), sizes, axes)
    expected = np.fft.irfftn(known * np.conj(np.fft.rfftn(centred, sizes, axes)), sizes, axes)[inside] + floor
    chance = np.clip(np.fft.irfftn(known * error, sizes, axes)[inside], 0.0, None)
    gammas = expected.ravel() / likelihood.mean()
    order = np.argsort(gammas)
    cumulative = np.cumsum(chance.ravel()[order])
    return float(gammas[order][np.searchsorted(cumulative, rate * cumulative[-1])])


def _peak_error(above: Floats, peak: tuple[np.intp, ...], sizes: tuple[int, ...]) -> Floats:
    """Masses (sizes) of a Gaussian around cell 0, as wide as what is above half of the peak.

    An even ellipsoid of d dimensions has variance a^2 / (d + 2) along a half axis a, and a Gaussian falls to
    half at a^2 = 2 ln 2 sd^2. A cell's own 1 / 12 is added.
    """
    used = [k for k, size in enumerate(above.shape) if size > 1]
    if not used:
        return np.ones(sizes)
    off = np.argwhere(above >= 0.5 * above.max())[:, used] - np.array([peak[k] for k in used])
    spread = (len(used) + 2) / (2.0 * np.log(2.0)) * (off.T @ off) / len(off) + np.eye(len(used)) / 12.0
    steps = np.meshgrid(*(np.fft.fftfreq(size, 1.0 / size) for size in sizes), indexing="ij")
    away = np.stack([steps[k] for k in used], axis=-1)
    return np.asarray(np.exp(-0.5 * np.einsum("...k,kl,...l", away, np.linalg.inv(spread), away)))


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
    far = np.sum((points - toward) ** 2, axis=1)
    return int(np.argmin(np.where(weights >= epsilon * weights.max(), far, np.inf)))
