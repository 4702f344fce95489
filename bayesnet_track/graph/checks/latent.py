"""Checks of the tree and of its latent nodes, and the form in which each state is held."""

from __future__ import annotations

from collections.abc import Container, Iterator
from typing import Literal

from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.graph.checks.plates import Check, Plate
from bayesnet_track.graph.expressions.terms import PARENT, names_in
from bayesnet_track.graph.settings.motion import Motion, Moving
from bayesnet_track.graph.settings.net import Given
from bayesnet_track.graph.spec import InferenceNode, Latent, Noise, PixelSd
from bayesnet_track.graph.text.messages import GraphMessage


def beliefs_have_a_state(plate: Plate) -> Iterator[GraphMessage]:
    """Below the root a belief is about a latent node's own state; other nodes have none."""
    for name, node in plate.inference.items():
        if node.parent is None or node.belief is None:
            continue
        if has_a_state(node):
            yield from _without_settings(plate, name, node)
            continue
        remedy = f"at the root, {plate.roots[0]}" if plate.roots else "at the root"
        fault = "key 'belief' at a node without a state of its own"
        yield plate.message(name, fault, f"{remedy}, or with fuse: latent", key=("belief",), on_key=True)


def _without_settings(plate: Plate, name: str, node: InferenceNode) -> Iterator[GraphMessage]:
    assert node.belief is not None and node.fuse is not None and node.fuse.latent is not None
    kind = node.belief.kind
    for setting in sorted(node.belief.settings.model_fields_set):
        fault = f"{setting} has no effect below the root: a latent node has its parent's hypotheses"
        yield plate.message(name, fault, f"belief: {kind}", key=("belief", kind, setting), on_key=True)
    if kind != "particles" and "draw" in node.fuse.latent.model_fields_set:
        fault = f"draw says how particles are joined, and the belief here is {kind}"
        key = ("fuse", "latent", "draw")
        yield plate.message(name, fault, "belief: particles, or no draw", key=key, on_key=True)


def parts_have_a_whole(plate: Plate) -> Iterator[GraphMessage]:
    """A part lies in the box of a node above: the root is no part."""
    for name, node in plate.inference.items():
        if node.parent is not None or node.fuse is None or node.fuse.latent is None:
            continue
        conditional = node.fuse.latent.given
        for key in sorted({"offset_box", "size_box", *conditional.written} & conditional.model_fields_set):
            fault = f"{key} at the root, which is no part of anything"
            path = ("fuse", "latent", "given", key)
            yield plate.message(name, fault, "a node below the root", key=path, on_key=True)


def latent_nodes_move(plate: Plate) -> Iterator[GraphMessage]:
    """A latent node's motion is a random walk in px, by at most the noise of `given`.

    Its deviations are fields of the root's states: these are particles drawn from the motion.
    """
    moving = [name for name, node in plate.inference.items() if node.parent is not None and node.motion]
    for name in moving:
        node = plate.inference[name]
        if node.motion is None or node.fuse is None or node.fuse.latent is None:
            continue
        if node.motion.random_walk is None:
            fault = f"{node.motion.kind} at a latent node, whose motion is that of a deviation"
            yield plate.message(name, fault, ["random_walk"], key=("motion", node.motion.kind), on_key=True)
            continue
        yield from _walk_in_px(plate, name, node.motion.random_walk, node.fuse.latent)
        if node.belief is not None and node.belief.particles is None:
            fault = f"motion beside belief: {node.belief.kind}, which is made anew in each frame"
            yield plate.message(name, fault, "belief: particles, or none", key=("motion",), on_key=True)
    for root in plate.roots[:1] if moving else ():
        yield from _states_hold_deviations(plate, root, moving[0])


def _walk_in_px(plate: Plate, name: str, walk: Moving, latent: Latent) -> Iterator[GraphMessage]:
    path = ("motion", "random_walk")
    defaults = type(walk)()
    for setting in sorted(walk.model_fields_set - {"sd_px"}):
        if getattr(walk, setting) == getattr(defaults, setting):
            continue
        fault = f"{setting} in the motion of a latent node"
        yield plate.message(name, fault, ["sd_px"], key=(*path, setting), on_key=True)
    conditional = latent.given
    if conditional.written:
        fault = "given by expressions, and a deviation that moves is Gaussian in px"
        yield plate.message(name, fault, "sd_px, or no motion", key=("fuse", "latent", "given"))
        return
    extra = [*beyond_position(Noise(sd_box=conditional.sd_box, sd_log=conditional.sd_log))]
    extra += ["heavy_tail"] if conditional.heavy_tail is not None else []
    if extra:
        fault = f"given has {', '.join(extra)}, and a deviation that moves is Gaussian in px"
        yield plate.message(name, fault, "sd_px alone, or no motion", key=("fuse", "latent", "given"))
    if latent.draw == "kernel":
        key = ("fuse", "latent", "draw")
        fault = "draw beside motion: what moves is not drawn anew"
        yield plate.message(name, fault, "no draw, or no motion", key=key, on_key=True)
    for axis in PixelSd.model_fields:
        step, limit = getattr(walk.sd_px, axis), getattr(conditional.sd_px, axis)
        if (step > 0) != (limit > 0) or step > limit:
            fault = f"sd_px.{axis} is {step:g} a frame, and given's is {limit:g} in the long run"
            remedy = f"above 0 and at most {limit:g}" if limit > 0 else f"no {axis}, or noise of it in given"
            key = (*path, "sd_px", *((axis,) if axis in walk.sd_px.model_fields_set else ()))
            yield plate.message(name, fault, remedy, key=key)


def _states_hold_deviations(plate: Plate, root: str, first: str) -> Iterator[GraphMessage]:
    node, moves = plate.inference[root], f"{first!r} has a motion"
    if node.belief is not None and node.belief.particles is None:
        fault = f"belief: {node.belief.kind}, and {moves} of its own"
        yield plate.message(root, fault, "belief: particles", key=("belief", node.belief.kind), on_key=True)
    elif node.belief is not None and node.belief.settings.proposal.kind != "bootstrap":
        kind = node.belief.settings.proposal.kind
        fault = f"proposal: {kind}, and {moves} of its own"
        key = ("belief", "particles", "proposal")
        yield plate.message(root, fault, "proposal: bootstrap", key=key, on_key=True)


def latent_grids_hold_positions(plate: Plate) -> Iterator[GraphMessage]:
    """A latent node's grid has cells for x and y only, and one noise for all of them."""
    for name, node in plate.inference.items():
        latent = node.fuse.latent if node.fuse is not None else None
        if node.parent is None or latent is None or node.belief is None or node.belief.grid is None:
            continue
        if latent.given.written:
            continue
        still = [axis for axis in ("x", "y") if getattr(latent.given.sd_px, axis) == 0]
        if still:
            fault = f"given has no noise in {' and '.join(still)}, and the grid has cells for both x and y"
            remedy = "sd_px with x and y, or belief: gaussian or particles"
            yield plate.message(name, fault, remedy, key=("fuse", "latent", "given"))
        extra = beyond_position(latent.given)
        if extra:
            fault = f"a latent node's grid has no cells for {', '.join(extra)}"
            remedy = "sd_px of x and y alone, or belief: gaussian or particles"
            yield plate.message(name, fault, remedy, key=("fuse", "latent", "given"))
        for ancestor, noise in _noises_above(plate, name):
            sized = [part for part in beyond_position(noise) if not part.startswith("sd_box")]
            if sized:
                noises = ", ".join(sized)
                fault = f"the size changes by {noises} of {ancestor!r}, and the grid has no cells for it"
                remedy = "a size that rests, or belief: gaussian or particles"
                yield plate.message(name, fault, remedy, key=("belief",))


def has_a_state(node: InferenceNode) -> bool:
    """True if it has a state of its own."""
    return node.fuse is not None and node.fuse.latent is not None


def beyond_position(noise: Noise) -> list[str]:
    """The noise that a grid over x and y has no cells for; `sd_box` of a motion is none of it."""
    parts = {"sd_px": ("w", "h"), "sd_box": ("x", "y"), "sd_log": ("scale", "aspect")}
    return [
        f"{part}.{field}"
        for part, fields in parts.items()
        for field in fields
        if getattr(getattr(noise, part), field) > 0
    ]


def _noises_above(plate: Plate, name: str) -> Iterator[tuple[str, Noise]]:
    """The nodes above, up to the root, with noise that moves the state: latent ones and the root's motion."""
    ancestor = plate.inference[name].parent
    visited: set[str] = set()
    while ancestor is not None and ancestor in plate.inference and ancestor not in visited:
        visited.add(ancestor)
        node = plate.inference[ancestor]
        if node.parent is None and node.motion is not None:
            yield ancestor, node.motion.settings
        elif node.fuse is not None and node.fuse.latent is not None:
            yield ancestor, node.fuse.latent.given
        ancestor = node.parent


Form = Literal["one", "kernel", "gaussian", "grid"]


def form_of(target: CheckedTarget, node: str, measuring: Container[str]) -> Form:
    """Form of a latent node's own state; `measuring` are the agents that say where the target is.

    As `belief` or `draw` say. Without them the integral over the state is exact where it can be: a Gaussian,
    if all below is measured; a grid, if only x and y are uncertain; else one draw per hypothesis. What moves
    is a part of the root's state. The belief of a root is about the target, not its own state.
    """
    fuse = target.inference(node).fuse
    assert fuse is not None and fuse.latent is not None
    is_root = node == target.root
    if not is_root and target.inference(node).motion is not None:
        return "one"
    belief = None if is_root else target.inference(node).belief
    if belief is not None and belief.kind != "particles":
        return "gaussian" if belief.kind == "gaussian" else "grid"
    if belief is not None or fuse.latent.draw is not None:
        return fuse.latent.draw or "one"
    if is_root or _asks_for_parent(target, node):
        return "one"
    if _is_linear(fuse.latent.given) and _is_measured(target, node, measuring):
        return "gaussian"
    return "grid" if _fits_cells(target, node, fuse.latent.given) else "one"


def _asks_for_parent(target: CheckedTarget, node: str) -> bool:
    """True if a factor weighs pairs of a draw and its parent, which only draws that go together have."""
    return any(
        _state_above(target, factor.parent) == node
        and any(name.startswith(PARENT) for name in names_in(factor.term))
        for factor in target.factors.values()
    )


def _state_above(target: CheckedTarget, node: str | None) -> str | None:
    while node is not None and not is_latent(target, node):
        node = target.parent[node]
    return node


def is_latent(target: CheckedTarget, node: str) -> bool:
    """True if an inference node has a state of its own beside the root's."""
    fuse = target.inference(node).fuse
    return fuse is not None and fuse.latent is not None


def _is_linear(conditional: Given) -> bool:
    """True if the state is the parent's box times a matrix, with Gaussian noise in px."""
    sized = [part for part in beyond_position(conditional) if not part.startswith("sd_px")]
    return not conditional.written and conditional.heavy_tail is None and not sized


def _is_measured(target: CheckedTarget, node: str, measuring: Container[str]) -> bool:
    """True if all that is said of a node's state are linear measurements."""
    if any(factor.parent == node for factor in target.factors.values()):
        return False
    for child in target.children[node]:
        if child not in target.children:
            if child not in measuring or child in target.measures:
                return False
        elif is_latent(target, child):
            if form_of(target, child, measuring) != "gaussian":
                return False
        elif not _is_measured(target, child, measuring):
            return False
    return True


def _fits_cells(target: CheckedTarget, node: str, conditional: Given) -> bool:
    """True if a grid over x and y, with one noise for all cells, holds all that is uncertain."""
    spreads = conditional.sd_px.x > 0 and conditional.sd_px.y > 0 and not beyond_position(conditional)
    return spreads and all(_keeps_size(target, ancestor) for ancestor in _nodes_above(target, node))


def _nodes_above(target: CheckedTarget, node: str) -> Iterator[str]:
    ancestor: str | None = node
    while ancestor is not None:
        yield ancestor
        ancestor = target.parent[ancestor]


def _keeps_size(target: CheckedTarget, node: str) -> bool:
    """True if all boxes of a state have one size, if those above it have."""
    inference_node = target.inference(node)
    noises: list[object] = []
    if inference_node.fuse is not None and inference_node.fuse.latent is not None:
        noises.append(None if inference_node.fuse.latent.given.written else inference_node.fuse.latent.given)
    if node == target.root and inference_node.motion is not None:
        noises.append(
            None if inference_node.motion.box_velocity is not None else inference_node.motion.settings
        )
    return all(
        isinstance(noise, Noise) and all(part.startswith("sd_box") for part in beyond_position(noise))
        for noise in noises
    )


MAX_LEVELS = 32
ROOT_ONLY = (
    *("motion", "start", "modes", "category", "estimate", "learn", "lost", "score", "localization_error"),
    *("distractors", "guarantee", "alarm"),
)


def parents_exist(plate: Plate) -> Iterator[GraphMessage]:
    """Every parent is a node of the same target."""
    for name, node in plate.spec.nodes.items():
        if node.parent is not None and node.parent not in plate.spec.nodes:
            fault = f"unknown parent {node.parent!r}"
            yield plate.message(name, fault, plate.inference, key=("parent",), word=node.parent)


def agents_are_leaves(plate: Plate) -> Iterator[GraphMessage]:
    """No agent and no factor has children."""
    for name, node in plate.spec.nodes.items():
        if node.parent in plate.agents or node.parent in plate.factors:
            kind = "an agent, and agents" if node.parent in plate.agents else "a factor, and factors"
            fault = f"parent {node.parent!r} is {kind} have no children"
            yield plate.message(name, fault, plate.inference, key=("parent",))


def one_root(plate: Plate) -> Iterator[GraphMessage]:
    """Exactly one inference node has no parent."""
    if not plate.inference:
        path = ("targets", plate.name, "nodes")
        yield plate.at.message(path, "no inference node", "one inference node without a parent: the root")
    for name in plate.roots[1:]:
        fault = f"a second node without a parent, after {plate.roots[0]!r}"
        candidates = [candidate for candidate in plate.inference if candidate != name]
        yield plate.message(name, fault, f"one root; parent: {candidates[0]}", on_key=True)


def no_cycles(plate: Plate) -> Iterator[GraphMessage]:
    """Following the parents from any node ends at a root."""
    settled: set[str] = set()
    for start in plate.spec.nodes:
        trail: dict[str, int] = {}
        name: str | None = start
        while name is not None and name in plate.spec.nodes and name not in settled:
            if name in trail:
                cycle = [*list(trail)[trail[name] :], name]
                chain = " -> ".join(cycle if len(cycle) <= 12 else [*cycle[:11], "...", name])
                yield plate.message(name, f"parents in a circle: {chain}", "a tree", key=("parent",))
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
            fault = f"key 'fuse' is missing, and there are {len(children)} children"
            yield plate.message(name, fault, ["product", "pool", "latent"])


def root_keys_at_the_root(plate: Plate) -> Iterator[GraphMessage]:
    """Motion, estimate, learning and loss belong to the root; a latent node may have a motion of its own."""
    for name, node in plate.inference.items():
        for key in ROOT_ONLY if node.parent is not None else ():
            if getattr(node, key) not in (None, {}) and not (key == "motion" and has_a_state(node)):
                remedy = f"only at the root, {plate.roots[0]}" if plate.roots else "only at the root"
                remedy += ", or with fuse: latent" if key == "motion" else ""
                yield plate.message(name, f"key {key!r} below the root", remedy, key=(key,), on_key=True)


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
