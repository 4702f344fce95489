"""Settings of the beliefs: Gaussian, grid and particles with their proposals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Discriminator, Field, Tag

from bayesnet_track.graph.settings.base import (
    Choice,
    Empty,
    Model,
    NotNegative,
    Number,
    Positive,
    Share,
    Whole,
    word_or_mapping,
)


class Unscented(Model):
    """The scaled unscented transform: sigma points alpha sqrt(K + kappa) sds from the mean, K the dimension.

    With the defaults they lie sqrt(3) sds out, where the fourth moment along each axis is right. A small
    alpha (1e-3, with beta 2 and kappa 0) keeps them close to the mean.
    """

    alpha: Positive = Field(default=1.0, description="spread of the points")
    beta: Annotated[Number, Field(ge=0)] = Field(
        default=0.0, description="further weight of the central point in covariances"
    )
    kappa: Annotated[Number, Field(ge=0)] | None = Field(
        default=None, description="added to the dimension; 3 - K without a value"
    )


class Gaussian(Model):
    """One mean and one covariance: the Kalman family.

    Measurements of agents enter by the Kalman update, likelihoods by matching moments over hypotheses drawn
    from the prediction. There is one mode only: if two places are likely, use particles.
    """

    filter: Literal["kalman", "extended", "unscented"] = Field(
        default="extended",
        description="how it predicts: `kalman` where the motion's noise is in px only, `extended` by the "
        "motion's derivative, `unscented` by sigma points",
    )
    likelihood: Literal["samples", "sigma_points"] = Field(
        default="samples",
        description="where agents evaluate their likelihoods: at samples of the prediction, or at 2 D + 1 "
        "sigma points, which is cheaper, and accurate for likelihoods with one mode that are "
        "broader than the prediction",
    )
    samples: Annotated[Whole, Field(ge=20, le=1_000_000)] = Field(
        default=200, description="number of samples of the prediction"
    )
    gate: Share = Field(
        default=0.99,
        description="a measurement farther from the prediction than this share of correct ones is not used; "
        "1: all are used",
    )
    sigma: Unscented = Field(default=Unscented(), description="sigma points of the `unscented` filter")


def _odd(count: int) -> int:
    if count % 2 == 0:
        raise ValueError("an odd number, so that there is a middle cell")
    return count


Odd = Annotated[Whole, Field(ge=3, le=63, json_schema_extra={"not": {"multipleOf": 2}}), AfterValidator(_odd)]


class Reset(Model):
    """Reset of the belief in a frame whose evidence is not feasible under the prediction.

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


Defensive = Annotated[Number, Field(ge=0, lt=1)]


class SecondPassProposal(Model):
    """A second pass, drawn where the first one found the target, in surprising frames (thesis 5.5.2).

    The first pass is drawn from the motion model and its hypotheses are kept. A surprise is KL(posterior ||
    prior), the larger one of two halves of the first pass. The second pass refines what the first one found:
    a target that jumped out of its reach stays lost, and only `likelihood_mixture` searches there.

    `by: parents, neighbours: 1, weights: second_only, defensive: 0` is the form printed in the thesis. At
        equal cost this form is worse than a plain filter if motion noise, not the choice of parents, decides.
    """

    above_kl: NotNegative = Field(
        default=2.0,
        description="KL, in nats, above which a frame gets a second pass; cannot exceed the log of half the "
        "hypotheses; 0: in every frame",
    )
    by: Literal["fitted", "parents"] = Field(
        default="fitted",
        description="motion model times a Gaussian fitted to the first pass's likelihoods; or the motion "
        "model alone, from parents whose hypotheses did well",
    )
    weights: Literal["balance", "separate", "second_only"] = Field(
        default="balance",
        description="each hypothesis by what both passes could have drawn it with; each pass by itself, then "
        "joined; or the first pass dropped",
    )
    neighbours: Annotated[Whole, Field(ge=1, le=1000)] = Field(
        default=5, description="parents that share their mean likelihood, under `by: parents`"
    )
    defensive: Defensive = Field(default=0.1, description="share of the second pass drawn as the first")


class Auxiliary(Model):
    """The auxiliary particle filter: parents by the likelihood of where they move without noise (5.20).

    It costs one more evaluation per parent and frame.
    """

    defensive: Defensive = Field(default=0.1, description="share of the parents drawn by their weight alone")


class PriorEditing(Model):
    """Prior editing: unlikely hypotheses are rejected at random, those kept are weighted for it.

    A hypothesis of likelihood L is kept with probability min(1, L / c).
    """

    rounds: Annotated[Whole, Field(ge=1, le=20)] = Field(
        default=2, description="how many times the number of hypotheses is drawn"
    )
    accept_above: Share = Field(
        default=0.5, description="c, as a share of the largest likelihood of the other hypotheses"
    )


class IteratedProposal(Model):
    """West's refinement: hypotheses from kernels around the weighted ones so far; quadratic cost (5.18)."""

    above_kl: NotNegative = Field(
        default=2.0, description="KL, in nats, above which a frame is refined; 0: every frame"
    )
    refinements: Annotated[Whole, Field(ge=1, le=10)] = Field(
        default=1, description="passes after the first, each from kernels around all before"
    )
    bandwidth: Positive = Field(
        default=1.5, description="sd of a kernel, in that of the normal reference rule"
    )
    defensive: Defensive = Field(default=0.1, description="share of each refinement drawn as the first pass")


class LikelihoodMixture(Model):
    """Part of the hypotheses from where the likelihood is high, the rest from the motion; quadratic cost.

    The likelihood is probed at as many places as there are hypotheses, spread evenly over the prior's
    surroundings; positions are drawn around the likely ones, the other fields of the state given the
    position.
    """

    share: Annotated[Number, Field(gt=0, lt=1)] = Field(
        default=0.5, description="share of the hypotheses that come from the likelihood"
    )
    reach_sd: Positive = Field(
        default=5.0, description="how far from the prior's mean to probe on each side, in its sd"
    )


class Proposal(Choice):
    """The distribution that the hypotheses of a frame are drawn from (thesis 5.5); weights correct for it."""

    bootstrap: Empty | None = Field(default=None, description="from the motion model")
    second_pass: SecondPassProposal | None = Field(
        default=None, description="with a second pass in surprising frames"
    )
    auxiliary: Auxiliary | None = Field(
        default=None, description="from parents that were chosen by looking ahead"
    )
    prior_editing: PriorEditing | None = Field(default=None, description="prior editing")
    iterated: IteratedProposal | None = Field(
        default=None, description="from kernels around the weighted hypotheses"
    )
    likelihood_mixture: LikelihoodMixture | None = Field(
        default=None, description="partly from the likelihood itself"
    )


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
    """Enough hypotheses for their likelihoods to add up to a threshold."""

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
