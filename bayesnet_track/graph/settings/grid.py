"""The settings of the grid belief."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from bayesnet_track.graph.settings.base import Model, Number, Positive, Whole


def _odd(count: int) -> int:
    if count % 2 == 0:
        raise ValueError("an odd number, so that there is a middle cell")
    return count


Odd = Annotated[Whole, Field(ge=3, le=63, json_schema_extra={"not": {"multipleOf": 2}}), AfterValidator(_odd)]


class Reset(Model):
    """What happens when a frame's evidence is not feasible under the predicted belief.

    gamma = E L under the prediction / mean L over a region U (General Distribution Filter, eq. 5). Its value
    depends on U, and so does a suitable threshold: 1 for the belief's own bounding box; for the whole image
    the one at which a correct prediction would be reset in `false_rate` of the frames.
    """

    region: Literal["belief", "image"] = Field(
        default="belief", description="U: the bounding box of the predicted belief, or the whole image"
    )
    below: Positive | None = Field(
        default=None, description="gamma below which it happens; default 1 for the region belief"
    )
    false_rate: Annotated[Number, Field(gt=0, lt=0.5)] | None = Field(
        default=None,
        description="instead of `below`: share of frames in which a correct prediction is reset; default "
        "0.001 for the image",
    )
    then: Literal["reset", "ignore"] = Field(
        default="reset",
        description="start again from the frame's likelihood over U, or keep the prediction",
    )


class Grid(Model):
    """A discrete distribution over cells: the General Distribution Filter.

    The cells cover x and y, the velocity when the motion has one, and the size's logarithm when the motion
    has `sd_log.scale`; else the size stays that of the start box. Their window follows the prediction. Noise
    below about one cell is kept in mean and variance, but a belief narrower than a cell has no shape.
    """

    cell_px: Positive = Field(default=2.0, description="width and height of a cell, px")
    window: Annotated[Whole, Field(ge=8, le=512)] = Field(
        default=128,
        description="largest number of cells in x and in y; what lies further from the mean is cut off",
    )
    velocity_cells: Odd = Field(default=9, description="cells per axis of the velocity, odd")
    velocity_cell_px: Positive = Field(
        default=2.0, description="spacing of these cells, px per frame; the middle one is rest"
    )
    scale_cells: Odd = Field(
        default=7, description="cells of log sqrt(w h), odd; the middle one is the start"
    )
    scale_cell: Annotated[Number, Field(gt=0, le=1)] = Field(
        default=0.05, description="spacing of these cells"
    )
    cut: Annotated[Number, Field(ge=0, le=0.1)] = Field(
        default=1e-4, description="share of the prior's mass whose cells are not evaluated"
    )
    forget: Annotated[Number, Field(ge=1)] = Field(
        default=1.0, description="k: the prediction's density is raised to 1/k before each measurement"
    )
    reset: Reset | None = Field(
        default=None, description="what to do if evidence is not feasible; default: nothing"
    )
