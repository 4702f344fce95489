"""Shape cue: the silhouette inside a box, as signed distances to a closed spline, against a shape model.

Thesis 3.3, eq. 3.7, with what lies outside the model's subspace counted too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from pydantic import Field, field_validator

from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.observation.cue import CueDeclaration, CueParameters, Hypotheses, Reference, floored
from bayesnet_track.vision.planes import CONTRASTS, EdgePlane
from bayesnet_track.vision.shape import (
    COVER,
    ShapeModel,
    ShapeModelError,
    contours,
    fields,
    load_model,
    merge,
    model_path,
    vectors,
)

if TYPE_CHECKING:
    from bayesnet_track.observation.planes import Plane, Planes


GRID = 16
"""Cells per side of the grid on which shapes are compared, where no model file says otherwise."""

MODES = 8
"""Modes that a model learnt while tracking may have."""

STEP = 1.0 / 6.0
"""Hypotheses share a contour when their centres lie in one cell this wide, in sizes of the cell's box."""

RATIO = 1.25
"""Hypotheses share a contour when their sides differ from the cell's box by less than the root of this."""

LEAST_SUPPORT = 0.3
"""A silhouette with less of it on edges is none."""

CLEAR_SUPPORT = 0.8
"""Share of the reference's support that a silhouette needs to be learnt from."""


class ShapeParameters(CueParameters):
    """Parameters of the shape cue."""

    model: str | None = Field(
        default=None,
        description="Shape model file of `bayesnet-track learn-shape`, a path from where the program is "
        "started; without one the model is learnt from the first box on.",
    )
    sd_distance: float = Field(
        default=0.08,
        gt=0,
        description="Standard deviation (root mean square over the box) of the distance from the contour, in "
        "half mean sides of the box, beyond what the model's modes allow.",
    )
    sd_support: float = Field(
        default=0.25,
        gt=0,
        description="Standard deviation of the share of the contour that is missing from the edges, against "
        "the reference's.",
    )
    edge_gray: float = Field(
        default=8.0,
        gt=0,
        le=100,
        description="Gradient at which an edge starts, gray levels of 255 per pixel; the local action tries "
        "half and twice this value.",
    )
    blur_px: float = Field(
        default=1.0,
        ge=0,
        le=8,
        description="Standard deviation of the Gaussian that smooths the image before the edges, pixels.",
    )
    sharpness: float = Field(
        default=1.0, gt=0, description="Factor on the log-likelihood before the floor (no unit)."
    )

    @field_validator("model")
    @classmethod
    def _readable(cls, path: str | None) -> str | None:
        if path is not None:
            try:
                load_model(path)
            except ShapeModelError as error:
                raise ValueError(f"a shape model file ({error})") from error
        return path


@dataclass(frozen=True)
class ShapeCue:
    """Compares silhouettes.

    Reference: `mean` (G * G,), `modes` (K, G * G) and `variances` (K,) of the shape model; `size` (2,) of the
    target in pixels, from which the boxes' cells are counted; `support` (1,) share of its contour on edges;
    `contrast` (1,) int64, which of the edge plane's thresholds is in use.
    """

    parameters: ShapeParameters
    edges: EdgePlane
    model: ShapeModel | None
    context: ClassVar[float] = 0.0

    @property
    def needs(self) -> tuple[Plane, ...]:
        """The edges."""
        return (self.edges,)

    def learn(self, planes: Planes, box: Floats) -> Reference:
        """The model from the file, or the silhouette in the centre box (4,) as a model without modes."""
        box = np.array(box, dtype=np.float64)[None]
        cells, owner = _cells(box, box[0, 2:], planes)
        grid = GRID if self.model is None else self.model.grid
        mean, support = np.zeros(grid * grid), np.zeros(1)
        if owner[0] >= 0:
            box_contours = contours(_edge_points(planes, self.edges, 0), cells, _frame(planes))
            mean, support = vectors(box_contours, box, grid)[0], box_contours.support
        model = self.model or ShapeModel(mean, np.zeros((0, mean.size)), np.zeros(0))
        if self.model is not None:
            support = np.maximum(support, LEAST_SUPPORT)
        return _reference(model, box[0, 2:], support, np.zeros(1, np.int64), self.model is None)

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        """Mixture of the two models: mean and covariance between them (eq. 2.15); a file's model stays.

        A silhouette with clearly fewer edges than the old one's teaches nothing. Any other is seen at the
        usual edge threshold, so that local action on the threshold is taken back.
        """
        is_clear = new["support"][0] >= max(LEAST_SUPPORT, CLEAR_SUPPORT * old["support"][0])
        if rate <= 0.0 or rate >= 1.0 or not is_clear:
            return dict(new if rate >= 1.0 else old)
        if old["support"][0] < LEAST_SUPPORT:
            return dict(new)
        size = (1.0 - rate) * old["size"] + rate * new["size"]
        support = (1.0 - rate) * old["support"] + rate * new["support"]
        if self.model is not None:
            return {**old, "size": size, "support": support, "contrast": new["contrast"]}
        merged = merge(_model(old), _model(new), rate, MODES)
        return _reference(merged, size, support, new["contrast"], True)

    def adapt(self, reference: Reference, attempt: int) -> Reference | None:
        """Look for fainter edges first, then for strong ones only; then nothing is left."""
        if attempt >= len(CONTRASTS):
            return None
        return {**reference, "contrast": np.array([attempt], dtype=np.int64)}

    def log_likelihood(self, planes: Planes, hypotheses: Hypotheses, reference: Reference) -> Floats:
        """(N,) log-likelihood; a box outside the frame, or with no edges along its contour, is at the floor.

        All 0 when the reference has seen no silhouette.
        """
        from bayesnet_track.vision.kernels.shape_kernels import score_shapes

        settings = self.parameters
        if reference["support"][0] < LEAST_SUPPORT:
            return np.zeros(len(hypotheses))
        boxes = np.ascontiguousarray(hypotheses.boxes, dtype=np.float64)
        cells, owner = _cells(boxes, reference["size"], planes)
        log = np.full(len(boxes), -np.inf)
        if len(cells) == 0:
            return floored(log, settings.floor)
        points = _edge_points(planes, self.edges, int(reference["contrast"][0]))
        cell_contours = contours(points, cells, _frame(planes))
        energies, noise = np.full(len(boxes), np.inf), reference["mean"].size * settings.sd_distance**2
        model = _model(reference)
        score_shapes(
            fields(cell_contours),
            cells,
            COVER,
            owner,
            boxes,
            model.mean,
            model.modes,
            model.variances,
            noise,
            energies,
        )
        missing = np.maximum(1.0 - cell_contours.support / reference["support"][0], 0.0)[owner]
        log = -0.5 * settings.sharpness * (energies + (missing / settings.sd_support) ** 2)
        return floored(log, settings.floor)


def _cells(boxes: Floats, size: Floats, planes: Planes) -> tuple[Floats, Ints]:
    """The boxes (C, 4) that stand for all of `boxes` (N, 4), and which of them (N,) each belongs to.

    The lattice of these boxes is fixed by the reference's size and the frame's corner, so that a box belongs
    to the same one in whatever company; -1 for boxes that do not touch the frame.
    """
    centre, sides = boxes[:, :2], np.maximum(boxes[:, 2:], 0.25)
    frame = _frame(planes)
    touches = np.asarray(np.abs(2 * centre - (frame - 1)) < sides + frame).all(axis=1)
    scale = np.clip(np.rint(np.log(sides / np.maximum(size, 0.25)) / np.log(RATIO)), -60, 60)
    canonical = np.maximum(size, 0.25) * RATIO**scale
    place = np.floor(np.where(touches.reshape(-1, 1), centre, 0.0) / (STEP * canonical) + 0.5)
    key = np.concatenate([scale, place], axis=1).astype(np.int64)
    packed = (
        ((key[:, 0] + 64) << 7 | (key[:, 1] + 64)) << 48 | (key[:, 2] + 2**23) << 24 | (key[:, 3] + 2**23)
    )
    touching = np.flatnonzero(touches)
    _, first, inverse = np.unique(packed[touching], return_index=True, return_inverse=True)
    owner = np.full(len(boxes), -1, dtype=np.int64)
    owner[touching] = inverse
    firsts = touching[first]
    cells = np.concatenate([place[firsts] * STEP * canonical[firsts], canonical[firsts]], axis=1)
    return cells, owner


def _frame(planes: Planes) -> Ints:
    return np.array([planes.frame.width, planes.frame.height], dtype=np.int64)


def _edge_points(planes: Planes, edges: EdgePlane, contrast: int) -> Ints:
    points: Ints = planes[edges]
    return points[(points[:, 2] >> contrast & 1) == 1, :2]


def _model(reference: Reference) -> ShapeModel:
    """Its model, without the room for modes that it has not learnt."""
    mode_indices = np.flatnonzero(reference["variances"])
    return ShapeModel(
        reference["mean"], reference["modes"][mode_indices], reference["variances"][mode_indices]
    )


def _reference(model: ShapeModel, size: Floats, support: Floats, contrast: Ints, learns: bool) -> Reference:
    """The arrays; a model that learns has room for `MODES` from the start: no array changes its shape."""
    modes, variances = model.modes, model.variances
    if learns:
        room = MODES - len(modes)
        modes = np.concatenate([modes, np.zeros((room, model.mean.size))])
        variances = np.concatenate([variances, np.zeros(room)])
    return {
        "mean": np.array(model.mean),
        "modes": np.ascontiguousarray(modes),
        "variances": np.array(variances),
        "size": np.array(size, dtype=np.float64),
        "support": np.array(support, dtype=np.float64),
        "contrast": contrast,
    }


def _make(parameters: ShapeParameters) -> ShapeCue:
    import cv2  # noqa: F401  (loaded when tracking starts, not at the first frame)

    from bayesnet_track.vision.kernels import shape_kernels  # noqa: F401

    model = None if parameters.model is None else load_model(parameters.model)
    return ShapeCue(parameters, EdgePlane(parameters.edge_gray, parameters.blur_px), model)


CUE = CueDeclaration(
    name="shape",
    summary="Silhouette inside the box, compared with a shape model.",
    parameters=ShapeParameters,
    make=_make,
    cost_ms=16.0,
    files=lambda parameters: () if parameters.model is None else (model_path(parameters.model),),
    adapts=True,
)
