"""Derivatives of functions at many states, their inverses, and the distortion of a lens.

Coordinates are normalised: x / z to the right and y / z downwards of the optical axis, before the camera
matrix. Coefficients are k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4]]] (Brown's model with OpenCV's rational and
thin-prism terms), or k1 k2 k3 k4 of a fisheye lens (Kannala and Brandt, 2006).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayesnet_track.numerics.arrays import Array, Floats

Function = Callable[[Floats], Floats]
"""(N, D) states -> (N, K) values."""

Less = Callable[[Floats, Floats], Floats]
"""(N, K) values, those they are compared with -> the differences; of angles the shorter way."""

STEPS, LAST = 12, 6
"""Steps in which a function is followed, and the corrections after the last one."""

CLOSE = 1e-6
"""How near, in units of the errors, the value of an inverse has to be to the one that was asked for."""


def shorter_way(periods: Floats) -> Less:
    """Differences of quantities with these periods (K,), infinite of those that are no angles.

    >>> shorter_way(np.array([np.inf, 360.0]))(np.array([5.0, 350.0]), np.array([3.0, 10.0])).tolist()
    [2.0, -20.0]
    """
    turns = periods < np.inf
    period = np.where(turns, periods, 1.0)

    def less(values: Floats, expected: Floats) -> Floats:
        error = values - expected
        return np.where(turns, (error + period / 2) % period - period / 2, error) if turns.any() else error

    return less


def derivatives(function: Function, states: Floats) -> Floats:
    """(N, K, D) derivatives at states (N, D) by central differences.

    `function` takes (2 D * N, D) states, all N of one step below each other. Steps of eps^(1/3) max(1, |x|).

    >>> derivatives(lambda x: x**2, np.array([[1.0, 3.0]])).round(6).tolist()
    [[[2.0, 0.0], [0.0, 6.0]]]
    """
    count, size = states.shape
    step = np.cbrt(np.finfo(np.float64).eps) * np.maximum(1.0, np.abs(states))
    stepped = np.tile(states, (2 * size, 1, 1))
    for k in range(size):
        stepped[k, :, k] += step[:, k]
        stepped[size + k, :, k] -= step[:, k]
    spacing = np.stack([stepped[k, :, k] - stepped[size + k, :, k] for k in range(size)])
    values = function(stepped.reshape(-1, size)).reshape(2 * size, count, -1)
    slopes = (values[:size] - values[size:]) / spacing[:, :, None]
    return np.asarray(np.moveaxis(slopes, 0, 2))


def follow_line(
    function: Function, less: Less, place: Floats, values: Floats, way: Floats, variances: Floats
) -> Floats:
    """(N, D) states at which a function has the `values` (K,) plus the way (N, K); NaN where none is found.

    It is followed along straight ways of values, from the state `place` (D,), at which it has `values`: each
    step is one of Newton's (of Gauss and Newton, weighted by 1 / variances, with more values than fields). So
    the branch of the inverse is that of the place. `function` takes a multiple of N states.
    """
    states = np.tile(place, (len(way), 1))
    for step in range(1, STEPS + 1):
        target = values + way * (step / STEPS)
        for _ in range(1 if step < STEPS else LAST):
            states = states + _newton(function, less, states, target, variances)[0]
    is_found = _newton(function, less, states, target, variances)[1] < CLOSE
    return np.where(is_found[:, None], states, np.nan)


def _newton(
    function: Function, less: Less, states: Floats, targets: Floats, variances: Floats
) -> tuple[Floats, Floats]:
    """(N, D) the step of Gauss and Newton towards the values wanted (N, K), and (N,) what is left to gain.

    The latter is the largest cosine-weighted error, in sds: 0 where no field can bring the values nearer.
    """
    count, size = states.shape
    step = np.cbrt(np.finfo(np.float64).eps) * np.maximum(1.0, np.abs(states))
    stepped = np.tile(states, (2 * size + 1, 1, 1))
    for k in range(size):
        stepped[1 + k, :, k] += step[:, k]
        stepped[1 + size + k, :, k] -= step[:, k]
    values = function(stepped.reshape(-1, size)).reshape(2 * size + 1, count, -1)
    spacing = np.stack([stepped[1 + k, :, k] - stepped[1 + size + k, :, k] for k in range(size)])
    sds = np.sqrt(variances)
    change = less(values[1 : size + 1], values[size + 1 :])
    slopes = np.moveaxis(change / spacing[:, :, None], 0, 2) / sds[:, None]
    error = less(targets, values[0]) / sds
    normal = np.swapaxes(slopes, 1, 2) @ slopes
    scale = np.sqrt(np.diagonal(normal, axis1=1, axis2=2)) + 1e-300
    pull = (np.swapaxes(slopes, 1, 2) @ error[:, :, None])[:, :, 0] / scale
    normal = normal / (scale[:, :, None] * scale[:, None, :])
    usable = np.isfinite(normal).all(axis=(1, 2)) & np.isfinite(pull).all(axis=1)
    normal[~usable] = np.eye(size)
    usable &= np.abs(np.linalg.det(normal)) > 1e-12
    normal[~usable] = np.eye(size)
    towards = np.linalg.solve(normal, pull[:, :, None])[:, :, 0] / scale
    remaining = np.where(usable, np.abs(pull).max(axis=1), np.inf)
    return np.where(usable[:, None], towards, 0.0), remaining


def solutions(function: Function, less: Less, values: Floats, variances: Floats) -> Floats:
    """(S, 2) the different states at which a function has `values` (K,), of those found from many starts.

    Steps of Gauss and Newton, halved until they bring the values nearer; starts lie around 0 on circles of
    radii from 0.1 to 100,000.

    >>> line = lambda x: np.stack([np.hypot(x[:, 0], x[:, 1]), x[:, 1]], axis=1)
    >>> solutions(line, shorter_way(np.full(2, np.inf)), np.array([5.0, 3.0]), np.ones(2)).round(6).tolist()
    [[-4.0, 3.0], [4.0, 3.0]]
    """
    turn = 2.0 * np.pi * (np.arange(8) + 0.37) / 8
    circles = 10.0 ** np.arange(-1.0, 5.5, 0.5)
    states = (circles[:, None, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)).reshape(-1, 2)
    targets = np.tile(values, (len(states), 1))

    def distance(points: Floats) -> Floats:
        with np.errstate(all="ignore"):
            error = (less(targets, function(points)) ** 2 / variances).sum(axis=1)
        return np.where(np.isfinite(error), error, np.inf)

    distances = distance(states)
    for _ in range(60):
        with np.errstate(all="ignore"):
            step = _newton(function, less, states, targets, variances)[0]
        for _ in range(6):
            stepped_distances = distance(states + step)
            is_nearer = stepped_distances < distances
            states = np.where(is_nearer[:, None], states + step, states)
            distances = np.where(is_nearer, stepped_distances, distances)
            step = np.where(is_nearer[:, None], 0.0, step / 2)
    smallest = float(distances.min())
    if not np.isfinite(smallest) or (len(values) == states.shape[1] and smallest > CLOSE):
        return np.empty((0, 2))
    distinct: list[Floats] = []
    for state in states[distances <= smallest + CLOSE]:
        if all(
            np.abs(state - solution).max() > 1e-4 * (1.0 + np.abs(solution).max()) for solution in distinct
        ):
            distinct.append(state)
    return np.array(sorted(solution.tolist() for solution in distinct)).reshape(-1, 2)


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
    slope_x, slope_y = s1 + 2 * s2 * square, s3 + 2 * s4 * square
    derivative[..., 0, 0] += 2 * p1 * y + 6 * p2 * x + 2 * x * slope_x
    derivative[..., 0, 1] += 2 * p1 * x + 2 * p2 * y + 2 * y * slope_x
    derivative[..., 1, 0] += 2 * p1 * x + 2 * p2 * y + 2 * x * slope_y
    derivative[..., 1, 1] += 6 * p1 * y + 2 * p2 * x + 2 * y * slope_y
    return distorted, derivative


def _radial(coefficients: Floats) -> tuple[np.polynomial.Polynomial, np.polynomial.Polynomial]:
    """Numerator and denominator of the radial scale, in the square of the radius."""
    filled = np.zeros(8)
    filled[: min(len(coefficients), 8)] = coefficients[:8]
    k1, k2, _, _, k3, k4, k5, k6 = filled
    return np.polynomial.Polynomial([1, k1, k2, k3]), np.polynomial.Polynomial([1, k4, k5, k6])


def _radial_scale(square: Floats, coefficients: Floats) -> tuple[Floats, Floats]:
    """Distorted radius / radius, and its derivative by the square of the radius."""
    numerator, denominator = _radial(coefficients)
    upper, lower = numerator(square), denominator(square)
    slope = (numerator.deriv()(square) * lower - upper * denominator.deriv()(square)) / lower**2
    return np.asarray(upper / lower), np.asarray(slope)


def _angles(coefficients: Floats) -> np.polynomial.Polynomial:
    """Distorted radius of a fisheye lens, in the angle to the optical axis."""
    k1, k2, k3, k4 = coefficients
    return np.polynomial.Polynomial([0, 1, 0, k1, 0, k2, 0, k3, 0, k4])


def _fisheye_scale(square: Floats, coefficients: Floats) -> tuple[Floats, Floats]:
    """Scale and slope as of `_radial_scale`, of a fisheye lens."""
    is_central = square < 1e-12
    radius = np.sqrt(np.where(is_central, 1.0, square))
    angle = np.arctan(radius)
    curve = _angles(coefficients)
    scale = curve(angle) / radius
    slope = (curve.deriv()(angle) / (1 + radius**2) - scale) / (2 * radius**2)
    return np.where(is_central, 1.0, scale), np.where(is_central, coefficients[0] - 1 / 3, slope)


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
    numerator, denominator = _radial(coefficients)
    root = np.polynomial.Polynomial([0, 2])
    slope = numerator * denominator + root * (
        numerator.deriv() * denominator - numerator * denominator.deriv()
    )
    squares = sorted(_positive(slope.roots()) + _positive(denominator.roots()))
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
    ideal = _bound_radius(points, 0.999 * limit)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        for _ in range(50):
            distorted, derivative = distort(ideal, coefficients, fisheye=fisheye)
            (a, b), (c, d) = np.moveaxis(derivative, (-2, -1), (0, 1))
            east, south = np.moveaxis(points - distorted, -1, 0)
            step = np.stack([d * east - b * south, a * south - c * east], axis=-1)
            step /= (a * d - b * c)[..., None]
            ideal = _bound_radius(ideal + step, 0.9999 * limit)
            if np.nanmax(np.abs(step), initial=0.0) < 1e-13:
                break
        wrong = np.abs(distort(ideal, coefficients, fisheye=fisheye)[0] - points).max(axis=-1) > 1e-7
    ideal[wrong] = np.nan
    return ideal


def _bound_radius(points: Floats, limit: float) -> Floats:
    """The points, those outside of a circle moved onto it."""
    radius = np.hypot(points[..., 0], points[..., 1])
    return np.asarray(points * np.minimum(1.0, limit / np.maximum(radius, 1e-300))[..., None])
