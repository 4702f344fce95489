"""The settings of adaptation: when agents are switched on and off, what is learnt, when a target is lost."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from bayesnet_track.graph.settings.base import (
    Choice,
    FrameCount,
    Model,
    Name,
    NotNegative,
    Number,
    Positive,
    Whole,
)


class Level(Choice):
    """A threshold of the uncertainty deviation UD."""

    ud_px2: Positive | None = Field(default=None, description="in px^2")
    ud_box: Positive | None = Field(default=None, description="as a share of the estimate's area w h")
    ud_baseline: Positive | None = Field(default=None, description="as a multiple of its measured baseline")


class SwitchLevel(Level):
    """A threshold of UD, or of the score.

    By the score an agent can rest while the target is probably lost and searched for in a wide square, where
    an expensive agent costs most: `deactivate` below a score, and `activate` above it.
    """

    score: Annotated[Number, Field(gt=0, lt=1)] | None = Field(
        default=None, description="probability of being on target; needs `score` at the root"
    )


class Concentrated(Model):
    """The belief lies around one mode, as a binomial test shows with `confidence` (thesis 6.2).

    The test passes when at least `share` of the belief must have its centre within `within_box` of the most
    probable state's. Its trials are the effective hypotheses, 1 / sum w^2: with few of them it cannot pass
    (29 are needed for 0.9 at 0.95). For a Gaussian and a grid the share is exact.
    """

    share: Annotated[Number, Field(gt=0, lt=1)] = Field(
        default=0.9, description="share of the belief that has to lie inside the window"
    )
    within_box: Positive = Field(default=0.25, description="radius of the window, in sqrt(w h) of the mode")
    confidence: Annotated[Number, Field(ge=0.5, lt=1)] = Field(
        default=0.95, description="confidence of the test, one-sided"
    )


class Condition(Choice):
    """A test of the belief."""

    concentrated: Concentrated | None = Field(default=None, description="it lies around one mode")


class Activate(Model):
    """Switch agents on when UD or score stays above a level, or while a test shows no concentrated belief."""

    above: SwitchLevel | None = Field(
        default=None, description="threshold of UD or of the score; this or `unless`"
    )
    unless: Condition | None = Field(default=None, description="a test of the belief; this or `above`")
    frames: FrameCount = Field(
        default=1, description="consecutive frames above the threshold, or in which the test fails"
    )
    which: Literal["all", "most_helpful", "information_per_ms"] = Field(
        default="all",
        description="every inactive agent; the one that contributed most while active; or the one with the "
        "most expected information per declared cost (every one while the target is lost)",
    )

    @model_validator(mode="after")
    def _one_condition(self) -> Self:
        if (self.above is None) == (self.unless is None):
            raise ValueError("exactly one of above, unless")
        return self


class Deactivate(Model):
    """Switch one agent off when UD or score stays below a level, or while a test shows concentration."""

    below: SwitchLevel | None = Field(
        default=None, description="threshold of UD or of the score; this or `when`"
    )
    when: Condition | None = Field(default=None, description="a test of the belief; this or `below`")
    frames: FrameCount = Field(
        default=5, description="consecutive frames below the threshold, or in which the test passes"
    )
    drop: Literal[
        "largest_kl",
        "min_contribution_per_ms",
        "min_information_per_ms",
        "most_expensive_redundant",
        "most_expensive",
    ] = Field(
        default="largest_kl",
        description="which one: the largest KL(belief || agent); the smallest KL(belief || belief without "
        "it) per declared cost in this frame; the same, averaged over the frames in which it was active; the "
        "largest declared cost among those without which UD, in this frame, would stay below the "
        "threshold that switches agents on; or the largest declared cost",
    )
    sample_every: Annotated[Whole, Field(ge=2, le=1000)] | None = Field(
        default=None,
        description="evaluate the agent that is switched off in one of so many tracked frames; references "
        "then learn in these frames only, as much as they would in all of them; default: not evaluated",
    )

    @model_validator(mode="after")
    def _one_condition(self) -> Self:
        if (self.below is None) == (self.when is None):
            raise ValueError("exactly one of below, when")
        return self


class Information(Model):
    """Memory of the information that agents contributed, and the bonus of an untried agent.

    An agent's contribution is KL(belief || belief without it), nats. Frames count
    exp(-age / memory_frames). An agent is expected to contribute its mean plus
    exploration sqrt(ln(1 + sum n) / n), n its remembered frames.
    """

    memory_frames: FrameCount = Field(default=100, description="frames over which past contributions fade")
    exploration: NotNegative = Field(
        default=0.1, description="exploration bonus of agents rarely evaluated, nats"
    )


class OnCall(Model):
    """Expensive agents stay on, but run only when they are due, or in the frame in which they are needed.

    The others run first. What they say of the frame decides whether those on call run in it, too. Each run
    shows what they are worth: the gap to the next one grows by one frame, up to `every`, where the boxes with
    and without them overlap by at least `agree` and UD with them is not above `above`; else they run in the
    next frame again. While the target is lost they run in every frame. References learn in the frames
    in which they run, as much as they would in all of them.
    """

    every: Annotated[Whole, Field(ge=2, le=1000)] = Field(description="largest gap, in frames")
    agree: Annotated[Number, Field(gt=0, lt=1)] = Field(
        default=0.6,
        description="overlap (IoU) of the boxes with and without them from which on the gap grows",
    )
    above: Level = Field(description="threshold of UD above which they run at once, in the same frame")


class Adapt(Model):
    """Rules that switch agents below an inference node on and off, or let them run."""

    activate: Activate | None = Field(default=None, description="when agents are switched on")
    deactivate: Deactivate | None = Field(default=None, description="when an agent is switched off")
    on_call: OnCall | None = Field(
        default=None, description="root only; instead of both: when `agents`, which stay on, run"
    )
    agents: Annotated[tuple[Name, ...], Field(min_length=1)] | None = Field(
        default=None,
        description="the agents below that these rules may switch; others are left to the rules of a node "
        "further up, or as they are; default: all that no rule nearer by switches",
    )
    keep: Annotated[Whole, Field(ge=1)] = Field(
        default=1, description="agents that always stay active, counting those that `agents` leaves out"
    )
    information: Information = Field(
        default=Information(), description="memory of `information_per_ms` and `min_information_per_ms`"
    )


class Guard(Model):
    """A second, slow reference per agent keeps the first one from learning its own errors.

    Agents that know the target by its appearance have one; others remember what has to change, such as a
    speed. In every `every`-th frame in which references learn, both score the estimate. If the slow one's
    likelihood is lower by more than `apart_nats`, the agent does not learn, and its reference moves toward
    the slow one by `pull`. Else the slow one moves toward the first by `rate`.
    """

    rate: Annotated[Number, Field(ge=0, le=1)] = Field(
        default=0.002, description="rate of the slow reference per frame; 0 keeps the one of the first frame"
    )
    apart_nats: Positive = Field(
        default=1.0, description="difference of log-likelihoods from which on the two count as diverged, nats"
    )
    every: FrameCount = Field(default=5, description="frames between comparisons")
    pull: Annotated[Number, Field(ge=0, le=1)] = Field(
        default=0.05,
        description="share of the slow reference that is mixed in per frame while they differ",
    )


class Learn(Model):
    """References move toward the estimate while UD is low (eqs. 2.15-2.16 times rate_max)."""

    below: Level = Field(description="level of UD")
    rate_max: Annotated[Number, Field(gt=0, le=1)] = Field(
        default=0.05,
        description="largest learning rate per frame, of cues that have none of their own; an agent's "
        "learn_rate_max overrides both",
    )
    every: FrameCount = Field(
        default=1,
        description="references learn in one of so many tracked frames, each time as much as in so many "
        "frames",
    )
    early_rate: Annotated[Number, Field(ge=0, le=1)] = Field(
        default=0.0,
        description="in the n-th frame of a target the largest rate is at least this over n: with 1 its "
        "references begin as means of all that was seen",
    )
    guard: Guard | None = Field(default=None, description="keeps references from drifting away")
    score_above: Annotated[Number, Field(ge=0, lt=1)] | None = Field(
        default=None,
        description="score above which references also learn while the target is uncertain; needs `score`; "
        "default: only while it is tracked",
    )


class Regain(Model):
    """After an event, agents and verifiers that agree on one place count more than a poor fit.

    While the target is not tracked and both hold for `frames` frames in a row, at a place that moves by less
    than half a box side a frame, the score is not bounded by `full_fit`, and a target that is missing
    (`found_fit`) is found. References are those of before the event: they learn again, as the score allows.
    """

    score_above: Annotated[Number, Field(gt=0, lt=1)] = Field(
        default=0.55,
        description="the score without its bounds has to reach this, and its root two box sides or more from "
        "where the target was held",
    )
    ud_box: Positive = Field(default=0.05, description="largest UD, as a share of the estimate's area")
    frames: FrameCount = Field(default=3, description="consecutive frames in which both have to hold")


class Lost(Model):
    """The target is lost when UD is above a threshold or nothing fits, until neither has held for as long.

    With `score_below` the score alone decides, and has to be a probability (`score`): lost below it,
    uncertain below `uncertain_below`, else tracked, each from the last of `frames` consecutive frames on.
    While a target is uncertain, references do not learn, unless `learn` has a `score_above`, and baselines
    are not measured. With `existence_below` the probability that it exists says so (`existence`), with
    `existence_in_box_below` the probability that it exists and its box is right.
    """

    above: Level = Field(default=Level(ud_box=1.0), description="level of UD")
    fit_below: Annotated[Number, Field(ge=0, lt=1)] = Field(
        default=0.05,
        description="largest likelihood of any hypothesis, geometric mean over the active agents",
    )
    score_below: Annotated[Number, Field(gt=0, lt=1)] | None = Field(
        default=None, description="score below which it counts as lost; instead of `above` and `fit_below`"
    )
    uncertain_below: Annotated[Number, Field(gt=0, lt=1)] | None = Field(
        default=None, description="score below which it counts as uncertain; default: never"
    )
    existence_below: Annotated[Number, Field(gt=0, lt=1)] | None = Field(
        default=None,
        description="probability of existence below which it counts as lost; instead of the others",
    )
    existence_in_box_below: Annotated[Number, Field(gt=0, lt=1)] | None = Field(
        default=None,
        description="the same of the probability that it exists and is where its box is: shifted by at most "
        "a third of a side in x and in y, as far as the belief says; instead of the others",
    )
    found_fit: Annotated[Number, Field(gt=0, le=1)] | None = Field(
        default=None,
        description="share of the usual fit at which what is seen is the target again, once it was lost by "
        "its score; more far away; until then the score is at most one half; default: any score will do",
    )
    scene_cut: Annotated[Number, Field(gt=0, lt=1)] | None = Field(
        default=None,
        description="distance of a frame from the one before it, in colours and structure, above which the "
        "scene was cut: the target is lost at once and, with `relocalize`, searched for in the whole frame; "
        "0.3 is a good value; default: cuts are not noticed",
    )
    regain: Regain | None = Field(
        default=None,
        description="agreement of agents and verifiers on one place that ends a loss although the fit is "
        "still poor; needs `score_below`, and `full_fit` or `found_fit`; default: only the fit does",
    )
    frames: FrameCount = Field(default=3, description="consecutive frames before the status changes")

    @property
    def existence_rule(self) -> tuple[str, float] | None:
        """The probability of existence that says what is lost, and its level; None where none does."""
        if self.existence_in_box_below is not None:
            return "existence_in_box", self.existence_in_box_below
        return None if self.existence_below is None else ("existence", self.existence_below)
