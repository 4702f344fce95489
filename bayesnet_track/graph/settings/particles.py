"""The settings of the particle belief: how many hypotheses, how and when drawn, and from where."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag

from bayesnet_track.graph.settings.base import (
    Choice,
    Empty,
    Model,
    Number,
    Positive,
    Share,
    Whole,
    word_or_mapping,
)
from bayesnet_track.graph.settings.proposals import Proposal

BoxFields = Annotated[tuple[Literal["x", "y", "w", "h"], ...], Field(min_length=1)]
Confidence = Annotated[Number, Field(ge=0.5, lt=1)]
LEAST, MOST = 500, 5000
Count = Annotated[Whole, Field(ge=2, le=1_000_000)]


class BinnedSize(Model):
    """A bound on the KL divergence between the posterior in bins and its estimate.

    The number grows in proportion to the occupied bins: the width of a bin matters most.
    """

    bin_px: Positive = Field(description="width of a bin, px")
    error: Positive = Field(default=0.1, description="largest KL divergence, nats")
    confidence: Confidence = Field(default=0.95, description="probability that the bound holds")
    fields: BoxFields = Field(
        default=("x", "y"), description="fields considered, each by itself; the largest number counts"
    )


class NormalSize(Model):
    """A bound on the error of the posterior's mean; set one of `error_px` and `error_sd`."""

    error_px: Positive | None = Field(default=None, description="largest error of the mean, px")
    error_sd: Positive | None = Field(
        default=None, description="largest error of the mean, as a share of the posterior's sd"
    )
    confidence: Confidence = Field(default=0.95, description="probability that the bound holds")
    fields: BoxFields = Field(
        default=("x", "y"), description="fields considered, each by itself; the largest number counts"
    )


class LikelihoodSize(Model):
    """As many hypotheses as it takes for their likelihoods to add up to a threshold."""

    threshold: Positive = Field(description="sum of likelihoods; a perfect match counts 1")


class AdaptiveSize(Choice):
    """A number of hypotheses that follows each frame's evidence, between `min` and `max` (thesis 5.4).

    A frame begins with the number that the last one asked for. If its own evidence asks for at least a
    quarter more, they are drawn in the same frame, in a way that keeps the frame's evidence unbiased. The
    number does not fall while fewer than 10 hypotheses are effective, which are too few to estimate it. It
    needs `when: every_frame`.
    """

    kld: BinnedSize | None = Field(
        default=None, description="KLD-sampling, as if hypotheses came from the posterior (eq. 5.6)"
    )
    kld_revised: BinnedSize | None = Field(
        default=None,
        description="KLD-sampling times the variance that drawing from the prior adds to the mean (eq. 5.10)",
    )
    kld_revised_simplified: BinnedSize | None = Field(
        default=None, description="KLD-sampling times the number of hypotheses per effective one (eq. 5.14)"
    )
    asymptotic_normal: NormalSize | None = Field(
        default=None, description="by the normal approximation of the mean's error (eq. 5.17, corrected)"
    )
    likelihood_sum: LikelihoodSize | None = Field(
        default=None, description="by the likelihoods alone, whatever the shape of the posterior (5.4.1)"
    )

    @property
    def tolerance(self) -> tuple[str, float]:
        """The setting that the number depends on, and its value."""
        settings = self.settings.model_dump()
        names = ("error", "error_px", "error_sd", "threshold")
        return next((name, settings[name]) for name in names if settings.get(name) is not None)


def _number_or_method(value: Any) -> str:
    is_word = isinstance(value, str) and value.isidentifier()
    return "method" if is_word or isinstance(value, (Mapping, Model)) else "number"


class EssBelow(Model):
    """Resample when the effective sample size falls below this share of the hypotheses."""

    ess_below: Share = Field(description="share of the hypotheses")


class Particles(Model):
    """A weighted set of hypotheses."""

    size: Annotated[
        Annotated[Count, Tag("number")] | Annotated[AdaptiveSize, Tag("method")],
        Discriminator(_number_or_method),
    ] = Field(default=500, description="number of hypotheses, fixed or adaptive")
    min: Annotated[Whole, Field(ge=100, le=1_000_000)] | None = Field(
        default=None,
        description="smallest number of an adaptive size, and the number at the start; default 500",
    )
    max: Count | None = Field(default=None, description="largest number of an adaptive size; default 5000")
    resample: Literal["systematic", "multinomial"] = Field(
        default="systematic", description="how parents are drawn"
    )
    when: Annotated[
        Annotated[Literal["every_frame"], Tag("word")] | Annotated[EssBelow, Tag("mapping")],
        Discriminator(word_or_mapping),
    ] = Field(
        default="every_frame",
        description="when to resample: in every frame, or only when the weights have become uneven",
    )
    proposal: Proposal = Field(
        default=Proposal(bootstrap=Empty()), description="the distribution that hypotheses are drawn from"
    )

    @property
    def least(self) -> int:
        """The least number of an adaptive size."""
        return LEAST if self.min is None else self.min

    @property
    def most(self) -> int:
        """The largest number of an adaptive size."""
        return MOST if self.max is None else self.max
