"""Settings of cameras, of states on the ground in metres, and of inputs beside the image."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from bayesnet_track.graph.settings.base import Choice, Model, Name, NotNegative, Number, Positive
from bayesnet_track.graph.settings.queries import MOST_CORNERS, Point

METRES = {
    "sd_px": "sd",
    "sd_velocity_px": "sd_velocity",
    "start_velocity_sd_px": "start_velocity_sd",
    "sd_acceleration_px": "sd_acceleration",
    "start_acceleration_sd_px": "start_acceleration_sd",
}
"""Key of a motion in pixels -> the same key of a motion on the ground, in metres and seconds."""


class MetreSd(Model):
    """Standard deviations in metres, for a step of one second."""

    x: NotNegative = Field(default=0.0, description="of the foot point's x, m")
    y: NotNegative = Field(default=0.0, description="of the foot point's y, m")
    w: NotNegative = Field(default=0.0, description="of the width, m")
    h: NotNegative = Field(default=0.0, description="of the height, m")
    z: NotNegative = Field(default=0.0, description="of z, m; of states in space")


class CameraBias(Model):
    """Error of where a camera sees things, which lasts: of its calibration.

    Example::

        bias_px: {sd: 5, sd_by_place: 15}
    """

    sd: Positive = Field(
        description="of the shift along x, and of that along y, that all targets share, px; it is learnt "
        "where several cameras see them"
    )
    sd_by_place: NotNegative = Field(
        default=0.0,
        description="of a further shift that differs from place to place, as of a lens that is off, px: each "
        "target has one of its own, which intervals allow for",
    )
    over_s: Positive = Field(default=3600.0, description="time in which its correlation falls to 1 / e, s")


class Spread(Model):
    """Prior of a number that is to be learnt: N(0, sd^2)."""

    sd: Positive = Field(description="standard deviation")


class CameraClock(Model):
    """Clock of a camera, which is learnt from all targets: its times are `offset_s` late, more by `rate`.

    Example::

        clock: {offset_s: {sd: 0.2}, rate: {sd: 1.0e-5}}
    """

    offset_s: Spread = Field(
        description="by how much the times of its frames are later than those of the first camera, s"
    )
    rate: Spread | None = Field(
        default=None, description="by how much the offset grows per second; default: it does not"
    )


class CameraSource(Model):
    """A camera that targets on the ground are seen by.

    Example::

        cameras:
          north: {calibration: cameras/north.yaml}
    """

    calibration: Annotated[str, Field(min_length=1, max_length=1000)] = Field(
        description="file of its lens and pose, or of the homography of the ground "
        "([what can be read](metres.md)); a path from where the graph file is"
    )
    name: Name | None = Field(default=None, description="which camera, where the file has several")
    bias_px: CameraBias | None = Field(
        default=None,
        description="how far off it may be: a shift of the image that lasts, and is learnt; "
        "default: the calibration is exact",
    )
    clock: CameraClock | None = Field(
        default=None,
        description="how far its clock may be off, which is learnt; not of the first camera, whose clock is "
        "that of the run; default: it is that of the first camera",
    )

    cost: Positive = Field(
        default=1.0, description="declared cost of one of its frames, in any unit, where cameras are switched"
    )

    @property
    def key(self) -> str:
        """Name of the camera and its file: ``FILE``, or ``FILE#NAME``."""
        return self.calibration if self.name is None else f"{self.calibration}#{self.name}"


class AdaptCameras(Model):
    """Cameras are switched step by step: on are those of the largest expected gain per declared cost.

    A camera that is off is not looked at. The gain is the expected fall of the root of UD, m, summed over
    targets, and `undetected_m` for each that is expected to be detected for the first time.

    Example::

        adapt: {cost_per_step: 1}
    """

    cost_per_step: Positive = Field(
        description="declared cost that a step may take, the sum of `cost` of its cameras; what is not spent "
        "is saved, up to twice that of the most expensive camera"
    )
    undetected_m: Positive = Field(
        default=1.0,
        description="root of the UD that a target which no camera has detected yet counts as, m; no target "
        "counts as more",
    )


class Size(Model):
    """Size of targets before one is seen."""

    mean: Positive = Field(description="m")
    sd: Positive = Field(description="m")


class Ground(Model):
    """Targets that stand on a plane, z = 0 of the calibrations."""

    unit: Literal["m"] = Field(default="m", description="of x, y, w and h")
    width: Size | None = Field(
        default=None, description="of targets that start; default: as the first box says"
    )
    height: Size | None = Field(default=None, description="the same of the height")
    area: Annotated[tuple[Point, ...], Field(min_length=3, max_length=MOST_CORNERS)] | None = Field(
        default=None,
        description="corners [x, y] of the ground on which detections become targets, m: what stands outside "
        "is followed as a candidate until it steps in; default: anywhere",
    )

    @model_validator(mode="after")
    def _area_is_wide(self) -> Self:
        corners = self.area or ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
        ways = zip(corners, (*corners[1:], corners[0]), strict=True)
        if not abs(sum(a[0] * b[1] - b[0] * a[1] for a, b in ways)) > 0.0:
            raise ValueError("area with an inside: its corners are in a line")
        return self


class Coordinate(Model):
    """Prior of a coordinate of targets that start: N(mean, sd^2)."""

    mean: Number = Field(description="m")
    sd: Positive = Field(description="m")


class Space(Model):
    """Targets anywhere in space, as large across as high.

    A camera alone sees how far away one is by its size; where detections have none, `x`, `y` and `z` say
    where it may be, before other cameras do.

    Example::

        state: {space: {size: {mean: 0.5, sd: 0.1}}}
    """

    unit: Literal["m"] = Field(default="m", description="of x, y, z, w and h")
    size: Size = Field(description="of targets, across and high, before one is seen")
    x: Coordinate | None = Field(default=None, description="of targets that start; default: anywhere")
    y: Coordinate | None = Field(default=None, description="the same of y")
    z: Coordinate | None = Field(default=None, description="the same of z")


class WorldState(Choice):
    """A state in the world, which cameras see by `view` nodes.

    Example::

        state: {ground: {unit: m}}
    """

    ground: Ground | None = Field(
        default=None,
        description="x, y: foot point on the ground, w, h: width and height, all in metres; velocities in "
        "metres per second. `dt` and all numbers of the graph that count frame intervals count seconds",
    )
    space: Space | None = Field(
        default=None,
        description="x, y, z: centre, w, h: width and height, in metres: the same in space",
    )


MOST_INPUTS = 32


class FrameInput(Model):
    """A column of a CSV file as a name in expressions, by frame or by time: a pan angle, a gyro's rate.

    The name has the value of the frame, and the name with `_before` behind it that of the frame before.

    Example::

        inputs: {pan: {file: camera.csv}}
    """

    file: str = Field(
        min_length=1,
        max_length=1000,
        description="CSV file (path) with a column `frame` (from 0) or `time_s`, in rising order, and one of "
        "the input",
    )
    column: str | None = Field(default=None, max_length=200, description="its column; default: its name")
    between: Literal["linear", "nearest", "previous"] = Field(
        default="linear", description="its value in a frame between two rows"
    )

    def column_of(self, name: str) -> str:
        """The column of the input of this name."""
        return name if self.column is None else self.column


Inputs = dict[Name, FrameInput]
