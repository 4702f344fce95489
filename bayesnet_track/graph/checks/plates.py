"""What every check looks at: one target of a graph, where its parts stand, and the installed cues."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property

from bayesnet_track.graph.checked import Calibration
from bayesnet_track.graph.expressions.terms import PARENT
from bayesnet_track.graph.settings.cameras import CameraSource
from bayesnet_track.graph.settings.motion import Motion
from bayesnet_track.graph.spec import AgentNode, FactorNode, GraphSpec, InferenceNode, Target
from bayesnet_track.graph.text.messages import GraphMessage, KeyPath, Positions
from bayesnet_track.observation.cue import CueDeclaration
from bayesnet_track.observation.image_files import Mask
from bayesnet_track.observation.planes import BEFORE
from bayesnet_track.observation.protocols import BOX


@dataclass(frozen=True, eq=False)
class Plate:
    """One target under examination.

    Attributes:
        name: the target's name.
        spec: its specification.
        at: where its parts stand.
        cues: installed cues by name.
        constants: numbers that expressions use by name.
        inputs: names of what is known of every frame beside its image.
        masks: images by their paths as written; one that cannot be read as what is wrong with it.
        cameras: cameras by name, in the same way.
        sources: the same as the graph has them.
    """

    name: str
    spec: Target
    at: Positions
    cues: Mapping[str, CueDeclaration]
    constants: Mapping[str, float] = field(default_factory=dict)
    masks: Mapping[str, Mask | str] = field(default_factory=dict)
    inputs: tuple[str, ...] = ()
    cameras: Mapping[str, Calibration | str] = field(default_factory=dict)
    sources: Mapping[str, CameraSource] = field(default_factory=dict)

    @property
    def frame_names(self) -> tuple[str, ...]:
        """Names that are the same of all states in a frame: time, inputs, and what they were."""
        return names_of_inputs(self.inputs)

    @cached_property
    def agents(self) -> dict[str, AgentNode]:
        """The agent nodes in file order."""
        return {name: node for name, node in self.spec.nodes.items() if isinstance(node, AgentNode)}

    @cached_property
    def inference(self) -> dict[str, InferenceNode]:
        """The inference nodes in file order."""
        return {name: node for name, node in self.spec.nodes.items() if isinstance(node, InferenceNode)}

    @cached_property
    def factors(self) -> dict[str, FactorNode]:
        """The factor nodes in file order."""
        return {name: node for name, node in self.spec.nodes.items() if isinstance(node, FactorNode)}

    @cached_property
    def roots(self) -> list[str]:
        """The inference nodes without a parent."""
        return [name for name, node in self.inference.items() if node.parent is None]

    @cached_property
    def children(self) -> dict[str, list[str]]:
        """Every node -> the agents and inference nodes that name it as parent, in file order."""
        children: dict[str, list[str]] = {name: [] for name in self.spec.nodes}
        for name, node in self.spec.nodes.items():
            if node.parent in children and name not in self.factors:
                children[node.parent].append(name)
        return children

    @cached_property
    def order(self) -> list[str]:
        """Every agent and inference node under a root, parents before children, siblings in file order."""
        order: list[str] = []
        waiting = self.roots[::-1]
        while waiting:
            order.append(waiting.pop())
            waiting += self.children[order[-1]][::-1]
        return order

    @cached_property
    def governor(self) -> dict[str, str | None]:
        """Agent -> the nearest inference node above it whose `adapt` may switch it (for a valid tree)."""
        return {name: self._governor(name) for name in self.order if name in self.agents}

    def _governor(self, agent: str) -> str | None:
        ancestor = self.spec.nodes[agent].parent
        while ancestor is not None:
            node = self.spec.nodes[ancestor]
            adapt = node.adapt if isinstance(node, InferenceNode) else None
            if adapt is not None and (adapt.agents is None or agent in adapt.agents):
                return ancestor
            ancestor = node.parent
        return None

    def below(self, node: str) -> list[str]:
        """The nodes below an inference node, at any depth (for a valid tree)."""
        descendants = {node: None}
        for name in self.order:
            if self.spec.nodes[name].parent in descendants:
                descendants[name] = None
        return list(descendants)[1:]

    def left_to(self, node: str) -> list[str]:
        """The agents below a node that no rule nearer by switches; `adapt.agents` may leave some out."""
        descendants = self.below(node)
        return [
            agent
            for agent, governor in self.governor.items()
            if agent in descendants and governor not in descendants
        ]

    def governed(self, node: str) -> list[str]:
        """The agents whose rules are those of `node`."""
        return [agent for agent, governor in self.governor.items() if governor == node]

    def parent_names(self, latent: str) -> tuple[str, ...]:
        """Names of the state around which a latent node's is drawn: a box, and what the root's state adds."""
        fields = () if is_seen(self.spec, latent) else further_fields(self.inference[self.roots[0]])
        return tuple(f"{PARENT}{name}" for name in (*BOX, *fields))

    def message(
        self,
        node: str,
        fault: str,
        remedy: str | Iterable[str] = "",
        *,
        key: KeyPath = (),
        word: str = "",
        on_key: bool = False,
    ) -> GraphMessage:
        """An error at `key` inside `node`."""
        path = ("targets", self.name, "nodes", written_name(node), *key)
        return self.at.message(path, fault, remedy, word=word, on_key=on_key)


Check = Callable[[Plate], Iterator[GraphMessage]]
"""One pass: yields every violation it finds in a plate."""


def written_name(node: str) -> str:
    """The name that a node has in the graph's text: `view` of the node `view.north` of one camera."""
    return node.partition(".")[0]


def camera_above(target: Target, name: str | None) -> str | None:
    """The camera whose image a node is about, of a target with one camera to a view; None of others."""
    seen_by = _cameras_above(target, name)
    return seen_by[0] if seen_by else None


def is_seen(target: Target, name: str | None) -> bool:
    """True at a view and below it, where boxes are in pixels."""
    return bool(_cameras_above(target, name))


def _cameras_above(target: Target, name: str | None) -> tuple[str, ...]:
    passed: set[str] = set()
    while name is not None and name in target.nodes and name not in passed:
        passed.add(name)
        node = target.nodes[name]
        if isinstance(node, InferenceNode) and node.seen_by:
            return node.seen_by
        name = node.parent
    return ()


FURTHER = {
    "constant_velocity": ("vx", "vy"),
    "damped_velocity": ("vx", "vy"),
    "constant_acceleration": ("vx", "vy", "ax", "ay"),
    "box_velocity": ("vx", "vy", "vw", "vh"),
}

UPWARDS = ("z", "vz", "az")
"""Fields of the third axis of a state in space, as many as an axis has derivatives."""


def fields_of_motion(motion: Motion) -> tuple[str, ...]:
    """Fields of the state beside the box, of one motion."""
    if motion.expressions is not None:
        return tuple(motion.expressions.own)
    angle = ("angle",) if motion.settings.sd_angle_deg > 0 else ()
    return (*FURTHER.get(motion.kind, ()), *angle)


def further_fields(root: InferenceNode) -> tuple[str, ...]:
    """Fields of a root's state beside the box that evidence may read: a grid takes it at places only."""
    on_grid = root.belief is not None and root.belief.grid is not None
    return () if on_grid else moving_fields(root)


def ground_fields(target: Target) -> tuple[str, ...]:
    """Numbers of a state in metres, as results name them: where it is, then the motion's own fields."""
    root, upright = root_of(target), upright_fields(target)
    places = (*BOX, *upright[:1])
    return (*(f"{name}_m" for name in places), *(moving_fields(root) if root else ()), *upright[1:])


def upright_fields(target: Target) -> tuple[str, ...]:
    """Fields of the third axis of a state in space; none of another."""
    root = root_of(target)
    if root is None or root.motion is None or not target.is_space:
        return ()
    return UPWARDS[: 1 + len(FURTHER.get(root.motion.kind, ())) // 2]


def discrete_fields(root: InferenceNode) -> tuple[str, ...]:
    """Names in expressions of a root that has modes or categories."""
    return (*(("mode",) if root.modes else ()), *(root.category or ()))


def mode_numbers(root: InferenceNode) -> dict[str, float]:
    """Names of modes and of values of categories, with the numbers that expressions compare."""
    numbers = {name: float(number) for number, name in enumerate(root.modes or {})}
    for category in (root.category or {}).values():
        numbers |= {value: float(number) for number, value in enumerate(category.values)}
    return numbers


def root_of(target: Target) -> InferenceNode | None:
    """The root of a kind of target; None of one without, which another check refuses."""
    nodes = target.nodes.values()
    return next((node for node in nodes if isinstance(node, InferenceNode) and node.parent is None), None)


def numbers_of_kinds(spec: GraphSpec, kinds: Iterable[str]) -> dict[str, float]:
    """Names of numbers in an expression about targets of some kinds: constants, modes, values of categories.

    A mode or a value is left out that has different numbers in two kinds.
    """
    numbers: dict[str, float] = {}
    reserved: set[str] = set()
    for kind in dict.fromkeys(kinds):
        root = root_of(spec.targets[kind])
        root_numbers = {} if root is None else mode_numbers(root)
        reserved |= {
            name for name in root_numbers.keys() & numbers.keys() if root_numbers[name] != numbers[name]
        }
        numbers |= root_numbers
    free = {name: number for name, number in numbers.items() if name not in reserved}
    return {**free, **spec.constants}


def names_of_inputs(inputs: Iterable[str]) -> tuple[str, ...]:
    """Names that are the same of all states in a frame: time, inputs, and what they were."""
    return ("t", *(variable for name in inputs for variable in (name, f"{name}{BEFORE}")))


def moving_fields(root: InferenceNode) -> tuple[str, ...]:
    """Fields of a root's state beside the box, of the motions of all modes."""
    if root.motion is None:
        return ()
    motions = (root.motion, *(mode.motion for mode in (root.modes or {}).values() if mode.motion is not None))
    return tuple(dict.fromkeys(name for motion in motions for name in fields_of_motion(motion)))
