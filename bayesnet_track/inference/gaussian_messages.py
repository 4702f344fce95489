"""Messages of nodes: Gaussian ones, and those of latent nodes held by samples, by kernel or on a grid.

Both are `Measurement`s, a likelihood of the parent's hypothesis with peak 1. Powers divide the covariance,
products add the inverse covariances (information form), noise in between adds to the covariance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import BOX_FIELDS
from bayesnet_track.belief.motion.formulas import derivative
from bayesnet_track.belief.motion.models import KinematicMotion
from bayesnet_track.belief.motion.noise import box_coordinates, log_noise_density, noisy
from bayesnet_track.graph.checked import Conditional
from bayesnet_track.graph.spec import Given, Noise
from bayesnet_track.inference.factors import linearise_given
from bayesnet_track.inference.parts import part_matrix
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.log_weights import DegenerateWeights, LogWeights
from bayesnet_track.observation.cue import Hypotheses, Measurement, floored

KNOWN = 1e-6
"""Least precision of a direction, in units of the prior's own, that counts as information."""

FAR = 1e140
"""Distances in sds are cut here, so that their squares stay finite."""


def measurement_message(measured: Measurement, hypotheses: Hypotheses) -> Floats:
    """(N,) log-likelihood -d^2 / 2 of a Gaussian message, mixed with its floor; of choices, their mixture."""
    if measured.choices:
        each = (
            weight * np.exp(measurement_message(choice, hypotheses)) for weight, choice in measured.choices
        )
        with np.errstate(divide="ignore"):
            return np.asarray(np.minimum(np.log(measured.missed + sum(each)), 0.0))
    log = _place_message(measured, hypotheses)
    return log if measured.label is None else log + measured.label.of(hypotheses.fields)


def _place_message(measured: Measurement, hypotheses: Hypotheses) -> Floats:
    if measured.errors is not None:
        return measured.log_by_errors(_states(hypotheses))
    if measured.seen is None:
        errors = _values(hypotheses, measured.fields) - measured.mean
    else:
        errors = measured.seen.less(measured.seen.function(_states(hypotheses)), measured.mean)
    log = _log_of(errors, measured)
    return floored(log, measured.floor) if measured.floor > 0 else log


def _states(hypotheses: Hypotheses) -> dict[str, Floats]:
    return {**dict(zip(BOX_FIELDS, hypotheses.boxes.T, strict=True)), **hypotheses.fields}


def _log_of(errors: Floats, measured: Measurement) -> Floats:
    """(N,) -d^2 / 2 of errors (N, K) of a measurement."""
    if measured.variances is not None:
        # Imported here: a graph is validated without compiling anything.
        from bayesnet_track.numerics.compiled import plain
        from bayesnet_track.numerics.gaussian import independent_log

        log = np.empty(len(errors))
        independent_log(plain(errors), np.array(measured.variances), FAR * FAR, log)
        return log
    with np.errstate(over="ignore", invalid="ignore"):
        sds = np.linalg.solve(np.linalg.cholesky(measured.covariance), errors.T)
        sds *= sds
        log = np.asarray(-0.5 * sds.sum(axis=0))
    if not math.isfinite(log.min(initial=0.0)):  # also where one is NaN
        squares = np.nan_to_num(np.clip(sds, 0.0, FAR * FAR), nan=FAR * FAR)
        log = np.asarray(-0.5 * np.sum(squares, axis=0))
    return log


def to_power(measured: Measurement, power: float) -> Measurement:
    """The message raised to a power: its covariance is divided by it."""
    if power == 1.0:
        return measured
    function = measured.seen
    if function is not None and (covariance := function.covariance) is not None:
        function = replace(function, covariance=lambda expected: covariance(expected) / power)
    return replace(
        measured,
        covariance=measured.covariance / power,
        seen=function,
        errors=None if (errors := measured.errors) is None else replace(errors, power=errors.power * power),
        log_peak=None if measured.log_peak is None else measured.log_peak * power,
        floor=measured.floor**power,
        choices=tuple((weight, to_power(choice, power)) for weight, choice in measured.choices),
        label=None if measured.label is None else measured.label.to_power(power),
    )


def latent_gaussian(
    given: Given | Conditional,
    parents: Hypotheses,
    draws: Hypotheses,
    prior_log: Floats,
    gaussians: Mapping[str, tuple[Measurement, float]],
    sampled: Floats | None,
) -> Measurement | None:
    """Message of a latent node with a Gaussian belief to its parent; None when it says nothing.

    Its evidence about its own state c is a Gaussian: the `gaussians` (each with its power) exactly, and the
    (N,) log-likelihood `sampled` at the draws c_j by its moments, posterior over prior: precision
    P1^-1 - P0^-1, kept positive, and P1^-1 m1 - P0^-1 m0. Noise `given`, taken at the parent's mean box,
    widens it: integral of N(c; h, Q) N(c; m, R) dc = N(h; m, R + Q). O(N).

    The state c of a part, drawn around A h, is taken as the parent's box that it implies, A^-1 c, with noise
    A^-1 Q A^-T; an agent that measures fields of c measures rows of A times that box.

    Where expressions say `given`, it is linearised at the parent's mean box, and the Gaussian of c is brought
    to h by the slopes, in information form: what does not depend on h says nothing of it.

    Posterior moments are no finer than N draws lie, sd N^(-1/k) of the prior's in k directions.
    """
    beta = np.exp(prior_log)
    matrix = None if isinstance(given, Conditional) else part_matrix(given)
    boxes: Floats = draws.boxes if matrix is None else np.asarray(np.linalg.solve(matrix, draws.boxes.T).T)
    centre = beta @ boxes
    deviations = boxes - centre
    variance, axes = np.linalg.eigh((deviations * beta[:, None]).T @ deviations)
    varies = variance > 1e-12 * max(float(variance[-1]), 1e-12)
    if not varies.any():
        return None
    # c = centre + shape u, with u of mean 0 and covariance 1 under the prior.
    shape, unshape = axes[:, varies] * np.sqrt(variance[varies]), axes[:, varies] / np.sqrt(variance[varies])
    precision, shift = _match(deviations @ unshape, prior_log, sampled)
    for message, power in gaussians.values():
        looks, place = (shape, centre) if matrix is None else (matrix @ shape, matrix @ centre)
        slopes, innovation, covariance = _linear(message, place)
        weighted = np.linalg.solve(covariance / power, slopes @ looks)
        precision = precision + (slopes @ looks).T @ weighted
        shift = shift + weighted.T @ innovation
    floor = 0.0
    if sampled is None:  # what remains far from all of them
        floor = float(np.prod([message.floor**power for message, power in gaussians.values()]))
    directions = _Directions(centre, shape, unshape)
    if isinstance(given, Conditional):
        return _by_slopes(given, parents, beta, directions, (precision, shift), floor)
    return _in_fields(given, beta @ parents.boxes, directions, precision, shift, floor)


def _linear(message: Measurement, box: Floats) -> tuple[Floats, Floats, Floats]:
    """A measurement of a box near `box` (4,): slopes (K, 4), innovation (K,) there, covariance (K, K).

    Of functions of the state by their derivatives; what has no value there, and what is no field of a box,
    is left out.
    """
    if message.seen is None:
        columns = [k for k, name in enumerate(message.fields) if name in BOX_FIELDS]
        slopes = np.eye(4)[[BOX_FIELDS.index(message.fields[k]) for k in columns]].reshape(len(columns), 4)
        return slopes, message.mean[columns] - slopes @ box, message.covariance[np.ix_(columns, columns)]
    quantities = message.seen

    def of(boxes: Floats) -> Floats:
        return quantities.function(dict(zip(BOX_FIELDS, boxes.T, strict=True)))

    expected = of(box[None])[0]
    slopes = derivative(lambda boxes: expected + quantities.less(of(boxes), expected), box)
    defined = np.flatnonzero(np.isfinite(expected) & np.isfinite(slopes).all(axis=1))
    innovation = quantities.less(message.mean, expected)
    return slopes[defined], innovation[defined], message.covariance[np.ix_(defined, defined)]


@dataclass(frozen=True, eq=False)
class _Directions:
    """Coordinates u of a box c in which draws have the mean 0 and the covariance 1: c = centre + shape u.

    Attributes:
        centre: (4,) mean of the draws.
        shape: (4, K) with the K directions in which they spread.
        unshape: (4, K) with u = unshape' (c - centre).
    """

    centre: Floats
    shape: Floats
    unshape: Floats


def _match(places: Floats, prior_log: Floats, sampled: Floats | None) -> tuple[Floats, Floats]:
    """Precision (K, K) and precision times mean (K,) of a likelihood at `places`, whose prior is N(0, 1)."""
    n, k = places.shape
    nothing = np.zeros((k, k)), np.zeros(k)
    if sampled is None:
        return nothing
    try:
        weights = LogWeights.normalise(prior_log + sampled)[0].weights
    except DegenerateWeights:
        return nothing
    mean = weights @ places
    deviations = places - mean
    spread, axes = np.linalg.eigh((deviations * weights[:, None]).T @ deviations)
    spread = np.maximum(spread, float(n) ** (-2.0 / k))
    gained = 1.0 / spread - 1.0
    informed = gained > KNOWN
    pull = np.where(informed, (mean @ axes) / spread, 0.0)
    return (axes * np.where(informed, gained, 0.0)) @ axes.T, axes @ pull


def _in_fields(
    given: Given,
    parent: Floats,
    directions: _Directions,
    precision: Floats,
    shift: Floats,
    floor: float,
) -> Measurement | None:
    """The Gaussian in u as one over the fields of a box that it says something of, widened by `given`."""
    centre, shape, unshape = directions.centre, directions.shape, directions.unshape
    precisions, axes = np.linalg.eigh(precision)
    usable = precisions > KNOWN
    mean = centre + shape @ (axes[:, usable] @ ((axes[:, usable].T @ shift) / precisions[usable]))
    sd = np.sqrt(np.sum(shape**2, axis=1))
    scaled = (unshape @ precision @ unshape.T) * np.outer(sd, sd)
    fields = [k for k in range(len(BOX_FIELDS)) if scaled[k, k] > KNOWN]
    if not fields:
        return None
    eigenvalues, turn = np.linalg.eigh(scaled[np.ix_(fields, fields)])
    covariance = (turn / np.maximum(eigenvalues, KNOWN)) @ turn.T * np.outer(sd[fields], sd[fields])
    covariance = covariance + _noise(given, parent)[np.ix_(fields, fields)]
    return Measurement(
        tuple(BOX_FIELDS[k] for k in fields), mean[fields], (covariance + covariance.T) / 2, floor
    )


def _by_slopes(
    conditional: Conditional,
    parents: Hypotheses,
    beta: Floats,
    directions: _Directions,
    form: tuple[Floats, Floats],
    floor: float,
) -> Measurement | None:
    """The Gaussian in u, its precision and shift `form`, over the fields of the parent that it depends on.

    Of the N `parents`, with weights `beta` (N,), the fields that vary. Directions that it does not tell apart
    have 1e6 times the parent's variance.
    """
    precision, shift = form
    added = tuple(name for name in parents.fields if name in conditional.reads)
    names = (*BOX_FIELDS, *added)
    states = _values(parents, names)
    parent = beta @ states
    sd = np.sqrt(beta @ (states - parent) ** 2)
    box, slopes, noise = linearise_given(conditional, parent, added)
    unshape = directions.unshape
    looks = unshape.T @ slopes * sd  # u = looks (h - parent) / sd + start + noise
    start = unshape.T @ (box - directions.centre)
    wider = np.linalg.inv(np.eye(len(shift)) + precision @ (unshape.T @ noise @ unshape))
    information = looks.T @ wider @ precision @ looks
    pull = looks.T @ wider @ (shift - precision @ start)
    fields = [k for k in range(len(names)) if information[k, k] > KNOWN]
    if not fields:
        return None
    own_part, turn = np.linalg.eigh((information + information.T)[np.ix_(fields, fields)] / 2)
    usable = own_part > KNOWN
    offset = turn[:, usable] @ ((turn[:, usable].T @ pull[fields]) / own_part[usable])
    covariance = (turn / np.maximum(own_part, KNOWN)) @ turn.T * np.outer(sd[fields], sd[fields])
    mean = parent[fields] + sd[fields] * offset
    return Measurement(tuple(names[k] for k in fields), mean, (covariance + covariance.T) / 2, floor)


def _noise(given: Given, parent: Floats) -> Floats:
    """(4, 4) covariance of `given` at the parent's box (4,), in the parent's coordinates."""
    matrix = part_matrix(given)
    box = parent if matrix is None else matrix @ parent
    noise = KinematicMotion(given, ((0.0,),)).linearise(box, 1.0)[1]
    if matrix is None:
        return noise
    back = np.linalg.inv(matrix)
    return np.asarray(back @ noise @ back.T)


def _values(hypotheses: Hypotheses, names: tuple[str, ...]) -> Floats:
    """(N, K) fields of hypotheses."""
    if names == BOX_FIELDS[: len(names)]:
        return hypotheses.boxes[:, : len(names)]
    return np.stack([_field(hypotheses, name) for name in names], axis=1)


def _field(hypotheses: Hypotheses, name: str) -> Floats:
    """(N,) a field of hypotheses: of their boxes, or a further one."""
    if name in BOX_FIELDS:
        return hypotheses.boxes[:, BOX_FIELDS.index(name)]
    return hypotheses.fields[name]


CELLS_PER_SD = 4.0
MAX_CELLS = 1 << 21
SPECTRAL_NOISE = 1e-13
"""Convolved values below this share of the largest are rounding errors."""


def kernel_message(
    given: Noise, parents: Hypotheses, draws: Hypotheses, prior_log: Floats, log_likelihood: Floats
) -> Floats:
    """(N,) log of the integral of p(c | h_i) L(c) over the latent state c, O(N^2).

    Each term is divided by the density of the samples c_j, q(c) = sum_k beta_k p(c | h_k), and every row is
    normalised: without the division the samples' density would act as a second prior. A coordinate without
    noise is the parent's own, so that only samples which agree in it count.
    """
    log_kernel = log_noise_density(given, draws.boxes, parents.boxes).T
    _keep_agreeing(log_kernel, given, parents.boxes, draws.boxes)
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
    given: Noise, parent_hypotheses: Hypotheses, draws: Hypotheses, prior_log: Floats, log_likelihood: Floats
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
    places = np.concatenate([parent_hypotheses.boxes[:, :2], draws.boxes[:, :2]]) / sd
    low, high = places.min(axis=0), places.max(axis=0)
    margin = 6.0 * parts[-1][1]  # the transform wraps round
    extent = high - low + margin
    cell = max(1.0 / CELLS_PER_SD, float(np.sqrt(np.prod(extent) / MAX_CELLS)))
    cells = np.ceil(extent / cell).astype(int) + 2
    transfer = _transfer(parts, cell, cells)

    parents = _share((parent_hypotheses.boxes[:, :2] / sd - low) / cell)
    samples = _share((draws.boxes[:, :2] / sd - low) / cell)
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
    is_reached = total > SPECTRAL_NOISE * total.max()
    message = log_likelihood.copy()
    floor = SPECTRAL_NOISE * max(float(integral.max()), np.finfo(float).tiny)
    message[is_reached] = top + np.log(np.maximum(integral[is_reached], floor)) - np.log(total[is_reached])
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
    indices, weights = shares
    flat = indices[..., 0] * cells[1] + indices[..., 1]
    amounts = (values[:, None] * weights).ravel()
    return np.bincount(flat.ravel(), amounts, int(np.prod(cells))).reshape(tuple(cells))


def _read(grid: Floats, shares: Shares) -> Floats:
    """(N,) the grid at places, between four cells."""
    indices, weights = shares
    return np.asarray(np.sum(grid[indices[..., 0], indices[..., 1]] * weights, axis=1))


def _transfer(parts: list[tuple[float, float]], cell: float, cells: NDArray[np.intp]) -> Floats:
    """The noise's Fourier transform on the grid: `parts` are its shares and sds, in units of the sd."""
    rows = 2.0 * np.pi * np.fft.fftfreq(cells[0])[:, None]
    columns = 2.0 * np.pi * np.fft.rfftfreq(cells[1])[None]
    square = rows**2 + columns**2
    sharing = 1.0 / 3.0  # cells^2: collecting and reading are triangles of variance 1/6 each
    terms = [
        share * np.exp(-0.5 * max((factor / cell) ** 2 - sharing, 0.0) * square) for share, factor in parts
    ]
    return np.asarray(np.sum(terms, axis=0))


def _convolve(grid: Floats, transfer: Floats) -> Floats:
    return np.asarray(np.fft.irfft2(np.fft.rfft2(grid) * transfer, s=grid.shape))


def _keep_agreeing(log_kernel: Floats, given: Noise, parent_boxes: Floats, sample_boxes: Floats) -> None:
    """Set (N, N) to -inf where the parent's box i and the sample j differ in a coordinate without noise."""
    parents, samples = box_coordinates(given, parent_boxes)[0], box_coordinates(given, sample_boxes)[0]
    for column, has_noise in enumerate(noisy(given)):
        values = parents[:, column]
        if not has_noise and np.ptp(values) > 0:
            differences = np.abs(values[:, None] - samples[:, column])
            log_kernel[differences > 1e-9 * (1.0 + np.abs(values[:, None]))] = -np.inf


def _log_sum(log: Floats, axis: int) -> Floats:
    """log of the sum of exp along an axis; -inf where every term is."""
    top = log.max(axis=axis, keepdims=True)
    with np.errstate(divide="ignore"):
        total = np.log(np.sum(np.exp(log - np.where(top > -np.inf, top, 0.0)), axis=axis, keepdims=True))
    return np.asarray(np.squeeze(total + top, axis=axis))
