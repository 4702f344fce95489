"""The settings of how probable it is that a target exists."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from bayesnet_track.graph.settings.base import Model, NotNegative, Number, Positive

Inner = Annotated[Number, Field(gt=0, lt=1)]


class Existence(Model):
    """Every target has a probability that it exists: births and ends are levels of it, instead of counts.

    It falls by `survival` from frame to frame, rises with a detection where the target is expected, the more
    the fewer false detections there are, and falls with every miss, the more the surer a detection was. What
    is detected and is no target yet has a probability, too, and becomes a target at `confirm`.
    `birth.confirm` has no effect then. Uniform over the image, and distributed in size as the detections are,
    false detections and new targets have a density in x, y, w, h.
    """

    detection: Inner | None = Field(
        default=None,
        description="probability that a target which nothing covers is detected; default: estimated",
    )
    covered: Inner | None = Field(
        default=None,
        description="the same while another target covers at least half of its box; default: estimated",
    )
    survival: Annotated[Number, Field(gt=0, le=1)] = Field(
        default=0.995, description="probability that a target is still there one frame interval later"
    )
    clutter: NotNegative | None = Field(
        default=None, description="false detections a frame, on average; default: estimated"
    )
    births: Positive = Field(default=0.1, description="new targets a frame, on average")
    confirm: Inner = Field(default=0.9, description="probability from which on it is a target")
    end: Inner = Field(default=0.05, description="probability below which a target ends")

    @model_validator(mode="after")
    def _end_below_confirm(self) -> Self:
        if self.end >= self.confirm:
            raise ValueError(f"end below confirm: {self.end:g} is not below {self.confirm:g}")
        return self
