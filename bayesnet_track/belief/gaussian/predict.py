"""Prediction of a Gaussian belief by a motion model: Kalman, extended and unscented."""

from __future__ import annotations

import numpy as np

from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.belief.motion.borders import Reflecting
from bayesnet_track.belief.motion.bounds import Confined
from bayesnet_track.belief.motion.functions import FunctionMotion
from bayesnet_track.belief.motion.models import KinematicMotion, linear_gaussian
from bayesnet_track.belief.motion.nested import Nested
from bayesnet_track.graph import spec
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.gaussian import root, sigma_points, symmetric
from bayesnet_track.observation.shared import for_reading


def predict(
    mean: Floats, covariance: Floats, motion: MotionModel, dt: float, settings: spec.Gaussian
) -> tuple[Floats, Floats]:
    """Mean (D,) and covariance (D, D) after `dt` frame intervals.

    - `kalman`, `extended`: m = f(m), P = F P F' + Q, with F and Q of `motion.linearise` at m. Of a
      linear motion both are exact.
    - `unscented`: the moments of f at the sigma points (tracking chapter 3.10, first paragraph: what it
      describes there is this transform), plus Q at the mean.

    Of a motion that is confined to an image, the predicted mean is confined, and the spread of each field of
    the box is at most that of a target which may be anywhere in the image.
    """
    # Imported here: a graph is validated without compiling anything.
    from bayesnet_track.numerics.compiled import plain
    from bayesnet_track.numerics.gaussian import carry

    free = motion.motion if isinstance(motion, Confined) else motion
    transition, noise = free.linearise(mean, dt)
    if settings.filter == "unscented":
        mean, spread = unscented_moments(mean, covariance, free, dt, settings.sigma)
        covariance = symmetric(spread + noise)
    else:
        moved, spread = np.empty(len(mean)), np.empty((len(mean), len(mean)))
        carry(for_reading(transition), plain(noise), plain(mean), plain(covariance), moved, spread)
        mean = moved if isinstance(free, KinematicMotion) else free.drift(mean[None], dt)[0]
        covariance = spread
    return motion.confine_moments(mean, covariance) if isinstance(motion, Confined) else (mean, covariance)


def unscented_moments(
    mean: Floats, covariance: Floats, motion: MotionModel, dt: float, sigma: spec.Unscented
) -> tuple[Floats, Floats]:
    """Mean and covariance of f(x), x of the moments given, by the scaled unscented transform.

    The points span the directions in which x varies. Sums are taken about the central point: of small
    alpha its weight is a large negative number. Where a negative weight would leave a negative variance, the
    covariance is that about the central point (Julier and Uhlmann's form), which is never negative.
    """
    lower = root(covariance)
    width = lower.shape[1]
    if width == 0:
        return motion.drift(mean[None], dt)[0], np.zeros_like(covariance)
    scale, weights, central = unscented_weights(width, sigma)
    points = motion.drift(mean + sigma_points(width, scale) @ lower.T, dt)
    away = points - points[0]
    shift = weights @ away
    about_centre = (away * weights[:, None]).T @ away  # the central point's own weight falls out
    spread = about_centre + (central - 1.0) * np.outer(shift, shift)
    return points[0] + shift, spread if _is_positive(spread) else about_centre


def unscented_cross(
    mean: Floats, covariance: Floats, motion: MotionModel, dt: float, sigma: spec.Unscented
) -> Floats:
    """(D, D) covariance of x, of the moments given, with f(x), by the points of `unscented_moments`."""
    lower = root(covariance)
    width = lower.shape[1]
    if width == 0:
        return np.zeros_like(covariance)
    scale, weights, _ = unscented_weights(width, sigma)
    away = sigma_points(width, scale) @ lower.T
    points = motion.drift(mean + away, dt)
    return np.asarray((away * weights[:, None]).T @ (points - points[0]))


def unscented_weights(width: int, sigma: spec.Unscented) -> tuple[float, Floats, float]:
    """Squared distance of the points, their (2 width + 1,) weights, and the central point's addition.

    The last, 1 - alpha^2 + beta, is added to the central weight in covariances only.
    """
    scale = sigma.alpha**2 * (3.0 if sigma.kappa is None else width + sigma.kappa)
    weights = np.full(2 * width + 1, 0.5 / scale)
    weights[0] = 1.0 - width / scale
    return scale, weights, 1.0 - sigma.alpha**2 + sigma.beta


def require_linear(motion: MotionModel) -> None:
    """Check that the Kalman filter is exact for a motion.

    Raises:
        ValueError: it is not linear, or its noise is not Gaussian in px.
    """
    free = motion.motion if isinstance(motion, Confined) else motion
    free = free.motion if isinstance(free, Nested) else free
    if isinstance(free, Reflecting):
        raise ValueError("the kalman filter is of linear motion; take extended or unscented beside borders")
    if isinstance(free, KinematicMotion):
        linear_gaussian(free, 1.0)
    elif isinstance(free, FunctionMotion):
        raise ValueError("the kalman filter is of linear motion; take extended or unscented for functions")


def _is_positive(covariance: Floats) -> bool:
    """True when no direction has a negative variance, up to rounding."""
    sds = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    scale = np.where(sds > 0, sds, 1.0)
    return bool(np.linalg.eigvalsh(symmetric(covariance / np.outer(scale, scale)))[0] > -1e-9)
