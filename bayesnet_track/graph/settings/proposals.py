"""The settings of the proposal: from where the hypotheses of a frame are drawn."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from bayesnet_track.graph.settings.base import (
    Choice,
    Empty,
    Model,
    NotNegative,
    Number,
    Positive,
    Share,
    Whole,
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
