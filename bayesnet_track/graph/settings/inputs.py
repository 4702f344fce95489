"""Settings of inputs: what is known of every frame beside its image."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from bayesnet_track.graph.settings.base import Model, Name

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
