"""The settings of a target that may reappear elsewhere: how probably, and how it is looked for."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from bayesnet_track.graph.settings.adapt import Level
from bayesnet_track.graph.settings.base import Choice, Empty, Model, NotNegative, Number, Positive, Whole
from bayesnet_track.graph.settings.lifecycle import DetectorChoice


class Probes(Model):
    """Boxes of the belief's size on a lattice over the frame, scored by the active agents of the net."""

    max_boxes: Annotated[Whole, Field(ge=16, le=10_000)] = Field(default=400, description="boxes at most")


class LookedFor(Choice):
    """How the places to search are chosen; weights correct for the choice, so it changes no probability."""

    uniform: Empty | None = Field(default=None, description="evenly over the frame")
    agents: Probes | None = Field(
        default=None,
        description="by the net's own agents, at boxes on a lattice",
    )
    detector: DetectorChoice | None = Field(
        default=None, description="by the boxes of a detector; one that learns is given the first box"
    )


class Sudden(Model):
    """A fast move is found in the same frame: where suddenly nothing fits, a square around it is searched.

    The frame is then filtered again with a wider prior, before the target is lost. Needs
    `lost: {found_fit}`, by which it is known how well the target usually fits.
    """

    below_fit: Annotated[Number, Field(gt=0, lt=1)] = Field(
        default=0.15,
        description="share of the usual fit below which it searches; what it finds has to reach it, and the "
        "`full_fit` of the score",
    )
    reach_box: Annotated[Number, Field(gt=0, le=10)] = Field(
        default=2.5, description="half the side of the square, in sqrt(w h)"
    )
    pan_box: NotNegative = Field(
        default=0.0,
        description="only where the whole picture moved at least so far since the last frame, sqrt(w h): a "
        "fast camera makes targets fast, and what is merely covered is not searched for; 0: always",
    )
    share: Annotated[Number, Field(gt=0, lt=1)] = Field(
        default=0.5,
        description="probability, in such a frame, that it is anywhere in the square; and the share of the "
        "hypotheses that look there",
    )


class Relocalize(Model):
    """The target may reappear anywhere: p(x | x') = (1 - share) motion + share / (W H) in its position.

    It is then found again after an occlusion, or after leaving the view. Needs particles of a fixed `size`
    with `proposal: bootstrap`. Beside a Gaussian, agents that say how sure they are look for a target
    that is lost, or uncertain for as long as it takes to be called lost, and `share` weighs what they say of
    other places against what they say of its own.
    """

    share: Annotated[Number, Field(gt=0, lt=1)] = Field(
        default=0.1,
        description="probability per frame interval that it reappears elsewhere, while uncertain or lost",
    )
    above: Level = Field(
        default=Level(ud_box=0.5), description="threshold of UD above which the belief is uncertain"
    )
    usual: Annotated[Number, Field(ge=0, lt=1)] = Field(
        default=0.0, description="the same probability while it is certain"
    )
    hypotheses: Annotated[Number, Field(gt=0, lt=1)] = Field(
        default=0.2, description="share of the hypotheses that look for it, in proportion to the probability"
    )
    by: LookedFor = Field(default=LookedFor(agents=Probes()), description="where they look")
    grow_box: Positive | None = Field(
        default=None,
        description="only while lost (beside a Gaussian, or as long uncertain), and at first near the place "
        "where it was last held: in a square around it, half of whose side grows by so many sqrt(w h) per "
        "frame interval until it covers the frame; default: in the whole frame at once",
    )
    sudden: Sudden | None = Field(
        default=None, description="how a fast move is found before the target is lost; default: not at all"
    )
