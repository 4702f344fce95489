"""Distortion of a lens in OpenCV's two models: derivatives, the inverse, and how far it reaches.

Coordinates are normalised: x / z to the right and y / z downwards of the optical axis, before the camera
matrix. Coefficients are k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4]]] (Brown's model with OpenCV's rational and
thin-prism terms), or k1 k2 k3 k4 of a fisheye lens (Kannala and Brandt, 2006).
"""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Array, Floats

COUNTS = (0, 4, 5, 8, 12)
"""Numbers of coefficients that Brown's model has in OpenCV, apart from the 14 of a tilted sensor."""


def distort(points: Floats, coefficients: Floats, *, fisheye: bool = False) -> tuple[Floats, Floats]:
    """Distorted points (..., 2) of ideal ones (..., 2), and derivatives (..., 2, 2), d out_i / d in_j.

    >>> distort(np.array([0.5, 0.0]), np.array([-0.2, 0.0, 0.0, 0.0]))[0].tolist()
    [0.475, 0.0]
    """
    x, y = points[..., 0], points[..., 1]
    square = x * x + y * y
    if not coefficients.any() and not fisheye:
        return points, np.broadcast_to(np.eye(2), (*points.shape, 2))
    scale, slope = _fisheye_scale(square, coefficients) if fisheye else _radial_scale(square, coefficients)
    derivative = np.empty((*points.shape, 2))
    derivative[..., 0, 0] = scale + 2 * slope * x * x
    derivative[..., 1, 1] = scale + 2 * slope * y * y
    derivative[..., 0, 1] = derivative[..., 1, 0] = 2 * slope * x * y
    distorted = points * scale[..., None]
    if fisheye:
        return distorted, derivative
    filled = np.zeros(12)
    filled[: len(coefficients)] = coefficients
    p1, p2 = filled[2:4]
    s1, s2, s3, s4 = filled[8:12]
    distorted[..., 0] += 2 * p1 * x * y + p2 * (square + 2 * x * x) + (s1 + s2 * square) * square
    distorted[..., 1] += p1 * (square + 2 * y * y) + 2 * p2 * x * y + (s3 + s4 * square) * square
    across, down = s1 + 2 * s2 * square, s3 + 2 * s4 * square
    derivative[..., 0, 0] += 2 * p1 * y + 6 * p2 * x + 2 * x * across
    derivative[..., 0, 1] += 2 * p1 * x + 2 * p2 * y + 2 * y * across
    derivative[..., 1, 0] += 2 * p1 * x + 2 * p2 * y + 2 * x * down
    derivative[..., 1, 1] += 6 * p1 * y + 2 * p2 * x + 2 * y * down
    return distorted, derivative


def _radial(coefficients: Floats) -> tuple[np.polynomial.Polynomial, np.polynomial.Polynomial]:
    """Numerator and denominator of the radial scale, in the square of the radius."""
    filled = np.zeros(8)
    filled[: min(len(coefficients), 8)] = coefficients[:8]
    k1, k2, _, _, k3, k4, k5, k6 = filled
    return np.polynomial.Polynomial([1, k1, k2, k3]), np.polynomial.Polynomial([1, k4, k5, k6])


def _radial_scale(square: Floats, coefficients: Floats) -> tuple[Floats, Floats]:
    """Distorted radius / radius, and its derivative by the square of the radius."""
    above, below = _radial(coefficients)
    upper, lower = above(square), below(square)
    slope = (above.deriv()(square) * lower - upper * below.deriv()(square)) / lower**2
    return np.asarray(upper / lower), np.asarray(slope)


def _angles(coefficients: Floats) -> np.polynomial.Polynomial:
    """Distorted radius of a fisheye lens, in the angle to the optical axis."""
    k1, k2, k3, k4 = coefficients
    return np.polynomial.Polynomial([0, 1, 0, k1, 0, k2, 0, k3, 0, k4])


def _fisheye_scale(square: Floats, coefficients: Floats) -> tuple[Floats, Floats]:
    """As `_radial_scale`, of a fisheye lens."""
    near = square < 1e-12
    radius = np.sqrt(np.where(near, 1.0, square))
    angle = np.arctan(radius)
    curve = _angles(coefficients)
    scale = curve(angle) / radius
    slope = (curve.deriv()(angle) / (1 + radius**2) - scale) / (2 * radius**2)
    return np.where(near, 1.0, scale), np.where(near, coefficients[0] - 1 / 3, slope)


def reach(coefficients: Floats, *, fisheye: bool = False) -> float:
    """Largest ideal radius up to which the distorted radius grows; infinity if it always does.

    Beyond it the polynomial folds back: a point far outside the image would land inside.

    >>> round(reach(np.array([-0.3, 0.0, 0.0, 0.0])), 4)  # 1 - 0.9 r^2 = 0
    1.0541
    """
    if not coefficients.any():
        return np.inf
    if fisheye:
        angles = _positive(_angles(coefficients).deriv().roots())
        return float(np.tan(angles[0])) if angles and angles[0] < np.pi / 2 else np.inf
    above, below = _radial(coefficients)
    root = np.polynomial.Polynomial([0, 2])
    slope = above * below + root * (above.deriv() * below - above * below.deriv())
    squares = sorted(_positive(slope.roots()) + _positive(below.roots()))
    return float(np.sqrt(squares[0])) if squares else np.inf


def _positive(roots: Array) -> list[float]:
    """Real positive roots, in ascending order."""
    real = roots.real[(np.abs(roots.imag) < 1e-9 * np.maximum(np.abs(roots), 1e-9)) & (roots.real > 0)]
    return sorted(float(root) for root in real)


def undistort(points: Floats, coefficients: Floats, *, fisheye: bool = False) -> Floats:
    """Ideal points (N, 2) of distorted ones (N, 2): the inverse of `distort`, by Newton's method.

    nan where no ideal point within `reach` is distorted to this one.

    >>> undistort(np.array([[0.475, 0.0]]), np.array([-0.2, 0.0, 0.0, 0.0])).round(9).tolist()
    [[0.5, 0.0]]
    """
    if not coefficients.any() and not fisheye:
        return points.copy()
    limit = min(reach(coefficients, fisheye=fisheye), 1e3)
    ideal = _within(points, 0.999 * limit)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        for _ in range(50):
            distorted, derivative = distort(ideal, coefficients, fisheye=fisheye)
            (a, b), (c, d) = np.moveaxis(derivative, (-2, -1), (0, 1))
            east, south = np.moveaxis(points - distorted, -1, 0)
            step = np.stack([d * east - b * south, a * south - c * east], axis=-1)
            step /= (a * d - b * c)[..., None]
            ideal = _within(ideal + step, 0.9999 * limit)
            if np.nanmax(np.abs(step), initial=0.0) < 1e-13:
                break
        wrong = np.abs(distort(ideal, coefficients, fisheye=fisheye)[0] - points).max(axis=-1) > 1e-7
    ideal[wrong] = np.nan
    return ideal


def _within(points: Floats, limit: float) -> Floats:
    """The points, those outside of a circle moved onto it."""
    radius = np.hypot(points[..., 0], points[..., 1])
    return np.asarray(points * np.minimum(1.0, limit / np.maximum(radius, 1e-300))[..., None])
