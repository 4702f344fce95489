"""Checks of the tree: one root, known parents, no cycles, agents as leaves and below every inference node."""

from __future__ import annotations

from collections.abc import Iterator

from bayesnet_track.graph.checks.latent import (
    beliefs_have_a_state,
    has_a_state,
    latent_grids_hold_positions,
    latent_nodes_move,
    parts_have_a_whole,
)
from bayesnet_track.graph.checks.plates import Check, Plate
from bayesnet_track.graph.settings.motion import Motion
from bayesnet_track.graph.text.messages import GraphMessage

MAX_LEVELS = 32
ROOT_ONLY = (
    *("motion", "modes", "estimate", "learn", "lost", "score", "localization_error", "distractors"),
    *("guarantee", "alarm"),
)


def parents_exist(plate: Plate) -> Iterator[GraphMessage]:
    """Every parent is a node of the same target."""
    for name, node in plate.spec.nodes.items():
        if node.parent is not None and node.parent not in plate.spec.nodes:
            found = f"unknown parent {node.parent!r}"
            yield plate.message(name, found, plate.inference, key=("parent",), word=node.parent)


def agents_are_leaves(plate: Plate) -> Iterator[GraphMessage]:
    """No agent and no factor has children."""
    for name, node in plate.spec.nodes.items():
        if node.parent in plate.agents or node.parent in plate.factors:
            kind = "an agent, and agents" if node.parent in plate.agents else "a factor, and factors"
            found = f"parent {node.parent!r} is {kind} have no children"
            yield plate.message(name, found, plate.inference, key=("parent",))


def one_root(plate: Plate) -> Iterator[GraphMessage]:
    """Exactly one inference node has no parent."""
    if not plate.inference:
        path = ("targets", plate.name, "nodes")
        yield plate.at.message(path, "no inference node", "one inference node without a parent: the root")
    for name in plate.roots[1:]:
        found = f"a second node without a parent, after {plate.roots[0]!r}"
        others = [other for other in plate.inference if other != name]
        yield plate.message(name, found, f"one root; parent: {others[0]}", on_key=True)


def no_cycles(plate: Plate) -> Iterator[GraphMessage]:
    """Following the parents from any node ends at a root."""
    settled: set[str] = set()
    for start in plate.spec.nodes:
        trail: dict[str, int] = {}
        name: str | None = start
        while name is not None and name in plate.spec.nodes and name not in settled:
            if name in trail:
                cycle = [*list(trail)[trail[name] :], name]
                shown = " -> ".join(cycle if len(cycle) <= 12 else [*cycle[:11], "...", name])
                yield plate.message(name, f"parents in a circle: {shown}", "a tree", key=("parent",))
                break
            trail[name] = len(trail)
            name = plate.spec.nodes[name].parent
        settled |= trail.keys()


def not_too_deep(plate: Plate) -> Iterator[GraphMessage]:
    """A tree has a bounded number of levels."""
    level: dict[str | None, int] = {None: 0}
    for name in plate.order:
        level[name] = level[plate.spec.nodes[name].parent] + 1
        if level[name] == MAX_LEVELS + 1:
            yield plate.message(name, f"level {level[name]} of the tree", f"at most {MAX_LEVELS} levels")


def inference_has_agents(plate: Plate) -> Iterator[GraphMessage]:
    """Every inference node has an agent below it."""
    fed: set[str] = set()
    for agent in plate.agents.values():
        name: str | None = agent.parent
        while name is not None and name not in fed and name in plate.spec.nodes:
            fed.add(name)
            name = plate.spec.nodes[name].parent
    for name in plate.inference:
        if name not in fed:
            yield plate.message(name, "no agent below this inference node", "at least one agent", on_key=True)


def fusion_is_chosen(plate: Plate) -> Iterator[GraphMessage]:
    """A node with two or more children says how it joins them."""
    for name, node in plate.inference.items():
        children = plate.children[name]
        if node.fuse is None and len(children) >= 2:
            found = f"key 'fuse' is missing, and there are {len(children)} children"
            yield plate.message(name, found, ["product", "pool", "latent"])


def root_keys_at_the_root(plate: Plate) -> Iterator[GraphMessage]:
    """Motion, estimate, learning and loss belong to the root; a latent node may have a motion of its own."""
    for name, node in plate.inference.items():
        for key in ROOT_ONLY if node.parent is not None else ():
            if getattr(node, key) is not None and not (key == "motion" and has_a_state(node)):
                where = f"only at the root, {plate.roots[0]}" if plate.roots else "only at the root"
                where += ", or with fuse: latent" if key == "motion" else ""
                yield plate.message(name, f"key {key!r} below the root", where, key=(key,), on_key=True)


def root_moves(plate: Plate) -> Iterator[GraphMessage]:
    """The root says how the target moves."""
    for name in plate.roots[:1]:
        if plate.inference[name].motion is None:
            motions = tuple(Motion.model_fields)
            yield plate.message(name, "key 'motion' is missing at the root", motions)


TREE_CHECKS: tuple[Check, ...] = (
    parents_exist,
    agents_are_leaves,
    one_root,
    no_cycles,
    not_too_deep,
    inference_has_agents,
    fusion_is_chosen,
    root_keys_at_the_root,
    beliefs_have_a_state,
    latent_grids_hold_positions,
    parts_have_a_whole,
    latent_nodes_move,
    root_moves,
)
