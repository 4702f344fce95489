"""The specification: a graph as data, with the same words in Python as in YAML.

Every model is frozen and refuses unknown keys. A *choice* (`Fuse`, `Motion`, ...) is written as a bare word
(``fuse: product``) or as one key with its settings (``fuse: {pool: equal}``).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag

from bayesnet_track.graph.display import html_of
from bayesnet_track.graph.expressions.terms import MAX_CHARACTERS
from bayesnet_track.graph.settings.adapt import (
    Activate,
    Adapt,
    Concentrated,
    Condition,
    Deactivate,
    Guard,
    Information,
    Learn,
    Level,
    Lost,
    SelfCheck,
)
from bayesnet_track.graph.settings.base import Choice, Empty, Model, Name, Number, PluginChoice, Truth
from bayesnet_track.graph.settings.existence import Existence
from bayesnet_track.graph.settings.gaussian import Gaussian, Unscented
from bayesnet_track.graph.settings.grid import Grid, Reset
from bayesnet_track.graph.settings.joins import Attachment, Exclusion, Join, Occlusion, Together
from bayesnet_track.graph.settings.lifecycle import (
    Birth,
    Confirm,
    Death,
    DetectorChoice,
    MergeDuplicates,
    MergeOrNever,
    Reidentify,
    ReidentifyOrNever,
)
from bayesnet_track.graph.settings.modes import Hidden, Mode, Modes
from bayesnet_track.graph.settings.motion import (
    BoxSd,
    BoxVelocity,
    ByExpressions,
    ConstantAcceleration,
    ConstantVelocity,
    DampedVelocity,
    HeavyTail,
    Inflate,
    LogSd,
    LookedFor,
    Motion,
    Moving,
    Noise,
    OwnField,
    PixelSd,
    Probes,
    RandomWalk,
    Relocalize,
    SizeReversion,
)
from bayesnet_track.graph.settings.nodes import (
    Belief,
    Correlation,
    Estimate,
    Fuse,
    Given,
    Latent,
    Nearest,
    OffsetBox,
    SizeBox,
    Window,
)
from bayesnet_track.graph.settings.particles import (
    AdaptiveSize,
    BinnedSize,
    EssBelow,
    LikelihoodSize,
    NormalSize,
    Particles,
)
from bayesnet_track.graph.settings.scores import (
    Alarm,
    Distractors,
    Guarantee,
    Localization,
    Logistic,
    Score,
)

LANGUAGE_VERSION = 1

__all__ = [
    "LANGUAGE_VERSION",
    "Activate",
    "Adapt",
    "AdaptiveSize",
    "AgentChoice",
    "AgentNode",
    "Alarm",
    "Attachment",
    "Belief",
    "BinnedSize",
    "Birth",
    "BoxSd",
    "BoxVelocity",
    "ByExpressions",
    "Choice",
    "Concentrated",
    "Condition",
    "Confirm",
    "ConstantAcceleration",
    "ConstantVelocity",
    "DampedVelocity",
    "Deactivate",
    "Death",
    "DetectorChoice",
    "Distractors",
    "Empty",
    "EssBelow",
    "Estimate",
    "Exclusion",
    "Existence",
    "FactorNode",
    "Fuse",
    "Gaussian",
    "Given",
    "GraphSpec",
    "Grid",
    "Guarantee",
    "Guard",
    "HeavyTail",
    "Hidden",
    "InferenceNode",
    "Inflate",
    "Information",
    "Join",
    "Latent",
    "Learn",
    "Level",
    "LikelihoodSize",
    "Localization",
    "LogSd",
    "Logistic",
    "LookedFor",
    "Lost",
    "MergeDuplicates",
    "Mode",
    "Model",
    "Motion",
    "Moving",
    "Name",
    "Nearest",
    "Node",
    "Noise",
    "NormalSize",
    "Occlusion",
    "OffsetBox",
    "OwnField",
    "Particles",
    "PixelSd",
    "Probes",
    "RandomWalk",
    "Reidentify",
    "Relocalize",
    "Reset",
    "Score",
    "SelfCheck",
    "SizeBox",
    "SizeReversion",
    "Target",
    "Together",
    "Unscented",
    "Window",
]


class AgentChoice(PluginChoice):
    """The cue of an agent: a registered name and its parameters, not yet checked against the cue.

    Written ``agent: motion`` or ``agent: {motion: {sd_px: 2}}``.
    """

    WORD = "cue"

    cue: str = Field(max_length=64)


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
        "settings, default particles",
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
        description="image file, a path from where the graph file is: grey value 0 to 255 of a place as its "
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


class Target(Model):
    """A plate: one copy of this net per target."""

    state: Literal["box"] = Field(default="box", description="x, y, w, h in pixels; (x, y) is the centre")
    birth: Birth | None = Field(
        default=None, description="where targets come from besides the given start boxes; default nowhere"
    )
    merge_duplicates: MergeOrNever | None = Field(
        default=None,
        description="when two nets track the same target, or never; default, with `birth`, as below",
    )
    death: Death | None = Field(default=None, description="when a net ends; default, with `birth`, as below")
    reidentify: ReidentifyOrNever | None = Field(
        default=None, description="how targets are re-identified, or never; default, with `birth`, as below"
    )
    existence: Existence | None = Field(
        default=None,
        description="how probable it is that a target exists; default: births and ends are counted",
    )
    associate: Literal["assignment", "marginal"] = Field(
        default="assignment",
        description="how agents that measure by detections are given them: the best assignment, or each "
        "target by every detection that may be its own, as probable as it is that it is (JPDA)",
    )
    nodes: dict[Name, Node] = Field(min_length=1, description="the net: one tree under its root")


class GraphSpec(Model):
    """A whole graph file.

    Example::

        bayesnet: 1
        name: two_squares
        targets:
          square:
            nodes: {...}
    """

    bayesnet: Literal[1] = Field(default=1, description="version of the language")
    name: Name = Field(description="name of the graph")
    about: str = Field(default="", max_length=2000, description="what the graph is for")
    constants: dict[Name, Number] = Field(
        default={}, max_length=64, description="numbers that expressions use by name"
    )
    targets: dict[Name, Target] = Field(min_length=1, description="kinds of targets, by name")
    joins: tuple[Join, ...] = Field(
        default=(), max_length=64, description="how targets depend on each other; default not at all"
    )

    def _repr_html_(self) -> str:
        """For notebooks: the picture of each net, or what is wrong with the graph."""
        return html_of(self, "spec_html")
