"""Messages of latent nodes held by samples: the integral over the latent state, by kernel or on a grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.motion.noise import box_coordinates, log_noise_density, noisy
from bayesnet_track.graph.spec import Noise
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.cue import Hypotheses

CELLS_PER_SD = 4.0
MAX_CELLS = 1 << 21
SPECTRAL_NOISE = 1e-13
"""Convolved values below this share of the largest are rounding errors."""


def kernel_message(
    given: Noise, above: Hypotheses, own: Hypotheses, prior_log: Floats, log_likelihood: Floats
) -> Floats:
    """(N,) log of the integral of p(c | h_i) L(c) over the latent state c, O(N^2).

    Each term is divided by the density of the samples c_j, q(c) = sum_k beta_k p(c | h_k), and every row is
    normalised: without the division the samples' density would act as a second prior. A coordinate without
    noise is the parent's own, so that only samples which agree in it count.
    """
    log_kernel = log_noise_density(given, own.boxes, above.boxes).T
    _keep_agreeing(log_kernel, given, above.boxes, own.boxes)
    return sum_kernel(log_kernel, prior_log, log_likelihood)


def sum_kernel(log_kernel: Floats, prior_log: Floats, log_likelihood: Floats) -> Floats:
    """(N,) the message of `kernel_message` by log p(c_j | h_i) (N, N), which is overwritten."""
    log_q = _log_sum(log_kernel + prior_log[:, None], axis=0)
    log_share = np.full(len(prior_log), -np.inf)
    np.subtract(prior_log, log_q, out=log_share, where=prior_log > -np.inf)
    log_kernel += log_share
    log_total = _log_sum(log_kernel, axis=1)
    integral = _log_sum(log_kernel + log_likelihood, axis=1)
    # A hypothesis of prior weight 0 may find no sample to integrate over: its own draw stands for it.
    message = log_likelihood.copy()
    np.subtract(integral, log_total, out=message, where=log_total > -np.inf)
    return message


def grid_message(
    given: Noise, above: Hypotheses, own: Hypotheses, prior_log: Floats, log_likelihood: Floats
) -> Floats:
    """`kernel_message` on a grid of cells over x and y, O(N + G log G) for G cells.

    For noise in x and y in px only, and parents of one size. The samples are shared between the four
    nearest cell centres, all sums over them are convolutions with the noise, and the message is interpolated
    between four cells; what this sharing adds to the variance is taken off the noise. Cells measure a quarter
    of an sd, and are coarser only where more than 2 million would be needed.
    """
    parts = [(1.0, 1.0)]
    if given.heavy_tail is not None:
        parts = [(1.0 - given.heavy_tail.weight, 1.0), (given.heavy_tail.weight, given.heavy_tail.factor)]
    sd = np.array([given.sd_px.x, given.sd_px.y])
    places = np.concatenate([above.boxes[:, :2], own.boxes[:, :2]]) / sd
    low, high = places.min(axis=0), places.max(axis=0)
    margin = 6.0 * parts[-1][1]  # the transform wraps round
    extent = high - low + margin
    cell = max(1.0 / CELLS_PER_SD, float(np.sqrt(np.prod(extent) / MAX_CELLS)))
    cells = np.ceil(extent / cell).astype(int) + 2
    transfer = _transfer(parts, cell, cells)

    parents = _share((above.boxes[:, :2] / sd - low) / cell)
    samples = _share((own.boxes[:, :2] / sd - low) / cell)
    beta = np.exp(prior_log)
    q = _read(_convolve(_collect(beta, parents, cells), transfer), samples)
    share = np.zeros(len(beta))
    np.divide(beta, q, out=share, where=q > SPECTRAL_NOISE * q.max())
    top = float(np.max(log_likelihood))
    if not np.isfinite(top):
        return log_likelihood.copy()
    total = _read(_convolve(_collect(share, samples, cells), transfer), parents)
    likelihood = np.exp(log_likelihood - top)
    integral = _read(_convolve(_collect(share * likelihood, samples, cells), transfer), parents)
    seen = total > SPECTRAL_NOISE * total.max()
    message = log_likelihood.copy()
    least = SPECTRAL_NOISE * max(float(integral.max()), np.finfo(float).tiny)
    message[seen] = top + np.log(np.maximum(integral[seen], least)) - np.log(total[seen])
    return message


Shares = tuple[NDArray[np.intp], Floats]


def _share(places: Floats) -> Shares:
    """(N, 4, 2) the four cells around each place, and (N, 4) their shares of it, bilinear."""
    first = np.floor(places).astype(np.intp)
    part = places - first
    corners = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
    weights = np.prod(np.where(corners == 1, part[:, None], 1.0 - part[:, None]), axis=2)
    return first[:, None] + corners, weights


def _collect(values: Floats, shares: Shares, cells: NDArray[np.intp]) -> Floats:
    """(cells) the values (N,), each shared between four cells."""
    at, weights = shares
    flat = at[..., 0] * cells[1] + at[..., 1]
    amounts = (values[:, None] * weights).ravel()
    return np.bincount(flat.ravel(), amounts, int(np.prod(cells))).reshape(tuple(cells))


def _read(grid: Floats, shares: Shares) -> Floats:
    """(N,) the grid at places, between four cells."""
    at, weights = shares
    return np.asarray(np.sum(grid[at[..., 0], at[..., 1]] * weights, axis=1))


def _transfer(parts: list[tuple[float, float]], cell: float, cells: NDArray[np.intp]) -> Floats:
    """The noise's Fourier transform on the grid: `parts` are its shares and sds, in units of the sd."""
    rows = 2.0 * np.pi * np.fft.fftfreq(cells[0])[:, None]
    columns = 2.0 * np.pi * np.fft.rfftfreq(cells[1])[None]
    square = rows**2 + columns**2
    taken = 1.0 / 3.0  # cells^2: collecting and reading are triangles of variance 1/6 each
    terms = [
        share * np.exp(-0.5 * max((factor / cell) ** 2 - taken, 0.0) * square) for share, factor in parts
    ]
    return np.asarray(np.sum(terms, axis=0))


def _convolve(grid: Floats, transfer: Floats) -> Floats:
    return np.asarray(np.fft.irfft2(np.fft.rfft2(grid) * transfer, s=grid.shape))


def _keep_agreeing(log_kernel: Floats, given: Noise, above: Floats, own: Floats) -> None:
    """Set (N, N) to -inf where the parent's box i and the sample j differ in a coordinate without noise."""
    parents, samples = box_coordinates(given, above)[0], box_coordinates(given, own)[0]
    for column, has_noise in enumerate(noisy(given)):
        values = parents[:, column]
        if not has_noise and np.ptp(values) > 0:
            away = np.abs(values[:, None] - samples[:, column])
            log_kernel[away > 1e-9 * (1.0 + np.abs(values[:, None]))] = -np.inf


def _log_sum(log: Floats, axis: int) -> Floats:
    """log of the sum of exp along an axis; -inf where every term is."""
    top = log.max(axis=axis, keepdims=True)
    with np.errstate(divide="ignore"):
        total = np.log(np.sum(np.exp(log - np.where(top > -np.inf, top, 0.0)), axis=axis, keepdims=True))
    return np.asarray(np.squeeze(total + top, axis=axis))
