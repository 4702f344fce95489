"""The nodes of a net: inference, agent and factor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag

from bayesnet_track.graph.expressions.terms import MAX_CHARACTERS
from bayesnet_track.graph.settings.adapt import (
    Adapt,
    Learn,
    Lost,
    SelfCheck,
)
from bayesnet_track.graph.settings.base import AgentChoice, Model, Name, Number, Truth
from bayesnet_track.graph.settings.modes import Modes
from bayesnet_track.graph.settings.motion import (
    Motion,
)
from bayesnet_track.graph.settings.nodes import (
    Belief,
    Correlation,
    Estimate,
    Fuse,
)
from bayesnet_track.graph.settings.scores import (
    Alarm,
    Distractors,
    Guarantee,
    Localization,
    Score,
)


class InferenceNode(Model):
    """A node that holds a belief about the target, or fuses its children for its parent.

    Example::

        square:
          belief: {particles: {size: 500}}
          fuse: product
          motion: {random_walk: {sd_px: {x: 20, y: 20}}}
    """

    parent: Name | None = Field(default=None, description="the inference node above; absent for the root")
    belief: Belief | None = Field(
        default=None,
        description="at the root, default 500 particles; or at a node with `fuse: latent`, then without "
        "settings, default the best exact form [that fits](#latent)",
    )
    motion: Motion | None = Field(
        default=None,
        description="required at the root; or at a node with `fuse: latent`: its deviation from its place in "
        "its parent's box is remembered, and changes by this random walk in px",
    )
    modes: Modes | None = Field(
        default=None,
        description="root only; hidden discrete states with memory: ways to move, and whether it is seen. "
        "Default: one way, always seen",
    )
    estimate: Estimate | None = Field(default=None, description="root only; default map")
    fuse: Fuse | None = Field(default=None, description="required with two or more children")
    correlation: Correlation | None = Field(
        default=None,
        description="of the errors of the children's own estimates, with `fuse: {pool: learned}`; "
        "`fit --fusion` estimates it. Default 1, as in an equal pool",
    )
    ud_fields: tuple[Literal["x", "y", "w", "h"], ...] = Field(
        default=("x", "y", "w", "h"), min_length=1, description="fields that UD counts"
    )
    adapt: Adapt | None = Field(default=None, description="when the agents below are switched on and off")
    learn: Learn | None = Field(default=None, description="root only")
    lost: Lost | None = Field(default=None, description="root only; default {above: {ud_box: 1}, frames: 3}")
    score: Score | None = Field(
        default=None,
        description="root only; how the score becomes a probability of being on target. Default: an index of "
        "fit and UD in 0..1, not calibrated",
    )
    localization_error: Localization | None = Field(
        default=None, description="root only; widens the reported regions and sds; default not at all"
    )
    distractors: Distractors | None = Field(
        default=None, description="root only; limits the score after a look-alike; needs `score`"
    )
    guarantee: Guarantee | None = Field(
        default=None, description="root only; bounds how often tracking is said while off; needs `score`"
    )
    alarm: Alarm | None = Field(
        default=None, description="root only; an alarm that is seldom false in a whole video; needs `score`"
    )


class AgentNode(Model):
    """A leaf: a visual cue that scores each hypothesis.

    Example::

        histogram: {parent: color, agent: {color_histogram: {bins: 32}}}
    """

    parent: Name = Field(description="the inference node above")
    agent: AgentChoice = Field(description="the cue, with its parameters")
    active: Truth = Field(default=True, description="whether it is switched on at the start")
    self_check: SelfCheck | None = Field(default=None, description="stop when uncertain of itself")
    temperature: Annotated[Number, Field(gt=0)] = Field(
        default=1.0, description="its log-likelihood is divided by it: above 1 the agent counts for less"
    )
    learn_rate_max: Annotated[Number, Field(ge=0, le=1)] | None = Field(
        default=None, description="instead of the root's learn.rate_max; 0 keeps the first reference"
    )
    measures: dict[Name, Annotated[str, Field(max_length=MAX_CHARACTERS)]] = Field(
        default={},
        max_length=8,
        description="of an agent that measures: quantity: its "
        "[expression](expressions.md#measurement-functions) of the state; default, fields of the state",
    )
    on: Literal["engine", "process"] | None = Field(
        default=None,
        description="where it runs, without effect on results: `engine`, in the engine's own process; "
        "`process`, in a worker process, so that the run survives its crash or hang; default: as "
        "`--executor` says",
    )


class FactorNode(Model):
    """A leaf that weighs each hypothesis by an [expression](expressions.md) or a mask, not by the frame.

    Its density multiplies the likelihood of the node above it, in a pool with the exponent 1. It is always
    on: no rule switches it, and it has no KL and no contribution of its own.

    Example::

        size: {parent: person, factor: "normal(h, 0.32 * y + 12, 8)"}
        road: {parent: person, mask: road.png, factor: "0.02 + mask(x, y + h / 2)"}
    """

    parent: Name = Field(description="the inference node above")
    factor: Annotated[str, Field(max_length=MAX_CHARACTERS)] | None = Field(
        default=None,
        description="expression of the node's state, a density up to a constant; required without a mask, "
        "default with one `mask(x, y)`",
    )
    mask: Annotated[str, Field(min_length=1, max_length=1000)] | None = Field(
        default=None,
        description="image file, a path from where the graph file is: gray value 0 to 255 of a place as its "
        "likelihood 0 to 1",
    )

    @property
    def expression(self) -> str:
        """What it says, the default included."""
        return "mask(x, y)" if self.factor is None else self.factor


def node_kind(value: Any) -> str:
    """Which of the nodes a value is, or is to be: agent, factor or inference."""
    if isinstance(value, Model):
        return {AgentNode: "agent", FactorNode: "factor"}.get(type(value), "inference")
    if not isinstance(value, Mapping):
        return "inference"
    return "agent" if "agent" in value else "factor" if {"factor", "mask"} & value.keys() else "inference"


Node = Annotated[
    Annotated[InferenceNode, Tag("inference")]
    | Annotated[AgentNode, Tag("agent")]
    | Annotated[FactorNode, Tag("factor")],
    Discriminator(node_kind),
]
