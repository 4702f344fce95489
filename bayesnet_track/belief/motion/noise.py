"""Gaussian noise of a box: drawing it and its density, for motion models and for latent nodes.

Noise has four coordinates: x and y in px, and the size either as w and h in px or, when `sd_log` is set, as
log sqrt(w h) and log(w / h). Under `sd_log` the pixel noise of the size is converted to these logarithms
(first order, their correlation dropped) and adds up in variance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce

import numpy as np

from bayesnet_track.graph.spec import Noise
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.density import log_gaussians

Coordinates = Callable[[Floats], tuple[Floats, Floats]]
States = Callable[[Floats, Floats], Floats]

LOG_SIZE_LIMIT = float(np.log(1.1))
"""Largest change of log w and of log h by `sd_log` in one frame interval."""


@dataclass(frozen=True, eq=False)
class Transition:
    """p(states | previous) for N old states: diagonal Gaussians, in coordinates in which they are diagonal.

    Attributes:
        coordinates: (M, D) states -> their (M, K) coordinates with noise, and the (M,) log-Jacobian from
            densities of the coordinates to densities of the states.
        means: (N, K) of the new state, in these coordinates.
        sds: (C, N, K) of each component.
        log_shares: (C,) log-weights of the components.
        states: the way back: (M, K) coordinates and the (M, D) states without noise, which give what has no
            noise -> (M, D) states. None where it is not known.
    """

    coordinates: Coordinates
    means: Floats
    sds: Floats
    log_shares: Floats
    states: States | None = None

    def log_density(self, states: Floats) -> Floats:
        """(M, N) log p(states_m | previous_n) of `states` (M, D)."""
        points, log_jacobian = self.coordinates(states)
        parts = [
            share + log_gaussians(points, self.means, sds)
            for share, sds in zip(self.log_shares, self.sds, strict=True)
        ]
        # Pair by pair: `reduce` over a list copies it, and takes twice as long.
        total = reduce(np.logaddexp, parts)
        return np.asarray(total + log_jacobian[:, None])


def sample_noise(noise: Noise, boxes: Floats, rng: np.random.Generator, dt: float = 1.0) -> Floats:
    """(N, 4) centre boxes with the noise of `dt` frame intervals added; widths and heights at least 1 px.

    Relative sds refer to the sizes before. The share of `noise.heavy_tail`, rounded to a whole number of
    boxes drawn at random, takes its position noise times the factor. Changes of size by `sd_log` are cut at
    10 % per frame interval.
    """
    noised = boxes.copy()
    add_noise(noise, noised, rng, dt)
    return noised


def add_noise(
    noise: Noise, boxes: Floats, rng: np.random.Generator, dt: float = 1.0, least_side: float = 1.0
) -> None:
    """Add noise as `sample_noise` draws it, in place."""
    keep = noisy(noise)
    if any(keep[:2]):
        # Imported here: a graph is validated without compiling anything.
        from bayesnet_track.numerics.kernels.box_kernels import scale_steps

        px, box, tail = noise.sd_px, noise.sd_box, noise.heavy_tail
        steps, wide, factor = rng.standard_normal((len(boxes), 2)), np.empty(0, np.int64), 1.0
        if tail is not None:
            wide = rng.permutation(len(boxes))[: round(tail.weight * len(boxes))]
            factor = tail.factor
        scale_steps(steps, boxes[:, 2] * boxes[:, 3], (px.x, px.y), (box.x, box.y), float(dt), wide, factor)
        boxes[:, :2] += steps
    if any(keep[2:]):
        steps = size_sd(noise, boxes, dt) * rng.standard_normal((len(boxes), 2))
        if is_log(noise):
            limit, half, change = LOG_SIZE_LIMIT * dt, steps[:, 1] / 2, np.empty_like(steps)
            np.add(steps[:, 0], half, out=change[:, 0])
            np.subtract(steps[:, 0], half, out=change[:, 1])
            boxes[:, 2:] *= np.exp(
                np.minimum(np.maximum(change, -limit), limit)
            )  # `clip` takes twice as long
        else:
            boxes[:, 2:] += steps
        np.maximum(boxes[:, 2:], least_side, out=boxes[:, 2:])


def log_noise_density(noise: Noise, boxes: Floats, previous: Floats, dt: float = 1.0) -> Floats:
    """(M, N) log-density of the `boxes` (M, 4) around each of `previous` (N, 4), per px^k.

    k is the number of coordinates with noise; the others are left out. The cuts at 10 % and at 1 px are not
    part of it: they lie far out in the tail of any noise that they are meant for.
    """
    return noise_transition(noise, previous, dt).log_density(boxes)


def noise_transition(noise: Noise, previous: Floats, dt: float = 1.0) -> Transition:
    """p(box | previous box) for `previous` (N, 4), as coordinates and diagonal Gaussians."""
    keep = noisy(noise)

    def coordinates(boxes: Floats) -> tuple[Floats, Floats]:
        points, log_jacobian = box_coordinates(noise, boxes)
        return points[:, keep], log_jacobian

    def states(points: Floats, still: Floats) -> Floats:
        full = box_coordinates(noise, still)[0]
        full[:, keep] = points
        return boxes_at(noise, full)

    variances = component_variances(noise, previous, dt)
    means, sds = coordinates(previous)[0], np.sqrt(variances[:, :, keep])
    return Transition(coordinates, means, sds, component_log_shares(noise), states)


def noisy(noise: Noise) -> list[bool]:
    """Coordinates of the four that have noise."""
    px, box, log = noise.sd_px, noise.sd_box, noise.sd_log
    if is_log(noise):
        sized = px.w > 0 or px.h > 0
        return [px.x + box.x > 0, px.y + box.y > 0, sized or log.scale > 0, sized or log.aspect > 0]
    return [px.x + box.x > 0, px.y + box.y > 0, px.w > 0, px.h > 0]


def is_log(noise: Noise) -> bool:
    """True when the size's noise is Gaussian in logarithms."""
    return noise.sd_log.scale > 0 or noise.sd_log.aspect > 0


def box_coordinates(noise: Noise, boxes: Floats) -> tuple[Floats, Floats]:
    """(M, 4) coordinates of boxes (M, 4), noisy or not, and the (M,) log-Jacobian of the noisy ones."""
    points = boxes.copy()
    if not is_log(noise):
        return points, np.zeros(len(boxes))
    log_w, log_h = np.log(boxes[:, 2]), np.log(boxes[:, 3])
    points[:, 2], points[:, 3] = (log_w + log_h) / 2, log_w - log_h
    # |d(log sqrt(w h), log(w / h)) / d(w, h)| = 1 / (w h): 1 / sqrt(w h) for each coordinate.
    return points, -sum(noisy(noise)[2:]) * points[:, 2]


def boxes_at(noise: Noise, points: Floats) -> Floats:
    """(M, 4) boxes of (M, 4) coordinates, the inverse of `box_coordinates`; sizes at least 1 px."""
    boxes = points.copy()
    if is_log(noise):
        half = points[:, 3] / 2
        boxes[:, 2], boxes[:, 3] = np.exp(points[:, 2] + half), np.exp(points[:, 2] - half)
    np.maximum(boxes[:, 2:], 1.0, out=boxes[:, 2:])
    return boxes


def component_variances(noise: Noise, boxes: Floats, dt: float) -> Floats:
    """(C, N, 4) variances of the coordinates around boxes (N, 4): C = 2 with `heavy_tail`, else 1."""
    tail = noise.heavy_tail
    variances = np.empty((1 if tail is None else 2, len(boxes), 4))
    variances[:, :, :2] = position_variance(noise, boxes, dt)
    for column, sd in zip((2, 3), size_sd(noise, boxes, dt).T, strict=True):
        variances[:, :, column] = sd**2
    if tail is not None:
        variances[1, :, :2] *= tail.factor**2
    return variances


def component_log_shares(noise: Noise) -> Floats:
    """(C,) log-weights of the components."""
    tail = noise.heavy_tail
    return np.zeros(1) if tail is None else np.log([1.0 - tail.weight, tail.weight])


def box_covariance(noise: Noise, w: float, h: float, dt: float) -> tuple[float, float, float, float, float]:
    """Variances of x, y, w, covariance of w and h, variance of h in px^2 over `dt`, around a box of w x h px.

    As `component_variances` of one box, `heavy_tail` by its total variance, log w and log h to first order.
    """
    px, box, log, tail = noise.sd_px, noise.sd_box, noise.sd_log, noise.heavy_tail
    wider = 1.0 if tail is None else 1.0 + tail.weight * (tail.factor**2 - 1.0)
    x, y = (
        wider * (dt * (px_sd * px_sd + box_sd * box_sd * (w * h)))
        for px_sd, box_sd in ((px.x, box.x), (px.y, box.y))
    )
    if not is_log(noise):
        return x, y, dt * px.w**2, 0.0, dt * px.h**2
    relative = (px.w / w) ** 2 + (px.h / h) ** 2
    # log w = s + a / 2 and log h = s - a / 2, of the noise's coordinates s and a.
    scale, quarter = dt * (log.scale**2 + relative / 4), dt * (log.aspect**2 + relative) / 4
    return x, y, w * w * (scale + quarter), w * h * (scale - quarter), h * h * (scale + quarter)


def position_variance(noise: Noise, boxes: Floats, dt: float) -> Floats:
    """(N, 2) variances of x and y in px^2 over `dt` frame intervals."""
    area, variances = boxes[:, 2] * boxes[:, 3], np.empty((len(boxes), 2))
    for axis, (px, box) in enumerate(((noise.sd_px.x, noise.sd_box.x), (noise.sd_px.y, noise.sd_box.y))):
        variances[:, axis] = dt * (px * px + box * box * area)
    return variances


def size_sd(noise: Noise, boxes: Floats, dt: float) -> Floats:
    """(N, 2) sds over `dt` of w and h in px, or of log sqrt(w h) and log(w / h) when `is_log`.

    (1, 2) where they are the same for all boxes.
    """
    px, log = noise.sd_px, noise.sd_log
    if not is_log(noise):
        return np.asarray(np.sqrt(dt) * np.array([[px.w, px.h]]))
    if px.w == 0 and px.h == 0:
        return np.asarray(np.sqrt(dt * np.array([[log.scale**2, log.aspect**2]])))
    relative = np.sum((np.array([px.w, px.h]) / boxes[:, 2:]) ** 2, axis=1)
    return np.asarray(np.sqrt(dt * np.stack([log.scale**2 + relative / 4, log.aspect**2 + relative], axis=1)))
