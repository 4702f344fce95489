"""How the state of a latent node is held, where its graph does not say: by the best exact form that fits."""

from __future__ import annotations

from collections.abc import Container, Iterator
from typing import Literal

from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.graph.checks.latent import beyond_position
from bayesnet_track.graph.expressions.terms import names_in
from bayesnet_track.graph.expressions.vocabulary import PARENT
from bayesnet_track.graph.settings.motion import Noise
from bayesnet_track.graph.settings.nodes import Given

Form = Literal["one", "kernel", "gaussian", "grid"]


def form_of(target: CheckedTarget, node: str, measuring: Container[str]) -> Form:
    """How a latent node's own state is held; `measuring` are the agents that say where the target is.

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
    """Whether a factor weighs pairs of a draw and its parent, which only draws that go together have."""
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
    """Whether an inference node has a state of its own beside the root's."""
    fuse = target.inference(node).fuse
    return fuse is not None and fuse.latent is not None


def _is_linear(given: Given) -> bool:
    """Whether the state is the parent's box times a matrix, with Gaussian noise in px."""
    sized = [part for part in beyond_position(given) if not part.startswith("sd_px")]
    return not given.written and given.heavy_tail is None and not sized


def _is_measured(target: CheckedTarget, node: str, measuring: Container[str]) -> bool:
    """Whether all that is said of a node's state are linear measurements."""
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


def _fits_cells(target: CheckedTarget, node: str, given: Given) -> bool:
    """Whether a grid over x and y, with one noise for all cells, holds all that is uncertain."""
    spreads = given.sd_px.x > 0 and given.sd_px.y > 0 and not beyond_position(given)
    return spreads and all(_keeps_size(target, above) for above in _nodes_above(target, node))


def _nodes_above(target: CheckedTarget, node: str) -> Iterator[str]:
    above: str | None = node
    while above is not None:
        yield above
        above = target.parent[above]


def _keeps_size(target: CheckedTarget, node: str) -> bool:
    """Whether all boxes of a state have one size, if those above it have."""
    one = target.inference(node)
    noises: list[object] = []
    if one.fuse is not None and one.fuse.latent is not None:
        noises.append(None if one.fuse.latent.given.written else one.fuse.latent.given)
    if node == target.root and one.motion is not None:
        noises.append(None if one.motion.box_velocity is not None else one.motion.settings)
    return all(
        isinstance(noise, Noise) and all(part.startswith("sd_box") for part in beyond_position(noise))
        for noise in noises
    )
