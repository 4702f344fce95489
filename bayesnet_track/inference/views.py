"""Views: where hypotheses on the ground appear in an image, and what is measured there of the ground."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from bayesnet_track.graph.checked import CheckedTarget, NamedCamera
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.cameras import GroundView
from bayesnet_track.observation.cue import Hypotheses, Measurement
from bayesnet_track.observation.planes import Frame
from bayesnet_track.observation.protocols import BOX, Seen

UNSEEN = (-1e4, -1e4, 1.0, 1.0)
"""The box of a hypothesis that the camera cannot see: no pixel of any frame."""

REACH = 3.0
"""Centres lie within so many frames of the image, and boxes are so many frames large at most."""


@dataclass(frozen=True, eq=False)
class View:
    """A node whose hypotheses are those of `given_from` as its camera, called `seen_by`, sees them."""

    node: str
    given_from: str
    camera: GroundView
    seen_by: str

    def project(self, ground: Hypotheses, frame: Frame) -> Hypotheses:
        """Hypotheses as boxes in its image; see `visible_boxes`.

        Further fields of the state, such as velocities, are in metres, and have no place there.
        """
        return Hypotheses(visible_boxes(self.camera, ground.boxes, size_in(frame, self.seen_by, self.camera)))


def size_in(frame: Frame, name: str, camera: GroundView) -> tuple[int, int]:
    """Columns and rows of the image of a camera, also where it has no frame at this time."""
    own = frame.of(name)
    if own is None:
        return camera.size or (frame.width, frame.height)
    return own.width, own.height


def visible_boxes(camera: GroundView, ground: Floats, frame: tuple[int, int]) -> Floats:
    """(N, 4) centre boxes in an image of `frame` columns and rows of targets (N, 4) on the ground.

    Sides are at least 1 px; a target that the camera cannot see is `UNSEEN`.
    """
    boxes = camera.boxes(ground)
    size = np.array([*frame, *frame], dtype=np.float64)
    seen = np.isfinite(boxes).all(axis=1, keepdims=True)
    with np.errstate(invalid="ignore"):
        held = np.clip(boxes, [-REACH, -REACH, 0.0, 0.0] * size, REACH * size)
    np.maximum(held[:, 2:], 1.0, out=held[:, 2:])
    return np.where(seen, held, np.array(UNSEEN))


def through(camera: GroundView, measured: Measurement) -> Measurement:
    """What was measured of the box in the image, as a measurement of the state on the ground."""
    inner, errors = measured.seen, measured.errors
    columns = None if inner is not None else [BOX.index(name) for name in measured.fields]

    def in_image(states: Mapping[str, Floats]) -> dict[str, Floats]:
        boxes = camera.boxes(np.stack([states[name] for name in BOX], axis=1))
        return dict(zip(BOX, boxes.T, strict=True))

    def function(states: Mapping[str, Floats]) -> Floats:
        if inner is not None:
            return inner.function(in_image(states))
        return np.stack([*in_image(states).values()], axis=1)[:, columns]

    if errors is not None:
        of_boxes = errors.function
        errors = replace(errors, function=lambda states, away: of_boxes(in_image(states), away))
    periods = np.full(len(measured.fields), np.inf) if inner is None else inner.periods
    choices = tuple((weight, through(camera, one)) for weight, one in measured.choices)
    return replace(measured, seen=Seen(function, periods), choices=choices, errors=errors)


Sizes = tuple[tuple[float, float] | None, tuple[float, float] | None]
"""Mean and sd of the width and of the height of targets before one is seen; None where nothing is known."""

STEPS = 30
CLOSE = 1e-9


@dataclass(frozen=True, eq=False)
class Placed:
    """Where boxes in an image stand on the ground.

    Attributes:
        which: (M,) the boxes that stand somewhere.
        states: (M, 4) x, y, w, h in m.
        covariances: (M, 4, 4).
    """

    which: Ints
    states: Floats
    covariances: Floats


def place(camera: GroundView, boxes: Floats, variances: Floats, sizes: Sizes) -> Placed:
    """The most probable states of targets seen as boxes (N, 4) with errors of variances (N, 4), px.

    Foot points are equally probable anywhere on the ground; sizes as `sizes` say. By Gauss and Newton's steps
    from the foot of the box; the covariance is (J' R^-1 J + P^-1)^-1.
    """
    feet = camera.ground_points(np.column_stack([boxes[:, 0], boxes[:, 1] + boxes[:, 3] / 2]))
    prior = np.array([0.0 if one is None else one[1] ** -2 for one in (None, None, *sizes)])
    usual = np.array([0.0, 0.0, *(1.0 if one is None else one[0] for one in sizes)])
    states = np.column_stack([feet, np.tile(usual[2:], (len(boxes), 1))])
    with np.errstate(all="ignore"):
        first = camera.boxes(states)
        for k in (2, 3):
            if sizes[k - 2] is None:
                states[:, k] *= boxes[:, k] / first[:, k]
        information, pull = _normal(camera, states, boxes, variances, prior, usual)
        for _ in range(STEPS):
            step = _solve(information, pull)
            states[:, :2] += step[:, :2]
            states[:, 2:] = np.maximum(states[:, 2:] + step[:, 2:], states[:, 2:] / 4)  # sizes stay positive
            information, pull = _normal(camera, states, boxes, variances, prior, usual)
            if not (np.abs(step) > CLOSE).any():
                break
        covariances = _inverse(information)
        done = np.abs(_solve(information, pull)).max(axis=1) < 1e-4
        usable = done & np.isfinite(states).all(axis=1) & np.isfinite(covariances).all(axis=(1, 2))
        usable &= np.sqrt(covariances[:, 0, 0] + covariances[:, 1, 1]) < FARTHEST
    which = np.flatnonzero(usable)
    return Placed(which, states[which], covariances[which])


FARTHEST = 25.0
"""A box that says where it stands with a larger error than so many metres is too near the horizon."""


def _normal(
    camera: GroundView, states: Floats, boxes: Floats, variances: Floats, prior: Floats, usual: Floats
) -> tuple[Floats, Floats]:
    """(N, 4, 4) information, and (N, 4) slopes of the log density."""
    slopes = camera.jacobian(states)
    weighted = np.swapaxes(slopes / variances[:, :, None], 1, 2)
    away = boxes - camera.boxes(states)
    pull = (weighted @ away[:, :, None])[:, :, 0] + prior * (usual - states)
    return weighted @ slopes + np.diag(prior), pull


def _inverse(information: Floats) -> Floats:
    """(N, 4, 4) inverses; NaN where there is none."""
    scale = np.sqrt(np.diagonal(information, axis1=1, axis2=2))
    scaled = information / (scale[:, :, None] * scale[:, None, :])
    usable = np.isfinite(scaled).all(axis=(1, 2))
    scaled[~usable] = np.eye(4)
    usable &= np.abs(np.linalg.det(scaled)) > 1e-10
    scaled[~usable] = np.eye(4)
    inverse = np.linalg.inv(scaled) / (scale[:, :, None] * scale[:, None, :])
    return np.where(usable[:, None, None], (inverse + np.swapaxes(inverse, 1, 2)) / 2, np.nan)


def _solve(information: Floats, pull: Floats) -> Floats:
    return np.asarray((_inverse(information) @ pull[:, :, None])[:, :, 0])


GIVEN_SD = 0.05
"""Error of a box that somebody gives as a start, as a share of its sides."""


@dataclass(frozen=True, eq=False)
class Views:
    """The cameras of a plate, which stand between its states on the ground and boxes in an image.

    Attributes:
        cameras: view -> its camera; the first one is that of the image in results.
        sizes: of targets that start.
    """

    cameras: Mapping[str, NamedCamera]
    sizes: Sizes

    @property
    def main(self) -> GroundView:
        """The camera of the image in results."""
        return self._first.camera

    @property
    def _first(self) -> NamedCamera:
        return next(iter(self.cameras.values()))

    def boxes(self, states: Floats, frame: Frame, node: str | None = None) -> Floats:
        """(N, 4) boxes of states (N, D) in the image of a view, by default the first one."""
        seen_by = self._first if node is None else self.cameras[node]
        return visible_boxes(seen_by.camera, states[:, :4], size_in(frame, seen_by.name, seen_by.camera))

    def footprints(self, states: Floats) -> Floats:
        """(N, 4) the squares that targets (N, D) cover of the ground, m, centre first."""
        return states[:, [0, 1, 2, 2]]

    def place(self, box: Floats) -> tuple[Floats, Floats] | None:
        """(4,) state and (4, 4) covariance of a target in a given centre box (4,); None above the horizon."""
        sds = GIVEN_SD * np.array([box[2], box[3], box[2], box[3]])
        placed = place(self.main, box[None], sds[None] ** 2, self.sizes)
        return (placed.states[0], placed.covariances[0]) if len(placed.which) else None

    def moments(self, mean: Floats, covariance: Floats, frame: Frame) -> tuple[Floats, Floats]:
        """(4,) box and (4, 4) covariance in the image of a state N(mean, covariance), by the derivative."""
        box = self.boxes(mean[None], frame)[0]
        slopes = self.main.jacobian(mean[None, :4])[0]
        if not np.isfinite(slopes).all():
            return box, np.zeros((4, 4))
        return box, slopes @ covariance[:4, :4] @ slopes.T


def views_of(plate: CheckedTarget) -> Views | None:
    """The cameras of a plate; None of a state in pixels."""
    state = plate.spec.state
    if isinstance(state, str) or state.ground is None:
        return None
    sizes = [None if one is None else (one.mean, one.sd) for one in (state.ground.width, state.ground.height)]
    return Views(plate.views, (sizes[0], sizes[1]))
