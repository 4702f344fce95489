"""Log-evidence of measured boxes under a motion, by a Kalman filter or one per regime that interact.

In the coordinates of the motion's noise (x, y, and the size in px or in logarithms) kinematic motion is
linear and Gaussian, so that the evidence of boxes with Gaussian errors has a closed form. `sd_box` is taken
at the last box that was measured. Each mode is a regime, and so is a heavy tail, which is drawn anew in every
frame. Every regime before is followed by every regime now, and those with the same regime now are merged by
moments after the measurement (generalised pseudo-Bayes of second order, Bar-Shalom and Li 1993): exact for
one regime. Merging before it, as `belief.gaussian.modal` does, costs less and is less exact.

Many settings are evaluated at once: every array has them on its first axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.motion.models import KinematicMotion, steps
from bayesnet_track.belief.motion.modes import Modes
from bayesnet_track.belief.motion.noise import (
    box_coordinates,
    component_log_shares,
    component_variances,
    is_log,
    noisy,
)
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.gaussian import symmetric


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A motion that may explain the boxes.

    Attributes:
        motions: of each mode; the only one where there are no modes.
        modes: how modes follow each other, or None.
        error_sd: sd of a box's centre (px) and of its sides (px, or as a share of them where the motion's
            noise of the size is in logarithms).
    """

    motions: tuple[KinematicMotion, ...]
    modes: Modes | None
    error_sd: tuple[float, float]


def log_evidence(boxes: Floats, hypotheses: Sequence[Hypothesis]) -> Floats:
    """(B,) log p(boxes | hypothesis) of each of B, given the first box.

    Args:
        boxes: (T, 4) centre boxes, NaN where none was measured; the first one is.
        hypotheses: B, of motions with the same fields and the same noisy coordinates.
    """
    first = hypotheses[0].motions[0]
    columns = noisy_columns(first)
    points = np.full((len(boxes), len(columns)), np.nan)
    measured: NDArray[np.bool_] = np.asarray(np.isfinite(boxes).all(axis=1))
    points[measured] = box_coordinates(first.noise, boxes[measured])[0][:, columns]
    tables = [_tables(hypothesis, _carried(boxes, measured), columns) for hypothesis in hypotheses]
    moves, driven, added, chains, begin = (np.array(part) for part in zip(*tables, strict=True))
    errors = np.array([_error_variances(hypothesis, columns) for hypothesis in hypotheses])
    return _filter(points, measured, _Regimes(moves, driven, added, chains, begin), errors, _start_sds(first))


def noisy_columns(motion: KinematicMotion) -> list[int]:
    """Coordinates of the box that the motion moves: x and y where they have any noise, the size likewise."""
    x, y, w, h = noisy(motion.noise)
    driven = motion.diffusion != 0 or motion.order > 1
    return [k for k, moves in enumerate((x or driven, y or driven, w, h)) if moves]


@dataclass(frozen=True, eq=False)
class _Regimes:
    """K regimes of B hypotheses: moves and driven (B, K, D, D), added (B, K, T, C), chains, begin (B, K)."""

    moves: Floats
    driven: Floats
    added: Floats
    chains: Floats
    begin: Floats


def _tables(
    hypothesis: Hypothesis, boxes: Floats, columns: list[int]
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    moves, driven, added, shares, of_mode = [], [], [], [], []
    for mode, motion in enumerate(hypothesis.motions):
        move, noise = _kinematics(motion, columns)
        parts = component_variances(motion.noise, boxes, 1.0)[:, :, columns]
        for share, variances in zip(np.exp(component_log_shares(motion.noise)), parts, strict=True):
            moves.append(move)
            driven.append(noise)
            added.append(variances)
            shares.append(share)
            of_mode.append(mode)
    chain = np.ones((1, 1)) if hypothesis.modes is None else hypothesis.modes.chain.over(1.0)
    begin = np.ones(1) if hypothesis.modes is None else hypothesis.modes.start()
    tail_shares = np.array(shares)
    return (
        np.array(moves),
        np.array(driven),
        np.array(added),
        chain[np.ix_(of_mode, of_mode)] * tail_shares,
        begin[of_mode] * tail_shares,
    )


def _kinematics(motion: KinematicMotion, columns: list[int]) -> tuple[Floats, Floats]:
    """F and its noise, (D, D), of the chosen coordinates, then the derivatives of x and y."""
    move, covariance = steps(motion.dynamics, motion.diffusion, 1.0)
    size = len(columns) + 2 * (motion.order - 1)
    identity, noise = np.eye(size), np.zeros((size, size))
    for axis in (0, 1):
        if axis in columns:
            chain = [columns.index(axis), *range(len(columns) + axis, size, 2)]
            identity[np.ix_(chain, chain)] = move
            noise[np.ix_(chain, chain)] = covariance
    return identity, noise


def _error_variances(hypothesis: Hypothesis, columns: list[int]) -> Floats:
    """(C,) variances of the measured coordinates."""
    place, side = hypothesis.error_sd
    size = (side**2 / 2, 2 * side**2) if is_log(hypothesis.motions[0].noise) else (side**2, side**2)
    return np.array([place**2, place**2, *size])[columns]


def _start_sds(motion: KinematicMotion) -> Floats:
    return np.repeat(motion.start_sd, 2)


def _carried(boxes: Floats, measured: NDArray[np.bool_]) -> Floats:
    """(T, 4) the last box measured in each frame."""
    latest = np.maximum.accumulate(np.where(measured, np.arange(len(boxes)), 0))
    return np.asarray(boxes[latest])


def _filter(
    points: Floats, observed: NDArray[np.bool_], regimes: _Regimes, errors: Floats, start_sds: Floats
) -> Floats:
    batch, count, size, _ = regimes.moves.shape
    width = points.shape[1]
    measured, behind = np.arange(width), np.arange(width, size)
    mean = np.zeros((batch, count, size))
    mean[..., :width] = points[0]
    covariance = np.zeros((batch, count, size, size))
    covariance[..., measured, measured] = errors[:, None]
    covariance[..., behind, behind] = start_sds**2
    weights, total = regimes.begin, np.zeros(batch)
    moves, turned = regimes.moves[:, None], regimes.moves[:, None].swapaxes(-1, -2)
    driven, errors = regimes.driven[:, None], errors[:, None, None]
    for t in range(1, len(points)):
        # Axes: hypothesis, regime before, regime now.
        means = (moves @ mean[:, :, None, :, None])[..., 0]
        spreads = moves @ covariance[:, :, None] @ turned + driven
        spreads[..., measured, measured] += regimes.added[:, None, :, t - 1]
        log = _log(regimes.chains * weights[:, :, None])
        if observed[t]:
            means, spreads, log_densities = _update(means, spreads, points[t], errors)
            log = log + log_densities
        top = log.max(axis=(1, 2))
        total = total + top + np.log(np.exp(log - top[:, None, None]).sum(axis=(1, 2)))
        weights, mean, covariance = _merge(means, spreads, log - top[:, None, None])
    return np.asarray(total)


def _update(means: Floats, spreads: Floats, point: Floats, errors: Floats) -> tuple[Floats, Floats, Floats]:
    """The Gaussians after a point (C,) was measured, and its log density under each."""
    width = len(point)
    measured = np.arange(width)
    expected = spreads[..., :width, :width].copy()
    expected[..., measured, measured] += errors
    innovation = point - means[..., :width]
    projected = spreads[..., :width]
    gain = projected @ np.linalg.inv(expected)
    change = (gain @ innovation[..., None])[..., 0]
    # R S^-1 e = e - H K e, so that d2 = e' S^-1 e needs no second solution.
    d2 = (innovation * (innovation - change[..., :width]) / errors).sum(axis=-1)
    log = -0.5 * (d2 + np.linalg.slogdet(expected)[1] + width * np.log(2 * np.pi))
    updated = spreads - gain @ projected.swapaxes(-1, -2)
    # Without this, a rounding error in one half of the matrix alone would double in every frame.
    return means + change, symmetric(updated), log


def _merge(means: Floats, spreads: Floats, log: Floats) -> tuple[Floats, Floats, Floats]:
    """Weight and Gaussian of each regime now: those of all regimes before, moments matched."""
    top = log.max(axis=1, keepdims=True)
    shares = np.exp(log - np.where(np.isfinite(top), top, 0.0))
    summed = shares.sum(axis=1)
    weights = summed * np.exp(top[:, 0])
    weights = weights / weights.sum(axis=1, keepdims=True)
    if log.shape[1] == 1:
        return weights, means[:, 0], spreads[:, 0]
    shares = np.where(
        summed[:, None] > 0, shares / np.where(summed > 0, summed, 1.0)[:, None], 1.0 / log.shape[1]
    )
    mean = (shares[..., None] * means).sum(axis=1)
    deviations = means - mean[:, None]
    covariance = (
        shares[..., None, None] * (spreads + deviations[..., :, None] * deviations[..., None, :])
    ).sum(axis=1)
    return weights, mean, covariance


def _log(values: Floats) -> Floats:
    with np.errstate(divide="ignore"):
        return np.log(values)


RIGHT = 0.8, 1.25
"""A ratio of innovations to their covariance between these is right, also where its interval excludes 1."""


@dataclass(frozen=True)
class NoiseRatio:
    """Normalised innovations squared per degree of freedom: 1 where prediction and noise are right.

    Attributes:
        ratio: of all frames.
        low: lower bound of its 95 % interval.
        high: upper bound.
        correlation: by how much the sum varies more than that of independent innovations.
        noise: share that the detections' noise has of the expected innovations.
    """

    ratio: float
    low: float
    high: float
    correlation: float
    noise: float

    @classmethod
    def estimate(cls, nis: Floats, dof: Floats, noise: Floats) -> NoiseRatio:
        """Ratio of frames (N,) in order, by sums over blocks of them.

        The sum of independent ones is a chi-square of as many degrees nu. It varies by c times as much where
        the sums of blocks do, c >= 1; as a chi-square of nu / c degrees, scaled, is it taken.
        """
        from scipy.special import gammaincinv

        blocks = _blocks_of(len(nis))
        count, total = int(blocks[-1]) + 1, float(dof.sum())
        ratio = float(nis.sum()) / total
        excess = np.bincount(blocks, nis - ratio * dof)
        variance = count / (count - 1) * float(excess @ excess) / total**2
        correlation = max(1.0, variance / (2.0 * ratio**2 / total))
        degrees = total / correlation
        high, low = (degrees / (2.0 * gammaincinv(degrees / 2.0, tail)) for tail in (0.025, 0.975))
        return cls(ratio, ratio * low, ratio * high, correlation, float(noise.sum()) / total)

    @property
    def is_right(self) -> bool:
        """True if the interval holds 1, or the ratio is close to it."""
        return self.low <= 1.0 <= self.high or RIGHT[0] <= self.ratio <= RIGHT[1]

    def factor_of(self, share: float) -> float:
        """Factor of an sd that has this share of the expected innovations, for a ratio of about 1.

        Where it is too large, the uncertainty of the prediction grew with it: all of S scales. Where it is
        too small, the other part stays as it is.
        """
        scale = self.ratio if self.ratio < 1.0 else 1.0 + (self.ratio - 1.0) / max(share, 0.05)
        return float(scale**0.5)

    def describe(self) -> str:
        """The ratio with its interval, and the verdict."""
        verdict = (
            "as stated" if self.is_right else f"{'larger' if self.ratio > 1.0 else 'smaller'} than stated"
        )
        return f"{self.ratio:.2f} [{self.low:.2f}, {self.high:.2f}] ({verdict})"


def _blocks_of(count: int) -> NDArray[np.int64]:
    """(N,) the block of each of N frames: thirty at most, of ten frames at least."""
    limit = max(2, min(30, count // 10))
    return np.minimum(np.arange(count) * limit // max(count, 1), limit - 1)


@dataclass(frozen=True, eq=False)
class MeanInnovation:
    """Mean innovation of places in a camera over a run.

    Attributes:
        px: (2,) the mean of x and y, weighted by information.
        sd: (2,) its standard errors, by blocks of frames.
        memory: the larger correlation of x or y in a frame with that in the next.
        squared: (N,) by how much the mean raises the normalised innovations squared of each frame.
    """

    px: Floats
    sd: Floats
    memory: float
    squared: Floats

    @classmethod
    def estimate(cls, innovations: Floats, information: Floats) -> MeanInnovation:
        """Mean of innovations (N, 2) in px of frames in order, with their information (N, 2, 2), px^-2."""
        inverse = np.linalg.inv(information.sum(axis=0))
        mean = inverse @ np.einsum("nij,nj->i", information, innovations)
        blocks, offsets = _blocks_of(len(innovations)), innovations - mean
        count = int(blocks[-1]) + 1
        excess = np.zeros((count, 2))
        np.add.at(excess, blocks, np.einsum("nij,nj->ni", information, offsets))
        spread = count / (count - 1) * inverse @ (excess.T @ excess) @ inverse
        is_there = information[:, 0, 0] > 0.0
        follows = is_there[1:] & is_there[:-1]
        products = (offsets[1:] * offsets[:-1])[follows].sum(axis=0) / max(int(follows.sum()), 1)
        memory = float((products / np.maximum((offsets[is_there] ** 2).mean(axis=0), 1e-12)).max())
        squared = np.einsum("i,nij,nj->n", mean, information, 2.0 * innovations - mean)
        return cls(mean, np.sqrt(np.diag(spread)), memory, squared)


CORRELATED = 0.3
"""In drawn rooms, whose detections have white noise, mean innovations are correlated by .2 at most."""
CORRELATED_TEXT = (
    "; errors last, with a correlation of {:.2f} from one step to the next: targets follow them, so that the "
    "ratios are too small, and less noise would make ellipses too small"
)


@dataclass(frozen=True)
class CameraCheck:
    """Innovations of a camera over a run: detections less where targets were expected.

    Attributes:
        camera: its name.
        detections: expected number of them that are of targets.
        targets: targets that were expected in its image, over all frames.
        missed: share that it has of the misses of all cameras.
        x_px, y_px: mean innovation to the right and down, px; what is left of a bias.
        x_sd, y_sd: their standard errors, by blocks of frames.
        place: x and y, less their means.
        size: w and h.
        memory: the larger correlation of mean innovations, x or y, from one step to the next.
        settings: what to try.
    """

    camera: str
    detections: float
    targets: float
    missed: float
    x_px: float
    x_sd: float
    y_px: float
    y_sd: float
    place: NoiseRatio
    size: NoiseRatio
    memory: float
    settings: tuple[str, ...] = ()

    def describe(self) -> str:
        """All of it in a line."""
        share = 1.0 - self.detections / max(self.targets, 1e-9)
        return (
            f"camera {self.camera}: innovations squared per degree of freedom: places "
            f"{self.place.describe()}, sizes {self.size.describe()}; bias left {self.x_px:+.2f} ± "
            f"{self.x_sd:.2f} px across, {self.y_px:+.2f} ± {self.y_sd:.2f} px down; {share:.0%} of targets "
            f"in its image had no detection, {self.missed:.0%} of the misses of all cameras"
            + (CORRELATED_TEXT.format(self.memory) if self.memory > CORRELATED else "")
        )
