"""The specification: a graph as data, with the same words in Python as in YAML.

Every model is frozen and refuses unknown keys. A *choice* (`Fuse`, `Motion`, ...) is written as a bare word
(``fuse: product``) or as one key with its settings (``fuse: {pool: equal}``). All names of
`settings` can be imported from here.
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag

from bayesnet_track.graph.rules.self_check import SelfCheck
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
)
from bayesnet_track.graph.settings.base import (
    AgentChoice,
    Choice,
    Empty,
    Model,
    Name,
    Number,
    word_or_mapping,
)
from bayesnet_track.graph.settings.beliefs import (
    AdaptiveSize,
    BinnedSize,
    EssBelow,
    Gaussian,
    Grid,
    LikelihoodSize,
    NormalSize,
    Particles,
    Reset,
    Unscented,
)
from bayesnet_track.graph.settings.cameras import (
    MOST_INPUTS,
    AdaptCameras,
    CameraSource,
    FrameInput,
    Ground,
    Inputs,
    WorldState,
)
from bayesnet_track.graph.settings.lifecycle import (
    Attachment,
    Birth,
    Confirm,
    Death,
    DetectorChoice,
    Exclusion,
    Existence,
    Identity,
    Join,
    MergeDuplicates,
    MergeOrNever,
    Occlusion,
    Reidentify,
    ReidentifyOrNever,
    Together,
)
from bayesnet_track.graph.settings.motion import (
    BoxSd,
    BoxVelocity,
    ByExpressions,
    ConstantAcceleration,
    ConstantVelocity,
    DampedVelocity,
    HeavyTail,
    Hidden,
    Inflate,
    LogSd,
    LookedFor,
    Mode,
    Motion,
    Moving,
    Noise,
    OwnField,
    PixelSd,
    Probes,
    RandomWalk,
    Relocalize,
    SizeReversion,
    Sudden,
)
from bayesnet_track.graph.settings.net import (
    AgentNode,
    Belief,
    Estimate,
    FactorNode,
    Fuse,
    Given,
    InferenceNode,
    Latent,
    Nearest,
    Node,
    OffsetBox,
    SizeBox,
    Window,
)
from bayesnet_track.graph.settings.queries import MOST_QUERIES, Counted, Crossing, Query
from bayesnet_track.graph.settings.scores import (
    Alarm,
    Distractors,
    Guarantee,
    Localization,
    Logistic,
    Score,
    Verifier,
)

_DRAWN_BY = "bayesnet_track.view.notebook"


def html_of(thing: Any, how: str) -> str:
    """HTML of a thing by the function `how` of the room that draws."""
    return str(getattr(import_module(_DRAWN_BY), how)(thing))


LANGUAGE_VERSION = 1


class Target(Model):
    """A plate: one copy of this net per target."""

    state: Annotated[
        Annotated[Literal["box", "point"], Tag("word")] | Annotated[WorldState, Tag("mapping")],
        Discriminator(lambda value: "mapping" if value == "ground" else word_or_mapping(value)),
    ] = Field(
        default="box",
        description="`box`: x, y, w, h in pixels, (x, y) the centre; `point`: x, y alone, in the unit of its "
        "[sensors](any_sensor.md); `{ground: {unit: m}}`: in metres on the ground, seen by "
        "[cameras](metres.md); `{space: {size: ..}}`: the same [in space](space.md)",
    )
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
    identity: Identity | None = Field(
        default=None,
        description="who is who after targets came close, with a probability; default: not asked",
    )
    associate: Literal["assignment", "marginal"] = Field(
        default="assignment",
        description="how agents that measure by detections are given them: the best assignment, or each "
        "target by every detection that may be its own, as probable as it is that it is (JPDA)",
    )
    nodes: dict[Name, Node] = Field(min_length=1, description="the net: one tree under its root")

    @property
    def is_ground(self) -> bool:
        """True where the state is in metres, on the ground or in space."""
        return isinstance(self.state, WorldState)

    @property
    def is_space(self) -> bool:
        """True where the state is in metres in space."""
        return isinstance(self.state, WorldState) and self.state.space is not None

    def cue_choices(self) -> Iterator[tuple[str, tuple[str, ...], AgentChoice]]:
        """Node, keys inside it, and the cue chosen there: those of agents, and of verifiers of a score."""
        for name, node in self.nodes.items():
            if isinstance(node, AgentNode):
                yield name, ("agent",), node.agent
            elif isinstance(node, InferenceNode) and node.score is not None:
                for verifier, settings in node.score.settings.verifiers.items():
                    yield name, ("score", "logistic", "verifiers", verifier, "agent"), settings.agent


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
    inputs: Inputs = Field(
        default={},
        max_length=MOST_INPUTS,
        description="[columns of CSV files](expressions.md#inputs) that expressions use by name",
    )
    cameras: dict[Name, CameraSource] = Field(
        default={}, max_length=16, description="cameras that see targets on the ground, by name"
    )
    adapt: AdaptCameras | None = Field(
        default=None, description="how [cameras are switched](choosing_cameras.md); default: all are on"
    )
    targets: dict[Name, Target] = Field(min_length=1, description="kinds of targets, by name")
    joins: tuple[Join, ...] = Field(
        default=(), max_length=64, description="how targets depend on each other; default not at all"
    )
    queries: dict[Name, Query] = Field(
        default={},
        max_length=MOST_QUERIES,
        description="[questions](count_measure_ask.md) that the beliefs answer in every frame, by name",
    )

    def _repr_html_(self) -> str:
        """For notebooks: the picture of each net, or what is wrong with the graph."""
        return html_of(self, "spec_html")
