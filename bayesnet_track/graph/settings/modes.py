"""The settings of modes: hidden discrete states of a target, with memory."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from bayesnet_track.graph.settings.base import Model, Name, Number, Positive
from bayesnet_track.graph.settings.motion import Motion

MOST_MODES = 8
"""Each mode has hypotheses, or a Gaussian, of its own."""


class Hidden(Model):
    """The target cannot be seen in this mode: what agents say is of the background.

    An agent that gives likelihoods gives every place the same one, `likelihood`. An agent that measures sees
    nothing, or with probability `mistaken` something else, anywhere in the frame. So nothing is learnt of
    where the target is, and references stay as they are.
    """

    likelihood: Annotated[Number, Field(gt=0, lt=1)] = Field(
        default=0.05,
        description="what an agent says of a place without the target, as a share of a perfect match; its "
        "temperature and its weight in pools hold for it, too",
    )
    mistaken: Annotated[Number, Field(gt=0, lt=1)] = Field(
        default=0.1, description="probability that an agent that measures takes something else for the target"
    )
    missed: Annotated[Number, Field(gt=0, lt=1)] = Field(
        default=0.1, description="probability that an agent that measures misses the target in other modes"
    )
    lost_above: Annotated[Number, Field(gt=0, lt=1)] = Field(
        default=0.5, description="probability of being hidden above which the target counts as lost"
    )


Row = Annotated[dict[Name, Positive], Field(min_length=1)]


class Mode(Model):
    """One of the discrete states: how the target moves in it, how long it lasts, and what follows.

    Either `mean_frames` with `then`, a chain in continuous time, or `next`, a row of the transition matrix of
    one frame interval; the same for all modes of a node.
    """

    motion: Motion | None = Field(default=None, description="how it moves; default: as the node's `motion`")
    mean_frames: Annotated[Number, Field(ge=1)] | None = Field(
        default=None, description="mean duration, in frame intervals"
    )
    then: Row | None = Field(
        default=None, description="shares of the modes that follow; default: all others equally"
    )
    next: Row | None = Field(
        default=None, description="probabilities of all modes one frame interval later; they sum to 1"
    )
    hidden: Hidden | None = Field(
        default=None, description="the target cannot be seen in it; default: it can"
    )


Modes = Annotated[dict[Name, Mode], Field(min_length=1, max_length=MOST_MODES)]
