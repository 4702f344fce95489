"""Shapes: splines, the chain from edges to shape vectors, examples, and the statistical model learnt of them.

Thesis 3.3: principal components that keep 95 % of the variance of the signed-distance vectors.
"""

from __future__ import annotations

import zipfile
import zlib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.graphs import graph_folder
from bayesnet_track.numerics.arrays import Array, Floats, Ints
from bayesnet_track.observation.image_files import PictureError, read_mask
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Region
from bayesnet_track.vision.planes import EdgePlane

CONTROL_POINTS = 40
"""Control points of a silhouette (thesis 3.3)."""


def basis(parameters: Floats, controls: int) -> Floats:
    """(n, controls) weights of the control points at curve `parameters` (n,), each in 0 .. controls.

    Parameter i is the knot at which control point i weighs 4/6 and its two neighbours 1/6. The weights of a
    row sum to 1; the curve is closed, so that parameter `controls` is parameter 0.

    >>> (6 * basis(np.array([2.0]), 5)).round(12).tolist()
    [[0.0, 1.0, 4.0, 1.0, 0.0]]
    """
    knot = np.floor(parameters).astype(np.int64)
    t = parameters - knot
    blends = ((1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3)
    weights = np.zeros((len(parameters), controls))
    rows = np.arange(len(parameters))
    for offset, blend in enumerate(blends, start=-1):
        np.add.at(weights, (rows, (knot + offset) % controls), blend / 6.0)
    return weights


@cache
def fit_matrix(points: int, controls: int = CONTROL_POINTS) -> Floats:
    """(controls, points): least-squares control points of `points` points evenly spaced in the parameter.

    At least as many points as control points are needed, or the curve is not determined.
    """
    weights = basis(_even_parameters(points, controls), controls)
    matrix = np.asarray(np.linalg.solve(np.einsum("ma,mb->ab", weights, weights), weights.T), np.float64)
    matrix.flags.writeable = False
    return matrix


@cache
def curve_matrix(points: int, controls: int = CONTROL_POINTS) -> Floats:
    """(points, controls): the curve's points at even parameters, from its control points."""
    matrix = basis(_even_parameters(points, controls), controls)
    matrix.flags.writeable = False
    return matrix


def _even_parameters(points: int, controls: int) -> Floats:
    return np.arange(points, dtype=np.float64) * (controls / points)


REACH = 0.25
"""How far a snake's point sees an edge, in mean sides of the box."""

TOLERANCE = 0.05
"""How far from an edge a snake's point still counts as on it, in mean sides of the box (1.5 px at least)."""

CURVE_POINTS = 80
"""Corners of the polygon that stands for the spline: two for each control point."""

FIELD_POINTS = 24
"""Points per side of a signed-distance field."""

COVER = 1.5
"""A field covers its box grown by this factor."""


@dataclass(frozen=True, eq=False)
class Contours:
    """Closed contours, one for each box.

    Attributes:
        boxes: (C, 4) the centre boxes that the snakes started from.
        snakes: (C, M, 2) points of the snakes, frame px.
        controls: (C, 40, 2) control points of the closed uniform cubic B-splines.
        curves: (C, P, 2) points on the splines.
        support: (C,) share of each snake on edges inside the frame, 0..1.
    """

    boxes: Floats
    snakes: Floats
    controls: Floats
    curves: Floats
    support: Floats


def contours(points: Ints, boxes: Floats, frame: Ints) -> Contours:
    """A contour for each centre box (C, 4) from the edge pixels (E, 2) of a frame of (width, height) px.

    Each depends on its own box and the edges only, not on the other boxes.
    """
    from bayesnet_track.vision.kernels import shape_kernels
    from bayesnet_track.vision.kernels.shape_kernels import map_points

    boxes = np.ascontiguousarray(boxes, dtype=np.float64)
    count = len(boxes)
    snakes, support = np.empty((count, shape_kernels.POINTS, 2)), np.zeros(count)
    distance, origin = _distances(points, boxes, frame)
    steps = np.array([stage[2] for stage in shape_kernels.STAGES], dtype=np.int64)
    shape_kernels.run_snakes(
        distance,
        origin,
        np.asarray(frame, dtype=np.int64),
        boxes,
        shape_kernels.smoothing_filters(),
        steps,
        REACH,
        TOLERANCE,
        snakes,
        support,
    )
    controls, curves = np.empty((count, CONTROL_POINTS, 2)), np.empty((count, CURVE_POINTS, 2))
    # a kernel: the sums of a BLAS for one contour may depend on how many there are
    map_points(fit_matrix(shape_kernels.POINTS), snakes, controls)
    map_points(curve_matrix(CURVE_POINTS), controls, curves)
    return Contours(boxes, snakes, controls, curves, support)


def fields(outlines: Contours) -> Floats:
    """(C, S, S) signed distance in px to each contour around its box grown by `COVER`; negative inside."""
    from bayesnet_track.vision.kernels.shape_kernels import cell_fields

    values = np.empty((len(outlines.boxes), FIELD_POINTS, FIELD_POINTS))
    cell_fields(outlines.curves, outlines.boxes, COVER, values)
    return values


def _distances(points: Ints, boxes: Floats, frame: Ints) -> tuple[Array, Ints]:
    """(rows, columns) float64 px to the nearest edge pixel where the snakes may look, and its origin.

    Exact up to the largest reach: edges beyond the window are further away than any snake looks.
    """
    import cv2

    from bayesnet_track.vision.kernels.shape_kernels import BOUND

    side = np.sqrt(boxes[:, 2] * boxes[:, 3])
    # a snake's bound, what it sees from there, and twice the tolerance, with room for the gradient
    room = (
        0.5 * BOUND * boxes[:, 2:] + np.maximum(REACH * side, np.maximum(2 * TOLERANCE * side, 3.0))[:, None]
    )
    low = np.floor((boxes[:, :2] - room).min(axis=0)).astype(np.int64) - 3
    high = np.ceil((boxes[:, :2] + room).max(axis=0)).astype(np.int64) + 4
    low, high = np.clip(low, 0, frame - 1), np.clip(high, 1, frame)
    high = np.maximum(high, low + 1)
    in_window = ((points >= low) & (points < high)).all(axis=1)
    x, y = (points[in_window] - low).T
    free = np.full((high[1] - low[1], high[0] - low[0]), 255, dtype=np.uint8)
    free[y, x] = 0
    if len(x) == 0:
        return np.full(free.shape, 1e6), low
    distance = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    # OpenCV's last bits depend on its threads; the squares are whole numbers
    return np.sqrt(np.rint(np.square(distance, dtype=np.float64))), low


def mask_edges(mask: Array) -> Ints:
    """(E, 2) x, y of the pixels of a mask (H, W) next to its outside; the picture's rim is outside."""
    import cv2

    filled = (np.asarray(mask) > 0).astype(np.uint8)
    core = cv2.erode(filled, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0)
    y, x = np.nonzero(filled & ~core & 1)
    return np.column_stack([x, y]).astype(np.int64)


def _mask_box(mask: Array) -> Floats:
    """(4,) the centre box around all pixels of a mask (H, W) above 0.

    Raises:
        ValueError: there is none.
    """
    y, x = np.nonzero(np.asarray(mask))
    if len(x) == 0:
        raise ValueError("the mask is empty")
    left, top, right, bottom = x.min(), y.min(), x.max(), y.max()
    return np.array([(left + right) / 2, (top + bottom) / 2, right - left + 1, bottom - top + 1], np.float64)


def vectors(outlines: Contours, boxes: Floats, grid: int) -> Floats:
    """(C, grid * grid) shape vector of each contour in a box (C, 4) near its own; rows top to bottom."""
    from bayesnet_track.vision.kernels.shape_kernels import shape_vector

    values = np.empty((len(boxes), grid * grid))
    for field, cell, box, vector in zip(fields(outlines), outlines.boxes, boxes, values, strict=True):
        shape_vector(field, cell, COVER, np.asarray(box, dtype=np.float64), vector)
    return values


def mask_example(mask: Array, grid: int) -> tuple[Floats, float]:
    """(grid * grid,) shape vector of a mask (H, W), above 0 inside, and the snake's support on its rim.

    The snake starts from the ellipse of the box around the mask, as it does in a frame: what it cannot
    follow there, such as the gap between two legs, must be missing here too.

    Raises:
        ValueError: the mask is empty.
    """
    box = _mask_box(mask)[None]
    return _example(mask_edges(mask), box, mask.shape[1], mask.shape[0], grid)


def frame_example(frame: Frame, box: Floats, edges: EdgePlane, grid: int) -> tuple[Floats, float]:
    """(grid * grid,) shape vector of what a centre box (4,) of a frame holds, and the snake's support."""
    planes = PlaneCache(FramePair(frame, None)).planes([edges], Region(0, 0, frame.width, frame.height))
    points = planes[edges]
    strong = points[(points[:, 2] & 1) == 1, :2]
    return _example(strong, np.asarray(box, dtype=np.float64)[None], frame.width, frame.height, grid)


def _example(points: Array, box: Floats, width: int, height: int, grid: int) -> tuple[Floats, float]:
    outline = contours(points, box, np.array([width, height], dtype=np.int64))
    return vectors(outline, box, grid)[0], float(outline.support[0])


KIND, VERSION = "bayesnet_track shape model", 1
KEEP = 0.95
"""Share of the variance that the modes keep."""


class ShapeModelError(ValueError):
    """A model file that cannot be read or is not one of this version."""


@dataclass(frozen=True, eq=False)
class ShapeModel:
    """A Gaussian over shape vectors: orthonormal modes around a mean.

    Attributes:
        mean: (G * G,) mean shape vector, unit half mean sides of the box.
        modes: (K, G * G) orthonormal, largest variance first; K may be 0.
        variances: (K,) variance along each mode.
        explained: share of the examples' variance that the modes hold, 0..1 (1 when they do not vary).
        examples: how many shapes it was learnt from.
    """

    mean: Floats
    modes: Floats
    variances: Floats
    explained: float = 1.0
    examples: int = 1

    @property
    def grid(self) -> int:
        """Cells per side of the grid."""
        return round(float(np.sqrt(self.mean.size)))


def learn_model(vectors: Floats, keep: float = KEEP) -> ShapeModel:
    """The model of the shape vectors (n, G * G): the fewest modes with at least `keep` of their variance.

    Variances are divided by n. Each mode's largest entry is positive: equal examples give equal files.

    Raises:
        ValueError: no example, or one that is not finite.
    """
    examples = np.asarray(vectors, dtype=np.float64)
    if examples.ndim != 2 or len(examples) == 0:
        raise ValueError("a shape model needs at least one example")
    if not np.isfinite(examples).all():
        raise ValueError("a shape vector is not finite")
    mean = examples.mean(axis=0)
    _, singular, axes = np.linalg.svd(examples - mean, full_matrices=False)
    variances = singular**2 / len(examples)
    total = float(variances.sum())
    if total <= 1e-20:
        return ShapeModel(mean, np.empty((0, mean.size)), np.empty(0), 1.0, len(examples))
    shares = np.cumsum(variances) / total
    count = min(int(np.searchsorted(shares, keep - 1e-12)) + 1, len(variances))
    return ShapeModel(mean, _sign(axes[:count]), variances[:count], float(shares[count - 1]), len(examples))


def merge(current: ShapeModel, learnt: ShapeModel, rate: float, limit: int) -> ShapeModel:
    """The Gaussian with the mean and covariance of the mixture (1 - rate) current + rate learnt.

    At most `limit` modes, those with the largest variances. Rate 0 and 1 give the two models themselves.
    """
    if rate <= 0.0 or rate >= 1.0:
        return current if rate <= 0.0 else learnt
    mean = (1.0 - rate) * current.mean + rate * learnt.mean
    columns = np.concatenate(
        [
            current.modes * np.sqrt((1.0 - rate) * current.variances)[:, None],
            learnt.modes * np.sqrt(rate * learnt.variances)[:, None],
            (np.sqrt(rate * (1.0 - rate)) * (learnt.mean - current.mean))[None],
        ]
    )
    # The covariance is columns' columns; its eigenvectors come from the small matrix columns columns'.
    variances, weights = np.linalg.eigh(np.einsum("ap,bp->ab", columns, columns))
    order = [k for k in np.argsort(-variances, kind="stable")[:limit] if variances[k] > 1e-12]
    modes = np.einsum("ak,ap->kp", weights[:, order], columns) / np.sqrt(variances[order])[:, None]
    return ShapeModel(mean, _sign(modes), variances[order], 1.0, current.examples + learnt.examples)


def save_model(path: str | Path, model: ShapeModel) -> None:
    """Write the model; the file holds arrays only, no code.

    Raises:
        OSError: it cannot be written.
    """
    with Path(path).open("wb") as file:
        np.savez_compressed(
            file,
            kind=np.array(KIND),
            version=np.array(VERSION),
            mean=model.mean,
            modes=model.modes,
            variances=model.variances,
            explained=np.array(model.explained),
            examples=np.array(model.examples),
        )


MAX_BYTES = 1 << 28
"""Most that a model may take in memory: far more than one of 100 modes on 64 x 64 cells."""


GRID = 16
"""Cells along each side of the vectors of a model from one image."""


def model_path(path: str | Path) -> str:
    """The file at `path`, or if there is none, that of its name among the installed graphs."""
    installed = Path(graph_folder()) / path
    return str(installed) if not Path(path).exists() and installed.is_file() else str(path)


def load_model(path: str | Path) -> ShapeModel:
    """Read what `save_model` wrote, or the silhouette in an image; nothing in the file is executed.

    An image is a mask, above 0 inside: the mean shape, without modes. The file is that of `model_path`.

    Raises:
        ShapeModelError: it cannot be read, is something else, of another version, or its arrays do not fit.
    """
    path = model_path(path)
    if Path(path).suffix.lower() == ".png":
        try:
            vector, _ = mask_example(read_mask(Path(path)).gray, GRID)
        except (PictureError, ValueError) as error:
            raise ShapeModelError(f"silhouette {error}") from error
        return learn_model(vector[None])
    # A pipe would wait for its writer, a device never end, and packed zeros unpack to any size.
    if Path(path).exists() and not Path(path).is_file():
        raise ShapeModelError(f"{path} is no file")
    try:
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as packed:
                if sum(part.file_size for part in packed.infolist()) > MAX_BYTES:
                    raise ShapeModelError(f"{path} is larger than {MAX_BYTES >> 20} MB when unpacked")
        with np.load(path, allow_pickle=False) as file:
            if not isinstance(file, np.lib.npyio.NpzFile) or str(file.get("kind")) != KIND:
                raise ShapeModelError(f"{path} is not a shape model; `bayesnet-track learn-shape` makes one")
            version = file["version"]
            if version.shape != () or int(version) != VERSION:
                raise ShapeModelError(
                    f"{path} is a shape model of version {version}; this program reads version {VERSION}"
                )
            return _check(path, {name: file[name] for name in _FIELDS})
    except FileNotFoundError:
        raise ShapeModelError(f"{path} is not there; `bayesnet-track learn-shape` makes one") from None
    except OSError as error:
        raise ShapeModelError(f"{path} cannot be read: {error.strerror or error}") from error
    except ShapeModelError:
        raise
    except (ValueError, TypeError, KeyError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise ShapeModelError(f"{path} is damaged, or no shape model") from error


_FIELDS = ("mean", "modes", "variances", "explained", "examples")


def _check(path: str | Path, arrays: dict[str, NDArray[np.generic]]) -> ShapeModel:
    mean, modes, variances = (np.array(arrays[name], dtype=np.float64) for name in _FIELDS[:3])
    side = round(float(np.sqrt(mean.size)))
    fits = mean.ndim == 1 and side * side == mean.size and side >= 4
    fits = fits and modes.shape == (variances.size, mean.size) and variances.ndim == 1
    if not fits:
        raise ShapeModelError(
            f"{path}: arrays of shapes {mean.shape}, {modes.shape}, {variances.shape} are no shape model: "
            "a mean of G * G values, K modes of as many, and K variances are needed"
        )
    finite = all(np.isfinite(array).all() for array in (mean, modes, variances))
    if not finite or (variances < 0).any():
        raise ShapeModelError(f"{path}: values that are not finite, or negative variances")
    if not np.allclose(np.einsum("ap,bp->ab", modes, modes), np.eye(len(modes)), atol=1e-6):
        raise ShapeModelError(f"{path}: its modes are not orthonormal")
    return ShapeModel(mean, modes, variances, float(arrays["explained"]), int(arrays["examples"]))


def _sign(modes: Floats) -> Floats:
    """The modes (K, P), each turned so that its largest entry is positive."""
    if len(modes) == 0:
        return np.asarray(modes)
    top = modes[np.arange(len(modes)), np.abs(modes).argmax(axis=1)]
    return np.asarray(modes * np.where(top < 0, -1.0, 1.0)[:, None])
