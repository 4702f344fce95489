"""Setting of the posterior over who is who."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from bayesnet_track.graph.settings.base import FrameCount, Model, NotNegative, Number


class Identity(Model):
    """Who is who gets a probability: targets that come close may part under each other's names.

    From when two targets expect each other's detections until they have been apart for `settle` frames, every
    assignment of detections to them is kept with its probability, for up to four targets at once. Further
    ones that come close meanwhile keep their names, and are not asked about.
    """

    settle: FrameCount = Field(default=8, description="frames apart after which who is who is settled")
    appearance: NotNegative = Field(
        default=0.1,
        description="exponent of the likelihood of what a target looked like before they met, in each frame: "
        "those of neighbouring frames tell much the same",
    )
    report_above: Annotated[Number, Field(gt=0, lt=1)] = Field(
        default=0.05, description="probability of another identity from which on the log says it"
    )
