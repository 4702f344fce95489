"""Where the nodes of a net stand in its picture: a tree in layers, nothing overlapping. Knows no painter."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import dataclass

from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.graph.settings.net import pool_exponents
from bayesnet_track.graph.spec import AgentNode, FactorNode

MARGIN = 28.0
GAP = 26.0
NODE_HEIGHT = 54.0
LAYER = 132.0
NAME_SIZE = 15.0
NOTE_SIZE = 11.0
ADVANCE = 0.602
"""Width of a letter of a fixed-width font, in em."""
LEGEND_HEIGHT = 46.0
LEGEND_WIDTH = 430.0


@dataclass(frozen=True)
class NodeShape:
    """A node: its centre, size, what is written in it.

    Attributes:
        name: the node.
        note: second line.
        is_agent: an agent (rounded box) or an inference node (ellipse).
        active: an active agent, or an inference node with one below it.
        x: centre, px.
        y: centre, px.
        w: width, px.
        h: height, px.
        is_factor: a factor (rectangle).
    """

    name: str
    note: str
    is_agent: bool
    active: bool
    x: float
    y: float
    w: float
    h: float = NODE_HEIGHT
    is_factor: bool = False


@dataclass(frozen=True)
class EdgeShape:
    """A curve from the foot of a parent to the head of a child, with the child's weight when it has one."""

    start: tuple[float, float]
    end: tuple[float, float]
    active: bool
    label: str = ""

    def bend(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The two inner control points of the cubic curve."""
        middle = (self.start[1] + self.end[1]) / 2
        return (self.start[0], middle), (self.end[0], middle)

    def at(self, t: float) -> tuple[float, float]:
        """The point of the curve at parameter t in 0..1."""
        points = (self.start, *self.bend(), self.end)
        weights = ((1 - t) ** 3, 3 * (1 - t) ** 2 * t, 3 * (1 - t) * t * t, t**3)
        x, y = (sum(w * p[k] for w, p in zip(weights, points, strict=True)) for k in (0, 1))
        return x, y


@dataclass(frozen=True)
class Fork:
    """The word under a node that says how it fuses its children: centre and width, px."""

    text: str
    x: float
    y: float
    w: float
    h: float = 20.0


@dataclass(frozen=True)
class GraphLayout:
    """The whole picture, px."""

    width: float
    height: float
    nodes: tuple[NodeShape, ...]
    edges: tuple[EdgeShape, ...]
    forks: tuple[Fork, ...]


def lay_out(target: CheckedTarget, active: Set[str]) -> GraphLayout:
    """The picture of one plate with these agents active: parents above and centred over their children."""
    widths = {name: _width(target, name) for name in target.order}
    spans: dict[str, float] = {}
    for name in reversed(target.order):
        children = target.children.get(name, ())
        children_width = sum(spans[child] for child in children) + GAP * max(len(children) - 1, 0)
        spans[name] = max(widths[name], children_width)
    width = max(spans[target.root], LEGEND_WIDTH)
    left = {target.root: MARGIN + (width - spans[target.root]) / 2}
    depth = {target.root: 0}
    for name in target.order:
        children = target.children.get(name, ())
        children_width = sum(spans[child] for child in children) + GAP * max(len(children) - 1, 0)
        x = left[name] + (spans[name] - children_width) / 2
        for child in children:
            left[child], depth[child] = x, depth[name] + 1
            x += spans[child] + GAP
    centre: dict[str, float] = {}
    for name in reversed(target.order):
        children = target.children.get(name, ())
        ideal = (centre[children[0]] + centre[children[-1]]) / 2 if children else left[name] + spans[name] / 2
        half = widths[name] / 2
        centre[name] = min(max(ideal, left[name] + half), left[name] + spans[name] - half)
    alive = _alive(target, active)
    top = MARGIN + NODE_HEIGHT / 2
    nodes = tuple(
        NodeShape(
            name,
            _note(target, name),
            isinstance(target.spec.nodes[name], AgentNode),
            name in alive,
            centre[name],
            top + LAYER * depth[name],
            widths[name],
            is_factor=name in target.factors,
        )
        for name in target.order
    )
    shape = {node.name: node for node in nodes}
    forks = {name: _fork(target, shape[name]) for name in target.order}
    edges = tuple(
        _edge(target, shape[parent], shape[child], forks[parent], alive)
        for child in target.order
        if (parent := target.parent[child]) is not None
    )
    height = 2 * MARGIN + NODE_HEIGHT + LAYER * max(depth.values()) + LEGEND_HEIGHT
    return GraphLayout(
        width + 2 * MARGIN, height, nodes, edges, tuple(f for f in forks.values() if f is not None)
    )


def pool_weights(target: CheckedTarget, node: str, alive: Set[str]) -> dict[str, float]:
    """Child -> weight in the log-linear pool of `node`, over the children that are alive."""
    fuse = target.inference(node).fuse
    if fuse is None or fuse.pool is None:
        return {}
    children = [child for child in target.children[node] if child in alive and child not in target.factors]
    return pool_exponents(fuse.shares(children), target.correlation(node))


def _alive(target: CheckedTarget, active: Set[str]) -> frozenset[str]:
    """The active agents and every node above one, and the factors."""
    alive: set[str] = set(target.factors)
    for agent in set(target.agents) & set(active):
        node: str | None = agent
        while node is not None and node not in alive:
            alive.add(node)
            node = target.parent[node]
    return frozenset(alive)


def _note(target: CheckedTarget, name: str) -> str:
    node = target.spec.nodes[name]
    if isinstance(node, AgentNode):
        return "" if node.agent.cue == name else node.agent.cue
    if isinstance(node, FactorNode):
        return "factor"
    if name != target.root:
        belief_text = "" if node.belief is None else f", {node.belief.kind}"
        latent = None if node.fuse is None else node.fuse.latent
        return "" if latent is None else f"{'part' if latent.given.is_part else 'own state'}{belief_text}"
    belief = "particles" if node.belief is None else node.belief.kind
    return belief if node.motion is None else f"{belief}, {node.motion.kind.replace('_', ' ')}"


def _width(target: CheckedTarget, name: str) -> float:
    text = ADVANCE * max(NAME_SIZE * len(name), NOTE_SIZE * len(_note(target, name)))
    # A line of text ends where an ellipse is already narrow: its box is wider than the text by half.
    is_agent = isinstance(target.spec.nodes[name], AgentNode)
    return max(text + 32.0 if is_agent else text * 1.25 + 40.0, 110.0)


def _fork(target: CheckedTarget, parent: NodeShape) -> Fork | None:
    if parent.is_agent or parent.is_factor:
        return None
    fuse = target.inference(parent.name).fuse
    if fuse is None or (len(target.children[parent.name]) < 2 and fuse.latent is None):
        return None
    return Fork(
        fuse.kind, parent.x, parent.y + parent.h / 2 + 18.0, ADVANCE * NOTE_SIZE * len(fuse.kind) + 18.0
    )


def _edge(
    target: CheckedTarget, parent: NodeShape, child: NodeShape, fork: Fork | None, alive: Set[str]
) -> EdgeShape:
    foot = parent.y + parent.h / 2 if fork is None else fork.y + fork.h / 2
    weight = pool_weights(target, parent.name, alive).get(child.name)
    label = "" if weight is None else f"{weight:.2f}"
    return EdgeShape((parent.x, foot), (child.x, child.y - child.h / 2), child.name in alive, label)
