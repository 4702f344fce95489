"""The specification: a graph as data, with the same words in Python as in YAML.

Every model is frozen and refuses unknown keys. A *choice* (`Fuse`, `Motion`, ...) is written as a bare word
(``fuse: product``) or as one key with its settings (``fuse: {pool: equal}``).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, model_validator

LANGUAGE_VERSION = 1

Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,63}$")]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(gt=0, le=1)]
FrameCount = Annotated[int, Field(ge=1, le=1_000_000)]


class Model(BaseModel):
    """Base of every part of the specification: immutable, unknown keys refused, no NaN or infinity."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Choice(Model):
    """Exactly one field is set; written as its name, or as its name with settings."""

    @model_validator(mode="before")
    @classmethod
    def _bare_word(cls, value: Any) -> Any:
        return {value: cls.bare(value)} if isinstance(value, str) else value

    @classmethod
    def bare(cls, word: str) -> Any:
        """What a bare `word` stands for: settings that are all defaults."""
        return {}

    @model_validator(mode="after")
    def _exactly_one(self) -> Self:
        if len(self.chosen()) != 1:
            raise ValueError(f"choose exactly one of {', '.join(type(self).model_fields)}")
        return self

    def chosen(self) -> list[str]:
        """Names of the fields that are set."""
        return [name for name in type(self).model_fields if getattr(self, name) is not None]

    @property
    def kind(self) -> str:
        """Name of the field that is set."""
        return self.chosen()[0]

    @property
    def settings(self) -> Any:
        """Value of the field that is set."""
        return getattr(self, self.kind)


class Empty(Model):
    """A choice without settings."""


# ---------------------------------------------------------------------------------- noise and motion


class PixelSd(Model):
    """Standard deviations in pixels, for a step of one frame interval."""

    x: NotNegative = Field(default=0.0, description="of the centre's column, px")
    y: NotNegative = Field(default=0.0, description="of the centre's row, px")
    w: NotNegative = Field(default=0.0, description="of the width, px")
    h: NotNegative = Field(default=0.0, description="of the height, px")


class BoxSd(Model):
    """Standard deviations as a share of the box's mean side sqrt(w h)."""

    x: NotNegative = Field(default=0.0, description="of the centre's column, sqrt(w h)")
    y: NotNegative = Field(default=0.0, description="of the centre's row, sqrt(w h)")


class LogSd(Model):
    """Standard deviations of the size in logarithms, so that they carry over between sizes."""

    scale: NotNegative = Field(default=0.0, description="of log sqrt(w h)")
    aspect: NotNegative = Field(default=0.0, description="of log(w / h)")


class Wide(Model):
    """A share of the hypotheses moves with a larger sd: heavy tails for sudden motion."""

    share: Annotated[float, Field(gt=0, lt=1)] = Field(description="share of the hypotheses")
    factor: Annotated[float, Field(gt=1)] = Field(description="how many times the position's sd")


class Noise(Model):
    """Gaussian noise of a box; pixel and relative parts add up in variance.

    Variances grow in proportion to the true time between frames.
    """

    sd_px: PixelSd = PixelSd()
    sd_box: BoxSd = BoxSd()
    sd_log: LogSd = LogSd()
    wide: Wide | None = None


class RandomWalk(Noise):
    """Position and size drift by independent noise."""


class ConstantVelocity(Noise):
    """White noise in acceleration: `sd_velocity_px` is the change of velocity in one frame interval.

    `sd_px`, `sd_box`, `sd_log` are added to position and size as in a random walk.
    """

    sd_velocity_px: NotNegative = Field(default=1.0, description="px per frame, per frame interval")
    start_velocity_sd_px: NotNegative = Field(default=5.0, description="sd of the unknown first velocity, px per frame")


class DampedVelocity(ConstantVelocity):
    """As constant velocity, the velocity decaying by `damping` per frame interval.

    Damped velocity of the tracking chapter, eq. 3.91 corrected.
    """

    damping: Annotated[float, Field(gt=0)] = Field(default=0.25, description="velocity decays as exp(-damping dt)")


class ConstantAcceleration(Noise):
    """White noise in the derivative of acceleration."""

    sd_acceleration_px: NotNegative = Field(default=0.5, description="px per frame^2, per frame interval")
    start_velocity_sd_px: NotNegative = Field(default=5.0, description="sd of the unknown first velocity, px per frame")
    start_acceleration_sd_px: NotNegative = Field(
        default=1.0, description="sd of the unknown first acceleration, px per frame^2"
    )


class Motion(Choice):
    """How the target moves between frames."""

    random_walk: RandomWalk | None = None
    constant_velocity: ConstantVelocity | None = None
    damped_velocity: DampedVelocity | None = None
    constant_acceleration: ConstantAcceleration | None = None


# ---------------------------------------------------------------------------------- belief


class EssBelow(Model):
    """Resample when the effective sample size falls below this share of the hypotheses."""

    ess_below: Share


class Particles(Model):
    """A weighted set of hypotheses."""

    size: Annotated[int, Field(ge=2, le=1_000_000)] = Field(default=500, description="number of hypotheses")
    resample: Literal["systematic", "stratified", "residual", "multinomial"] = "systematic"
    when: Literal["every_frame"] | EssBelow = "every_frame"


class Belief(Choice):
    """How the belief is represented."""

    particles: Particles | None = None


class Window(Model):
    """A window around the best hypothesis."""

    box: Positive = Field(default=0.25, description="half width of the window, in sqrt(w h)")


class Estimate(Choice):
    """Which single box stands for the belief in tracks and pictures."""

    map: Empty | None = Field(default=None, description="maximum a posteriori hypothesis, prior density included")
    best: Empty | None = Field(default=None, description="hypothesis with the largest weight")
    mean: Empty | None = Field(default=None, description="weighted mean")
    robust_mean: Window | None = Field(default=None, description="weighted mean inside a window around the best")


# ---------------------------------------------------------------------------------- fusion


class Latent(Model):
    """The node has a state of its own, drawn around its parent's hypothesis by `given`."""

    given: Noise = Field(description="p(own state | parent's state)")
    draw: Literal["one", "kernel"] = Field(
        default="one", description="one draw per hypothesis, O(N); or the row-normalised kernel, O(N^2)"
    )


class Fuse(Choice):
    """How an inference node joins its children's likelihoods."""

    product: Empty | None = Field(default=None, description="children independent given this node")
    pool: Literal["equal"] | dict[Name, Positive] | None = Field(
        default=None, description="log-linear pool; weights are scaled to sum to 1 over the active children"
    )
    latent: Latent | None = Field(default=None, description="a state of its own; children independent given it")

    @classmethod
    def bare(cls, word: str) -> Any:
        """A bare `pool` means equal weights."""
        return "equal" if word == "pool" else {}


# ---------------------------------------------------------------------------------- adaptation


class Level(Choice):
    """A level of the uncertainty deviation UD."""

    ud_px2: Positive | None = Field(default=None, description="in px^2")
    ud_box: Positive | None = Field(default=None, description="as a share of the estimate's area w h")
    ud_quiet: Positive | None = Field(default=None, description="as a multiple of the measured quiet level")


class Activate(Model):
    """Switch agents on when UD stays above a level."""

    above: Level
    frames: FrameCount = Field(default=1, description="consecutive frames above the level")
    which: Literal["all", "most_helpful"] = Field(
        default="all", description="every inactive agent, or the one that contributed most when last active"
    )


class Deactivate(Model):
    """Switch one agent off when UD stays below a level."""

    below: Level
    frames: FrameCount = Field(default=5, description="consecutive frames below the level")
    drop: Literal["largest_kl", "least_contribution_per_ms"] = Field(
        default="largest_kl",
        description="largest KL(belief || agent), or least KL(belief || belief without it) per declared cost",
    )


class Adapt(Model):
    """When agents below an inference node are switched on and off."""

    activate: Activate | None = None
    deactivate: Deactivate | None = None
    keep: Annotated[int, Field(ge=1)] = Field(default=1, description="agents that always stay active")


class Learn(Model):
    """References move toward the estimate while UD is low (eqs. 2.15-2.16 times rate_max)."""

    below: Level
    rate_max: Annotated[float, Field(gt=0, le=1)] = Field(default=0.05, description="largest learning rate per frame")


class Lost(Model):
    """The target counts as lost while UD is above a level, until it has been below as long."""

    above: Level
    frames: FrameCount = 3


class SelfCheck(Model):
    """An agent watches its own uncertainty: acts locally, then stops itself.

    After a self-stop the agent may be switched on again only after `rest` frames; each further self-stop
    doubles its rest, so that it cannot oscillate.
    """

    above: Level
    frames: FrameCount = Field(default=10, description="consecutive frames above the level before it stops")
    rest: FrameCount = Field(default=50, description="frames before it may be switched on again; doubles each time")


# ---------------------------------------------------------------------------------- nodes


class AgentChoice(Model):
    """The cue of an agent: a registered name and its parameters, not yet checked against the cue.

    Written ``agent: motion`` or ``agent: {motion: {sd_px: 2}}``.
    """

    cue: str
    parameters: Mapping[str, Any] = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _from_mapping(cls, value: Any) -> Any:
        if isinstance(value, str):
            return {"cue": value}
        if isinstance(value, Mapping) and set(value) != {"cue", "parameters"} and "cue" not in value:
            if len(value) != 1:
                raise ValueError("an agent names exactly one cue")
            ((cue, parameters),) = value.items()
            return {"cue": cue, "parameters": {} if parameters is None else parameters}
        return value


class InferenceNode(Model):
    """A node that holds a belief about the target, or fuses its children for its parent.

    Example::

        square:
          belief: {particles: {size: 500}}
          fuse: product
          motion: {random_walk: {sd_px: {x: 20, y: 20}}}
    """

    parent: Name | None = Field(default=None, description="the inference node above; absent for the root")
    belief: Belief | None = Field(default=None, description="root only; default 500 particles")
    motion: Motion | None = Field(default=None, description="root only, required there")
    estimate: Estimate | None = Field(default=None, description="root only; default map")
    fuse: Fuse | None = Field(default=None, description="required with two or more children")
    ud_fields: tuple[Literal["x", "y", "w", "h"], ...] = Field(
        default=("x", "y", "w", "h"), min_length=1, description="fields that UD counts"
    )
    adapt: Adapt | None = None
    learn: Learn | None = Field(default=None, description="root only")
    lost: Lost | None = Field(default=None, description="root only; default {above: {ud_box: 1}, frames: 3}")


class AgentNode(Model):
    """A leaf: a visual cue that scores each hypothesis.

    Example::

        histogram: {parent: color, agent: {color_histogram: {bins: 32}}}
    """

    parent: Name
    agent: AgentChoice
    active: bool = Field(default=True, description="whether it is switched on at the start")
    self_check: SelfCheck | None = None
    learn_rate_max: Annotated[float, Field(ge=0, le=1)] | None = Field(
        default=None, description="instead of the root's learn.rate_max; 0 keeps the first reference"
    )


def _node_kind(value: Any) -> str:
    if isinstance(value, AgentNode):
        return "agent"
    return "agent" if isinstance(value, Mapping) and "agent" in value else "inference"


Node = Annotated[
    Annotated[InferenceNode, Tag("inference")] | Annotated[AgentNode, Tag("agent")], Discriminator(_node_kind)
]


class Target(Model):
    """A plate: one copy of this net per target."""

    state: Literal["box"] = Field(default="box", description="x, y, w, h in pixels; (x, y) is the centre")
    nodes: dict[Name, Node] = Field(min_length=1)


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
    name: Name
    about: str = Field(default="", max_length=2000, description="what the graph is for")
    targets: dict[Name, Target] = Field(min_length=1)
