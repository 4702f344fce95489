"""Settings of the nodes of a net: inference, agent and factor."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cached_property
from types import MappingProxyType
from typing import Annotated, Any, Literal, get_args

from pydantic import Discriminator, Field, Tag

from bayesnet_track.graph.expressions.terms import MAX_CHARACTERS
from bayesnet_track.graph.rules.agent_rule import AgentRule
from bayesnet_track.graph.rules.self_check import SelfCheck
from bayesnet_track.graph.settings.adapt import Adapt, Learn, Lost
from bayesnet_track.graph.settings.base import (
    AgentChoice,
    Choice,
    Empty,
    Model,
    Name,
    Number,
    Positive,
    Share,
    Truth,
    word_or_mapping,
)
from bayesnet_track.graph.settings.beliefs import Gaussian, Grid, Particles
from bayesnet_track.graph.settings.motion import Expression, Modes, Motion, Noise
from bayesnet_track.graph.settings.scores import Alarm, Distractors, Guarantee, Localization, Score

# ---------------------------------------------------------------------------------- belief


class Belief(Choice):
    """Representation of the belief."""

    particles: Particles | None = Field(default=None, description="a weighted set of hypotheses")
    gaussian: Gaussian | None = Field(
        default=None, description="one mean and one covariance: Kalman, extended, unscented"
    )
    grid: Grid | None = Field(default=None, description="a discrete distribution over cells")


class Window(Model):
    """A window around the best hypothesis."""

    box: Positive = Field(default=0.25, description="half width of the window, in sqrt(w h)")


class Nearest(Model):
    """The optimised working point of the General Distribution Filter (1.3)."""

    epsilon: Share = Field(
        default=0.5,
        description="smallest posterior weight of a probable hypothesis, as a share of the largest",
    )


class Estimate(Choice):
    """The single box that represents the belief in the outputs."""

    map: Empty | None = Field(
        default=None, description="maximum a posteriori hypothesis, prior density included"
    )
    max_weight: Empty | None = Field(default=None, description="hypothesis with the largest weight")
    mean: Empty | None = Field(default=None, description="weighted mean")
    robust_mean: Window | None = Field(
        default=None, description="weighted mean inside a window around the best"
    )
    nearest: Nearest | None = Field(
        default=None, description="among the probable hypotheses the one nearest to the prediction"
    )


# ---------------------------------------------------------------------------------- fusion


class OffsetBox(Model):
    """Place of a part's centre in its parent's box, from the parent's centre."""

    x: Number = Field(default=0.0, description="to the right, in widths of the parent's box")
    y: Number = Field(default=0.0, description="downward, in heights of the parent's box")


class SizeBox(Model):
    """Size of a part, relative to its parent's box."""

    w: Positive = Field(default=1.0, description="its width, in widths of the parent's box")
    h: Positive = Field(default=1.0, description="its height, in heights of the parent's box")


class Given(Noise):
    """A latent state: Gaussian noise around its parent's box, or around a part of that box.

    With `offset_box` or `size_box` the node is a *part* of the target: its state is the part's own box,
    `sd_box` is relative to the part's size, agents below learn what is inside the part, and the part's
    estimate stands beside the target's in the results. So it is with `x`, `y`, `w`, `h`, which say the same
    by expressions of the parent's box.

    Example::

        head: {parent: person, fuse: {latent: {given: {offset_box: {y: -0.39}, size_box: {w: 0.44, h: 0.22},
          sd_box: {x: 0.1, y: 0.1}}}}}
        hand: {parent: person, fuse: {latent: {given: {
          x: "laplace(parent.x, 0.4 * parent.w)", y: "normal(parent.y, 9)"}}}}
    """

    x: Expression | None = Field(
        default=None,
        description="instead of all below and above: distribution of the own x by an "
        "[expression](expressions.md#states-below-the-root), such as `normal(parent.x, 5)`, or its value; "
        "default `parent.x`",
    )
    y: Expression | None = Field(default=None, description="the same of y")
    w: Expression | None = Field(default=None, description="the same of the width")
    h: Expression | None = Field(default=None, description="the same of the height")
    offset_box: OffsetBox | None = Field(
        default=None,
        description="the part's centre in the parent's box; default, with `size_box` alone: the parent's "
        "centre",
    )
    size_box: SizeBox | None = Field(
        default=None,
        description="the part's size relative to the parent's; default, with `offset_box` alone: the same "
        "size",
    )

    @property
    def written(self) -> dict[str, str]:
        """Field of the own box -> the expression of its distribution or value; empty without any."""
        texts = {name: getattr(self, name) for name in ("x", "y", "w", "h")}
        return {name: str(text) for name, text in texts.items() if text is not None}

    @property
    def is_part(self) -> bool:
        """True if the state is the box of a part of the target."""
        return self.offset_box is not None or self.size_box is not None or bool(self.written)


class Latent(Model):
    """The node has a state of its own, drawn around its parent's hypothesis by `given`.

    The node's `belief` says how its evidence is held. `particles`: one draw per hypothesis is unbiased but
    noisy: with 1000 hypotheses and `given` wider than the agents its 50 % region held the true value in 30 %
    of cases; it needs some 30,000. The kernel is accurate with 1000 (47 %), and then takes about 0.1 s per
    message. `grid` is the kernel by convolution over cells of x and y, in milliseconds, for `given` in px.
    `gaussian` is as accurate where the likelihood has one mode, in O(N), and sends a Gaussian message.

    Without `belief` and `draw` it is `gaussian` if all agents below measure and `given` is Gaussian in px:
    this is exact. It is `grid` if `given` is in px of x and y alone, and nothing above changes the size. It
    is one draw per hypothesis otherwise, with a motion, and where a factor compares it with its parent.
    """

    given: Given = Field(description="p(own state | parent's state)")
    draw: Literal["one", "kernel"] | None = Field(
        default=None,
        description="one draw per hypothesis, O(N); or the row-normalised kernel, O(N^2); default: the best "
        "exact form that fits, as said above",
    )


Weights = Annotated[dict[Name, Positive], Field(min_length=1)]


def pool_exponents(shares: Mapping[str, float], correlation: float | None = None) -> dict[str, float]:
    """Child -> exponent of its likelihood in a pool of the children with these shares.

    Without a correlation they sum to 1. With r each of k is 1 / (1 + (k - 1) r): the precision of the mean of
    k errors of equal variance and correlation r is k times that of one, over 1 + (k - 1) r. So r = 0 is the
    product, and r = 1 the pool.

    >>> pool_exponents({"a": 3.0, "b": 1.0}), pool_exponents({"a": 1.0, "b": 1.0}, 0.25)
    ({'a': 0.75, 'b': 0.25}, {'a': 0.8, 'b': 0.8})
    """
    if correlation is not None:
        return dict.fromkeys(shares, 1.0 / (1.0 + (len(shares) - 1) * correlation))
    total = sum(shares.values())
    return {child: share / total for child, share in shares.items()}


Correlation = Annotated[Number, Field(ge=0, le=1)]


class Fuse(Choice):
    """Combination of the children's likelihoods at an inference node."""

    product: Empty | None = Field(default=None, description="children independent given this node")
    pool: (
        Annotated[
            Annotated[Literal["equal", "learned"], Tag("word")] | Annotated[Weights, Tag("mapping")],
            Discriminator(word_or_mapping),
        ]
        | None
    ) = Field(
        default=None,
        description="log-linear pool: equal, or a weight per child, scaled to sum to 1 over the active "
        "children; or learned: of k active children each has 1 / (1 + (k - 1) r), with the node's "
        "`correlation` r",
    )
    latent: Latent | None = Field(
        default=None, description="a state of its own; children independent given it"
    )

    def shares(self, children: Iterable[str]) -> dict[str, float]:
        """Child -> its share of a pool as written; only their ratios count."""
        pool = self.pool
        return {child: pool[child] if isinstance(pool, dict) else 1.0 for child in children}

    @classmethod
    def bare(cls, word: str) -> Any:
        """A bare `pool` means equal weights."""
        return "equal" if word == "pool" else {}


class Category(Model):
    """A discrete constant of a target that is not observed, such as its team.

    A label of a detector is evidence on it (`confusion` of the agent `detection`), and so is all that is
    read of it in expressions.
    """

    values: Annotated[tuple[Name, ...], Field(min_length=1, max_length=8)] = Field(
        description="what it may be; names for [expressions](expressions.md)"
    )
    prior: dict[Name, Positive] = Field(
        default={}, description="value: its probability when the target starts; default: all alike"
    )


Categories = Annotated[dict[Name, Category], Field(min_length=1, max_length=4)]


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
    start: dict[Name, Expression] = Field(
        default={},
        max_length=16,
        description="root only; field of the state: its distribution when the target starts, by an "
        "[expression](expressions.md#start-priors) of the start box, such as `normal(x, 5)`, or its value. "
        "Default: in the start box, other fields as the motion says",
    )
    modes: Modes | None = Field(
        default=None,
        description="root only; hidden discrete states with memory: ways to move, and whether it is seen. "
        "Default: one way, always seen",
    )
    category: Categories | None = Field(
        default=None,
        description="root only; [what the target is and stays](categories.md), such as its team: discrete "
        "constants with evidence. Default: none",
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
    camera: Name | Annotated[tuple[Name, ...], Field(min_length=1, max_length=16)] | None = Field(
        default=None,
        description="a view: the node's hypotheses are those of its parent, on the ground in metres, "
        "projected into this [camera](metres.md); agents below see boxes in pixels. A list of cameras stands "
        "for one such node for each, `view.north`, with copies of all nodes below it",
    )

    @property
    def seen_by(self) -> tuple[str, ...]:
        """The cameras that the node is a view of; none of another node."""
        if self.camera is None:
            return ()
        return (self.camera,) if isinstance(self.camera, str) else self.camera

    @property
    def start_texts(self) -> dict[str, str]:
        """Field of a root's state -> its distribution when a target starts, as an expression."""
        written = {name: str(text) for name, text in self.start.items()}
        return written if self.motion is None else {**self.motion.settings.start_texts, **written}

    @property
    def adapts(self) -> bool:
        """True where the node switches agents."""
        return self.adapt is not None


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
    inverse: dict[Name, Annotated[str, Field(max_length=MAX_CHARACTERS)]] = Field(
        default={},
        max_length=8,
        description="of `detection` with `sd`: field of the state: its [expression](any_sensor.md) of the "
        "quantities, with which a target starts; default, found by `measures` where that can be inverted",
    )
    on: Literal["engine", "process"] | None = Field(
        default=None,
        description="where it runs, without effect on results: `engine`, in the engine's own process; "
        "`process`, in a worker process, so that the run survives its crash or hang; default: as "
        "`--executor` says",
    )

    @cached_property
    def rules(self) -> Mapping[str, AgentRule]:
        """Key -> rule, of the rules by which the agent switches itself off."""
        return {key: rule for key in AGENT_RULES if (rule := getattr(self, key)) is not None}

    @property
    def switches_itself(self) -> bool:
        """True with a rule by which the agent switches itself off."""
        return bool(self.rules)

    @property
    def adapts(self) -> bool:
        """True for an agent that begins switched off, or has a rule of its own that stops it."""
        return self.switches_itself or not self.active


def _rule_of(annotation: Any) -> type[AgentRule] | None:
    """The kind of rule that a field of an agent holds; None for every other field."""
    kinds = [part for part in get_args(annotation) if isinstance(part, type) and issubclass(part, AgentRule)]
    return kinds[0] if kinds else None


AGENT_RULES: Mapping[str, type[AgentRule]] = MappingProxyType(
    {key: rule for key, field in AgentNode.model_fields.items() if (rule := _rule_of(field.annotation))}
)
"""Key of an agent node -> the rule that it holds, by which the agent switches itself off."""


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
        """Expression of the factor, the default included."""
        return "mask(x, y)" if self.factor is None else self.factor

    @property
    def adapts(self) -> bool:
        """False: a factor is always on."""
        return False


def node_kind(value: Any) -> str:
    """Kind of node that a value is, or is to be: agent, factor or inference."""
    if isinstance(value, Model):
        return {AgentNode: "agent", FactorNode: "factor"}.get(type(value), "inference")
    if not isinstance(value, Mapping):
        return "inference"
    return "agent" if "agent" in value else "factor" if {"factor", "mask"} & value.keys() else "inference"


ADAPTATION: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"inference": ("adapt",), "agent": ("active", *AGENT_RULES), "factor": ()}
)
"""Kind of node -> its keys that switch agents, or leave one off at the start."""


Node = Annotated[
    Annotated[InferenceNode, Tag("inference")]
    | Annotated[AgentNode, Tag("agent")]
    | Annotated[FactorNode, Tag("factor")],
    Discriminator(node_kind),
]
