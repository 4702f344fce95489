"""A graph that has passed every check: what compilation starts from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from bayesnet_track.graph.expressions.terms import PARENT, Term, names_in
from bayesnet_track.graph.spec import AgentNode, GraphSpec, InferenceNode, Lost, Target, html_of
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.numerics.outlines import GroundView
from bayesnet_track.observation.cue import CueDeclaration, NoParameters, installed_cues
from bayesnet_track.observation.image_files import Mask


@dataclass(frozen=True)
class Factor:
    """An expression that weighs the hypotheses of the node above it.

    Attributes:
        parent: the inference node above it.
        term: the expression.
        constants: the numbers that it uses by name.
        mask: the image that it asks, or None.
    """

    parent: str
    term: Term
    constants: Mapping[str, float]
    mask: Mask | None = None


@dataclass(frozen=True)
class Conditional:
    """p(own box | parent's box) of a latent node, as expressions.

    Attributes:
        fields: field of the own box -> its distribution, a density of the variable `DRAWN`, or its value. One
            that is not named is the parent's.
        constants: the numbers that they use by name.
    """

    fields: Mapping[str, Term]
    constants: Mapping[str, float]

    @property
    def reads(self) -> frozenset[str]:
        """Fields of the parent that they use."""
        words = (word for term in self.fields.values() for word in names_in(term))
        return frozenset(word.removeprefix(PARENT) for word in words if word.startswith(PARENT))


PAST = "@"
"""Between a field and frame intervals: the field of a state as it was so long ago."""


@dataclass(frozen=True, eq=False)
class MeasuredAs:
    """Expressions of the quantities that an agent measures, given a state.

    Attributes:
        terms: quantity -> expression.
        constants: the numbers that they use by name.
        errors: quantity -> distribution of its error, a density of the variable `DRAWN` around 0; empty where
            all errors are Gaussian with an sd that the agent knows.
        discrete: `mode` and each category -> its number in each combination of mode and values, in order;
            empty without either.
        delay: frame intervals before the frame to which the quantities belong.
        late: fields of the state that they are of, where there is a delay.
    """

    terms: Mapping[str, Term]
    constants: Mapping[str, float]
    errors: Mapping[str, Term] = field(default_factory=dict)
    discrete: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    delay: float = 0.0
    late: tuple[str, ...] = ()


ANCHORED = ("x", "y")
"""Fields that a detection of quantities places a new target by, where no `inverse` names others."""


@dataclass(frozen=True, eq=False)
class Anchor:
    """A state whose quantities are known, from which h is followed to invert it.

    Attributes:
        place: (2,) the `ANCHORED` fields.
        values: (K,) its quantities.
    """

    place: Floats
    values: Floats


@dataclass(frozen=True, eq=False)
class Inverse:
    """Start of a target with a detection of quantities.

    Attributes:
        terms: field of the state -> its value by the quantities; empty where h is followed.
        constants: the numbers that they use by name.
        anchor: from which h is followed; None where a detection alone starts no target.
    """

    terms: Mapping[str, Term]
    constants: Mapping[str, float]
    anchor: Anchor | None = None


@dataclass(frozen=True, eq=False)
class Calibration:
    """A camera as a file says it.

    Attributes:
        path: the file.
        sha256: of its bytes, in hexadecimal.
        camera: what it says.
        name: which camera of the file; None where it has one.
    """

    path: Path
    sha256: str
    camera: GroundView
    name: str | None = None


CLOCK = "clock_s"
"""By how much the times of a camera's frames are late, s."""

BY_PLACE = ("x_by_place", "y_by_place")
"""By how much a camera is off, px, beyond what all its targets share."""

RATE = "rate"
"""By how much `CLOCK` grows per second."""


@dataclass(frozen=True)
class LastingError:
    """One coordinate of an error of what sees targets, which lasts from frame to frame: a field of the state.

    It is an Ornstein-Uhlenbeck process, N(0, sd^2) at any time.

    Attributes:
        node: the view whose camera is off, or the agent whose detections are.
        axis: the coordinate of the box in the image, x, y, w or h; one of `BY_PLACE`, of a camera's shift
            that differs from place to place; `CLOCK` of the time, and `RATE`, by which that grows per second.
        sd: its sd, px of a view, s of its clock, and the share of the box's width or height of an agent.
        over_s: time in which its correlation falls to 1 / e.
        is_shared: whether all targets share it, so that it is learnt from all of them together.
    """

    node: str
    axis: str
    sd: float
    over_s: float
    is_shared: bool

    @property
    def field(self) -> str:
        """Name of the field of the state."""
        return f"{self.node}.{self.axis}"

    @property
    def is_clock(self) -> bool:
        """True of the offset and the rate of a camera's clock."""
        return self.axis in (CLOCK, RATE)

    @property
    def is_by_place(self) -> bool:
        """True of a camera's shift that each target has of its own: it is allowed for, and not estimated."""
        return self.axis in BY_PLACE

    @property
    def column(self) -> int:
        """The coordinate of the box."""
        return "xywh".index(self.axis[0])

    @property
    def is_bias(self) -> bool:
        """True of the shift of a camera that all its targets share."""
        return self.is_shared and not self.is_clock

    @property
    def is_px(self) -> bool:
        """True of an error of a camera's calibration, px."""
        return self.is_bias or self.is_by_place


@dataclass(frozen=True, eq=False)
class NamedCamera:
    """A camera of the graph.

    Attributes:
        name: as the graph names it.
        camera: its calibration.
    """

    name: str
    camera: GroundView


@dataclass(frozen=True, eq=False)
class CheckedTarget:
    """One plate, its tree resolved.

    Attributes:
        name: the plate's name.
        spec: its specification.
        root: the inference node without a parent.
        order: every agent and inference node, parents before children, siblings in file order.
        parent: node -> its parent (None for the root).
        children: inference node -> its children in file order.
        parameters: agent -> its cue's typed parameters.
        governor: agent -> the nearest inference node above it whose `adapt` rules may switch it, or None.
        factors: factor node -> its expression, in file order.
        constants: numbers that expressions use by name.
        givens: latent node -> its distribution by expressions, of those that have one.
        measures: agent -> its measurement functions, of those that have some.
        inverses: agent that is given detections of quantities -> how one of them starts a target.
        views: view -> its camera.
        lasting: errors of its cameras and detections that last: the last fields of its states.
    """

    name: str
    spec: Target
    root: str
    order: tuple[str, ...]
    parent: Mapping[str, str | None]
    children: Mapping[str, tuple[str, ...]]
    parameters: Mapping[str, NoParameters]
    governor: Mapping[str, str | None]
    factors: Mapping[str, Factor] = field(default_factory=dict)
    constants: Mapping[str, float] = field(default_factory=dict)
    givens: Mapping[str, Conditional] = field(default_factory=dict)
    measures: Mapping[str, MeasuredAs] = field(default_factory=dict)
    inverses: Mapping[str, Inverse] = field(default_factory=dict)
    views: Mapping[str, NamedCamera] = field(default_factory=dict)
    lasting: tuple[LastingError, ...] = ()

    def __repr__(self) -> str:
        """Name and size."""
        nodes = len(self.order) + len(self.factors)
        return f"CheckedTarget({self.name}: {nodes} nodes, {len(self.agents)} of them agents)"

    @cached_property
    def agents(self) -> tuple[str, ...]:
        """The agent nodes, in `order`."""
        return tuple(name for name in self.order if isinstance(self.spec.nodes[name], AgentNode))

    @property
    def confusions(self) -> dict[str, str]:
        """Agent for which labels of detections are evidence -> the category that they tell of."""
        written = (
            (agent, getattr(parameters, "confusion", {})) for agent, parameters in self.parameters.items()
        )
        return {agent: category for agent, confusion in written for category in confusion}

    @cached_property
    def below(self) -> Mapping[str, frozenset[str]]:
        """Inference node -> the nodes below it, at any depth."""
        descendants: dict[str, frozenset[str]] = {}
        for name in reversed(self.order):  # children before their parents
            if name in self.children:
                children = self.children[name]
                descendants[name] = frozenset(children).union(
                    *(descendants.get(child, frozenset()) for child in children)
                )
        return descendants

    @cached_property
    def lost(self) -> Lost:
        """Rule by which it counts as lost; by default a point is lost if it more probably does not exist."""
        written, existence = self.inference(self.root).lost, self.spec.existence
        if written is not None or self.spec.state == "box" or existence is None:
            return written or Lost()
        return Lost(existence_below=max(0.5, (1.0 + existence.end) / 2), frames=1)

    def seen_by(self, node: str | None) -> NamedCamera | None:
        """The camera of the view at a node or above it; None of a node that is not below a view."""
        while node is not None and node not in self.views:
            node = self.parent[node]
        return None if node is None else self.views[node]

    def camera_of(self, agent: str) -> str:
        """The camera whose image an agent looks at, where there are several; else ""."""
        seen_by = self.seen_by(agent) if len(self.views) > 1 else None
        return "" if seen_by is None else seen_by.name

    def correlation(self, node: str) -> float | None:
        """Of the children's errors, where the pool of an inference node is learned; None elsewhere."""
        spec = self.inference(node)
        if spec.fuse is None or spec.fuse.pool != "learned":
            return None
        return 1.0 if spec.correlation is None else spec.correlation

    def agent(self, name: str) -> AgentNode:
        """The specification of an agent node."""
        node = self.spec.nodes[name]
        assert isinstance(node, AgentNode)
        return node

    def inference(self, name: str) -> InferenceNode:
        """The specification of an inference node."""
        node = self.spec.nodes[name]
        assert isinstance(node, InferenceNode)
        return node


@dataclass(frozen=True, eq=False)
class CheckedGraph:
    """A valid graph.

    Attributes:
        spec: the specification as written.
        targets: plate name -> checked plate.
        text: the canonical YAML of `spec` (what a run directory stores).
        cues: name -> declaration of those of its cues that are not installed, but were given.
        masks: the images of its factors, by their paths as written.
        calibrations: its cameras, by path and name as written (`CameraSource.key`).
    """

    spec: GraphSpec
    targets: Mapping[str, CheckedTarget]
    text: str
    cues: Mapping[str, CueDeclaration] = field(default_factory=dict)
    masks: Mapping[str, Mask] = field(default_factory=dict)
    calibrations: Mapping[str, Calibration] = field(default_factory=dict)

    @property
    def declarations(self) -> Mapping[str, CueDeclaration]:
        """Name -> declaration of every cue that can be used with it: its own, and the installed ones."""
        named = {choice.cue for target in self.spec.targets.values() for _, _, choice in target.cue_choices()}
        return {**installed_cues(named), **self.cues}

    @property
    def image_size(self) -> tuple[int, int] | None:
        """Width and height of the images of its first camera, px; None where no calibration says it."""
        return next((calibration.camera.size for calibration in self.calibrations.values()), None)

    @property
    def several_cameras(self) -> Mapping[str, tuple[int, int] | None]:
        """Width and height of the images of each camera, px, where there are several; else nothing."""
        cameras = self.spec.cameras
        if len(cameras) < 2:
            return {}
        return {name: self.calibrations[source.key].camera.size for name, source in cameras.items()}

    def __repr__(self) -> str:
        """Name and size: the whole specification would fill pages."""
        agents = sum(len(plate.agents) for plate in self.targets.values())
        nodes = sum(len(plate.order) + len(plate.factors) for plate in self.targets.values())
        return f"CheckedGraph({self.spec.name}: {nodes} nodes, {agents} of them agents)"

    def _repr_html_(self) -> str:
        """For notebooks: the picture of each net."""
        return html_of(self, "graph_html")

    def _repr_svg_(self) -> str:
        """For notebooks: the picture of the first plate's net."""
        return html_of(self, "graph_picture")
