"""The settings of the particle belief: how many hypotheses, how and when parents are drawn."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Discriminator, Field, Tag

from bayesnet_track.graph.model import Model, Share, Whole, word_or_mapping


class EssBelow(Model):
    """Resample when the effective sample size falls below this share of the hypotheses."""

    ess_below: Share = Field(description="share of the hypotheses")


class Particles(Model):
    """A weighted set of hypotheses."""

    size: Annotated[Whole, Field(ge=2, le=1_000_000)] = Field(default=500, description="number of hypotheses")
    resample: Literal["systematic", "stratified", "residual", "multinomial"] = Field(
        default="systematic", description="how parents are drawn"
    )
    when: Annotated[
        Annotated[Literal["every_frame"], Tag("word")] | Annotated[EssBelow, Tag("mapping")],
        Discriminator(word_or_mapping),
    ] = Field(
        default="every_frame", description="at every frame, or only when the weights have become uneven"
    )
