"""Views: where hypotheses in metres appear in an image, and what is measured there of their states."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from statistics import NormalDist

import numpy as np

from bayesnet_track.graph.checked import CLOCK, CheckedTarget, LastingError
from bayesnet_track.graph.checks.plates import FURTHER
from bayesnet_track.graph.settings.cameras import Coordinate, Size
from bayesnet_track.inference.queries import inside_polygon
from bayesnet_track.numerics.arrays import Floats, Ints
from bayesnet_track.numerics.cameras import UNSEEN
from bayesnet_track.numerics.outlines import GroundView, SeveralViews, cut_covariance, most_probable
from bayesnet_track.numerics.records import evolve
from bayesnet_track.observation.cue import Hypotheses, Measurement
from bayesnet_track.observation.planes import Frame
from bayesnet_track.observation.protocols import BOX, Seen

VELOCITY = ("vx", "vy")
"""Fields of a velocity on the ground, those after the box."""

REACH = 3.0
"""Centres lie within so many frames of the image, and boxes are so many frames large at most."""


@dataclass(frozen=True, eq=False)
class View:
    """A node whose hypotheses are those of `given_from` as its camera sees them.

    Attributes:
        node: its name.
        given_from: the node that has the state.
        camera: what it looks through.
        seen_by: the camera's name.
        lasting: errors that last, of all views of the plate and of agents below them.
        sd_velocity: of the noise of velocities, m/s in one second.
        z: column of z in a state in space, before that of its velocity; None of one on the ground.
    """

    node: str
    given_from: str
    camera: GroundView
    seen_by: str
    lasting: tuple[LastingError, ...] = ()
    sd_velocity: float = 0.0
    z: int | None = None

    @cached_property
    def fields(self) -> tuple[str, ...]:
        """Fields of a state that say where a target is and how large."""
        return BOX if self.z is None else (*BOX, "z")

    @cached_property
    def columns(self) -> slice | list[int]:
        """The columns of these fields in states."""
        return slice(0, 4) if self.z is None else [0, 1, 2, 3, self.z]

    @cached_property
    def velocity(self) -> tuple[str, ...]:
        """Fields of the velocity."""
        return VELOCITY if self.z is None else (*VELOCITY, "vz")

    @cached_property
    def speeds(self) -> list[int]:
        """The columns of the velocity in states."""
        return [4, 5] if self.z is None else [4, 5, self.z + 1]

    @cached_property
    def axes(self) -> list[int]:
        """Among `fields`, those that the velocity moves."""
        return [0, 1] if self.z is None else [0, 1, 4]

    def boxes(self, states: Mapping[str, Floats], agent: str = "") -> Floats:
        """(N, 4) boxes in the image of states, field -> (N,), as the camera shows and `agent` finds them."""
        shifted = np.empty((len(states[BOX[0]]), len(self.fields)))
        for column, name in enumerate(self.fields):  # a fifth of the time of `np.stack`
            shifted[:, column] = states[name]
        if self.clock is not None:  # it shows how targets were by so much earlier
            shifted[:, self.axes] -= states[self.clock][:, None] * np.stack(
                [states[name] for name in self.velocity], axis=1
            )
        boxes = self.camera.boxes(shifted)
        for place, column, side in _errors_of(self, agent):
            boxes[:, column] += states[self.lasting[place].field] * (1.0 if side is None else boxes[:, side])
        return boxes

    def linearise(self, states: Floats, agent: str = "") -> tuple[Floats, Floats]:
        """(N, 4) boxes of states (N, D), as `boxes` has them, and their derivatives (N, 4, D)."""
        size = states.shape[1]
        shifted = states[:, self.columns]
        offset = None if self.clock is None else self.column(self.clock, size)
        if offset is not None:
            shifted = shifted.copy()
            shifted[:, self.axes] -= states[:, offset : offset + 1] * states[:, self.speeds]
        boxes, slopes = self.camera.boxes(shifted), np.zeros((len(states), 4, size))
        slopes[:, :, self.columns] = by_place = self.camera.jacobian(shifted)
        if offset is not None:
            along = by_place[:, :, self.axes]
            slopes[:, :, self.speeds] = -states[:, offset, None, None] * along
            slopes[:, :, offset] = -(along @ states[:, self.speeds, None])[:, :, 0]
        first = size - len(self.lasting)
        for place, column, side in _errors_of(self, agent):
            errors, scale = states[:, first + place], 1.0 if side is None else boxes[:, side].copy()
            if side is not None:
                slopes[:, column] += errors[:, None] * slopes[:, side]
            slopes[:, column, first + place] += scale
            boxes[:, column] += errors * scale
        return boxes, slopes

    @cached_property
    def clock(self) -> str | None:
        """The field of the state that says by how much the times of its camera are late; None: by nothing."""
        fields = (error.field for error in self.lasting if error.node == self.node and error.axis == CLOCK)
        return next(fields, None)

    def box_quantities(
        self, agent: str, variances: Callable[[Floats], Floats] | None = None, width: int = 4
    ) -> Seen:
        """Box of a state as a measurement; `variances` (T, 4) -> (T, 4) are those of its errors.

        The first `width` numbers of it: 2 of a point.
        """
        box = Seen(
            partial(self.boxes, agent=agent),
            np.full(len(BOX), np.inf),
            self.shared,
            None if self.clock is None else self.beyond,
            linearise=partial(self.linearise, agent=agent),
        )
        if width < len(BOX):
            return _point_of(self, box, agent, width)
        if variances is None:
            return box
        return evolve(box, covariance=lambda expected: variances(expected)[:, :, None] * np.eye(len(BOX)))

    def beyond(self, mean: Floats, covariance: Floats) -> tuple[Floats, Floats]:
        """(4,) and (4, 4) what the derivative leaves out of the box of a state N(mean, covariance).

        The camera shows x(t - o), with o the offset of its clock. That is x - o v, whose second moments have
        Cov(o, v) and P_oo P_vv + P_ov P_vo, and what v changed since: q |o|^3 / 3 of white noise q.
        """
        if self.clock is None:
            return np.zeros(4), np.zeros((4, 4))
        column = self.column(self.clock, len(mean))
        offset, variance = float(mean[column]), float(covariance[column, column])
        expected, with_speed = mean[None, self.columns].copy(), covariance[self.speeds, column]
        expected[:, self.axes] -= offset * mean[self.speeds] + with_speed
        slopes = self.camera.jacobian(expected)[0][:, self.axes]
        if not np.isfinite(slopes).all():
            return np.zeros(4), np.zeros((4, 4))
        of_speeds = covariance[self.speeds][:, self.speeds]
        spread = variance * of_speeds + np.outer(with_speed, with_speed)
        drift = self.sd_velocity**2 * (offset**2 + variance) ** 1.5 / 3.0
        return -slopes @ with_speed, slopes @ (spread + drift * np.eye(len(spread))) @ slopes.T

    def column(self, field: str, size: int) -> int:
        """The column of a lasting error in states of so many fields."""
        return size - len(self.lasting) + [error.field for error in self.lasting].index(field)

    @property
    def shared(self) -> tuple[str, ...]:
        """Fields of the state that are allowed for and not estimated."""
        return tuple(error.field for error in self.lasting if error.is_by_place)

    def project(self, ground: Hypotheses, frame: Frame) -> Hypotheses:
        """Hypotheses as boxes in its image; see `visible_boxes`.

        Further fields of the state, such as velocities, are in metres, and have no place there.
        """
        states = {**ground.fields, **dict(zip(BOX, ground.boxes.T, strict=True))}
        return Hypotheses(visible_boxes(self.boxes(states), size_in(frame, self.seen_by, self.camera)))


def _point_of(view: View, box: Seen, agent: str, width: int) -> Seen:
    """The first quantities of a box."""

    def linearise(states: Floats) -> tuple[Floats, Floats]:
        boxes, slopes = view.linearise(states, agent)
        return boxes[:, :width], slopes[:, :width]

    def beyond(mean: Floats, covariance: Floats) -> tuple[Floats, Floats]:
        shift, spread = view.beyond(mean, covariance)
        return shift[:width], spread[:width, :width]

    return evolve(
        box,
        function=lambda states: box.function(states)[:, :width],
        periods=box.periods[:width],
        beyond=None if box.beyond is None else beyond,
        linearise=linearise,
    )


@lru_cache(maxsize=256)
def _errors_of(view: View, agent: str) -> tuple[tuple[int, int, int | None], ...]:
    """Errors of a view and an agent: place among those that last, coordinate of the box, side that scales it.

    An error without such a side is in px.
    """
    errors = ((place, error) for place, error in enumerate(view.lasting) if error.node in (view.node, agent))
    columns = ((place, error, error.column) for place, error in errors if not error.is_clock)
    return tuple((place, k, None if error.is_px else 2 + k % 2) for place, error, k in columns)


def effects(error: LastingError, boxes: Floats) -> Floats:
    """(N, 4) by how much boxes in the image change with an error."""
    change = np.zeros_like(boxes)
    if error.is_clock:  # it moves what moves, by the velocity: a box alone has none
        return change
    column = error.column
    change[:, column] = 1.0 if error.is_px else boxes[:, 2 + column % 2]
    return change


def size_in(frame: Frame, name: str, camera: GroundView) -> tuple[int, int]:
    """Columns and rows of the image of a camera, also where it has no frame at this time."""
    image = frame.of(name)
    if image is None:
        return camera.size or (frame.width, frame.height)
    return image.width, image.height


def visible_boxes(boxes: Floats, frame: tuple[int, int]) -> Floats:
    """(N, 4) centre boxes as far as they are near an image of `frame` columns and rows; else `UNSEEN`.

    Sides are at least 1 px.
    """
    size = np.array([*frame, *frame], dtype=np.float64)
    is_finite = np.isfinite(boxes).all(axis=1, keepdims=True)
    with np.errstate(invalid="ignore"):
        clipped = np.clip(boxes, [-REACH, -REACH, 0.0, 0.0] * size, REACH * size)
    np.maximum(clipped[:, 2:], 1.0, out=clipped[:, 2:])
    return np.where(is_finite, clipped, np.array(UNSEEN))


def through(
    view: View,
    measured: Measurement,
    agent: str = "",
    variances: Callable[[Floats], Floats] | None = None,
) -> Measurement:
    """Measurement of the box in the image by `agent`, as a measurement of the state on the ground.

    Errors are those that a detection of the expected box has (`variances`, (T, 4) -> (T, 4)): a detection
    that is large by chance would count less than one that is small by chance, and the belief be pulled.
    """
    if measured.fields == BOX and measured.seen is None:
        return _box_through(measured, view.box_quantities(agent, variances), view.camera)
    if measured.fields == BOX[:2] and measured.seen is None and measured.errors is None:
        point = view.box_quantities(agent, width=2)
        choices = tuple((weight, evolve(choice, seen=point)) for weight, choice in measured.choices)
        return evolve(measured, seen=point, choices=choices)
    inner, errors = measured.seen, measured.errors
    columns = None if inner is not None else [BOX.index(name) for name in measured.fields]

    def in_image(states: Mapping[str, Floats]) -> dict[str, Floats]:
        return dict(zip(BOX, view.boxes(states, agent).T, strict=True))

    def function(states: Mapping[str, Floats]) -> Floats:
        if inner is not None:
            return inner.function(in_image(states))
        return view.boxes(states, agent)[:, columns]

    if errors is not None:
        of_boxes = errors.function
        errors = replace(errors, function=lambda states, away: of_boxes(in_image(states), away))
    periods = np.full(len(measured.fields), np.inf) if inner is None else inner.periods
    choices = tuple((weight, through(view, choice, agent, variances)) for weight, choice in measured.choices)
    return replace(measured, seen=Seen(function, periods, view.shared), choices=choices, errors=errors)


def _box_through(measured: Measurement, box: Seen, camera: GroundView) -> Measurement:
    """Measurement of a box with its choices, whose quantities are those of a state's `box`."""
    boxes = np.array([measured.mean, *(choice.mean for _, choice in measured.choices)])
    cuts = cut_covariance(camera, boxes)
    is_cut: list[bool] = np.any(cuts, axis=(1, 2)).tolist()

    def of_state(row: int, choice: Measurement) -> Measurement:
        if not is_cut[row]:
            return evolve(choice, seen=box)
        return evolve(
            choice, seen=evolve(box, extra_covariance=cuts[row]), covariance=choice.covariance + cuts[row]
        )

    choices = tuple(
        (weight, of_state(row, choice)) for row, (weight, choice) in enumerate(measured.choices, 1)
    )
    return evolve(of_state(0, measured), choices=choices)


Start = tuple[tuple[float, float] | None, ...]
"""Mean and sd of x, y, w, h and, in space, z of targets that start; None of what nothing is known of."""


@dataclass(frozen=True, eq=False)
class Placed:
    """Places on the ground, or in space, of boxes in an image.

    Attributes:
        which: (M,) the boxes that stand somewhere.
        states: (M, K) x, y, w, h in m, and z in space.
        covariances: (M, K, K).
        cross: (M, K, L) of the states and L errors that last.
    """

    which: Ints
    states: Floats
    covariances: Floats
    cross: Floats


def place(views: Sequence[View], boxes: Floats, variances: Floats, start: Start, agent: str = "") -> Placed:
    """The most probable states of targets seen as boxes (N, 4) with errors of variances (N, 4), px.

    Boxes of several views stand beside each other. What targets are before one is seen, `start` says;
    otherwise places are equally probable. As of `most_probable`, with errors of the views and of the `agent`
    that last in R: each moves the state by -K g, K = covariance J' R^-1 and g its effect on the box.
    """
    camera = views[0].camera if len(views) == 1 else SeveralViews([view.camera for view in views])
    errors, lasting = views[0].lasting, np.zeros((*boxes.shape, len(views[0].lasting)))
    for first, view in enumerate(views):
        columns = slice(4 * first, 4 * first + 4)
        for k, error in enumerate(errors):
            if error.node in (view.node, agent):
                lasting[:, columns, k] = effects(error, boxes[:, columns])
    of_lasting = np.array([error.sd**2 for error in errors])
    variances = variances + (lasting**2 @ of_lasting if len(of_lasting) else 0.0)
    spreads = np.array([np.inf if axis is None else axis[1] for axis in start])
    means = np.array([float(k in (2, 3)) if axis is None else axis[0] for k, axis in enumerate(start)])
    with np.errstate(all="ignore"):
        states, covariances, precision, usable = most_probable(camera, boxes, variances, (means, spreads))
        if views[0].z is None:
            usable &= np.sqrt(covariances[:, 0, 0] + covariances[:, 1, 1]) < FARTHEST
    rows = np.flatnonzero(usable)
    weighted = np.swapaxes(camera.jacobian(states[rows]), 1, 2) @ precision[rows]
    cross = -covariances[rows] @ weighted @ lasting[rows] * of_lasting
    return Placed(rows, states[rows], covariances[rows], cross)


FARTHEST = 25.0
"""A box that says where it stands with a larger error than so many metres is too near the horizon."""

GIVEN_SD = 0.05
"""Error of a box that somebody gives as a start, as a share of its sides."""


_QUANTILES = np.array([NormalDist().inv_cdf((k + 0.5) / 12) for k in range(12)])
"""Places in units of sds that a Gaussian has equal shares around."""


@dataclass(frozen=True, eq=False)
class Views:
    """The cameras of a plate, which stand between its states in metres and boxes in an image.

    Attributes:
        views: the views by name; the first one is that of the image in results.
        start: what is known of targets that start.
        area: (C, 2) corners of the ground on which detections become targets, m; None: anywhere.
    """

    views: Mapping[str, View]
    start: Start
    area: Floats | None = None

    @property
    def main(self) -> View:
        """The view of the image in results."""
        return next(iter(self.views.values()))

    @property
    def lasting(self) -> tuple[LastingError, ...]:
        """Errors that last: the last columns of a state."""
        return self.main.lasting

    def named(self, states: Floats) -> dict[str, Floats]:
        """The fields of states (N, D) that a box in an image depends on."""
        main = self.main
        columns = dict(zip(main.fields, states[:, main.columns].T, strict=True))
        if any(error.is_clock for error in self.lasting):
            columns |= dict(zip(main.velocity, states[:, main.speeds].T, strict=True))
        errors = states[:, states.shape[1] - len(self.lasting) :].T
        return columns | {error.field: errors[k] for k, error in enumerate(self.lasting)}

    def boxes(self, states: Floats, frame: Frame, node: str | None = None) -> Floats:
        """(N, 4) boxes of states (N, D) in the image of a view, by default the first one."""
        view = self.main if node is None else self.views[node]
        return visible_boxes(view.boxes(self.named(states)), size_in(frame, view.seen_by, view.camera))

    def footprints(self, states: Floats) -> Floats:
        """(N, 4) the squares that targets (N, D) cover of the ground, m, centre first."""
        return states[:, [0, 1, 2, 2]]

    def shares_in_area(self, means: Floats, covariances: Floats) -> Floats:
        """(T,) probabilities that targets (T, D), (T, D, D) stand where detections may become targets."""
        if self.area is None:
            return np.ones(len(means))
        unit = np.array(np.meshgrid(_QUANTILES, _QUANTILES)).reshape(2, -1).T
        lower = np.linalg.cholesky(covariances[:, :2, :2] + 1e-12 * np.eye(2))
        points = unit @ lower.swapaxes(1, 2) + means[:, None, :2]
        return np.asarray(inside_polygon(self.area, points[..., 0], points[..., 1]).mean(axis=1))

    def place(self, box: Floats) -> Placed | None:
        """Place of a target in a given centre box (4,); None above the horizon."""
        sds = GIVEN_SD * np.array([box[2], box[3], box[2], box[3]])
        placed = place([self.main], box[None], sds[None] ** 2, self.start)
        return placed if len(placed.which) else None

    def moments(self, mean: Floats, covariance: Floats, frame: Frame) -> tuple[Floats, Floats]:
        """(4,) box and (4, 4) covariance in the image of a state N(mean, covariance), by the derivative."""
        box, slopes = self.boxes(mean[None], frame)[0], self.main.linearise(mean[None])[1][0]
        if not np.isfinite(slopes).all():
            return box, np.zeros((4, 4))
        return box, slopes @ covariance @ slopes.T


def views_of(plate: CheckedTarget) -> Views | None:
    """The cameras of a plate; None of a state in pixels."""
    state = plate.spec.state
    if isinstance(state, str):
        return None
    views = {view.node: view for view in views_below(plate)}
    if state.space is not None:
        size = state.space.size
        axes = (state.space.x, state.space.y, size, size, state.space.z)
        return Views(views, _start_of(axes))
    assert state.ground is not None
    area = None if state.ground.area is None else np.array(state.ground.area, dtype=np.float64)
    return Views(views, _start_of((None, None, state.ground.width, state.ground.height)), area)


def _start_of(axes: Sequence[Size | Coordinate | None]) -> Start:
    return tuple(None if axis is None else (axis.mean, axis.sd) for axis in axes)


def views_below(plate: CheckedTarget) -> tuple[View, ...]:
    """The views of a plate."""
    if not plate.views:
        return ()
    motion = plate.inference(plate.root).motion
    noise = 0.0 if motion is None else float(getattr(motion.settings, "sd_velocity_px", None) or 0.0)
    z = len(BOX) + len(FURTHER.get(motion.kind, ())) if plate.spec.is_space and motion else None
    return tuple(
        View(node, plate.root, view.camera, view.name, plate.lasting, noise, z)
        for node, view in plate.views.items()
    )
