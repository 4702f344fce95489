"""The checks of latent nodes: beliefs below the root, where they can be held, and parts of a target."""

from __future__ import annotations

from collections.abc import Iterator

from bayesnet_track.graph.checks.plates import Plate
from bayesnet_track.graph.settings.motion import Moving
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
        where = f"at the root, {plate.roots[0]}" if plate.roots else "at the root"
        found = "key 'belief' at a node without a state of its own"
        yield plate.message(name, found, f"{where}, or with fuse: latent", key=("belief",), on_key=True)


def _without_settings(plate: Plate, name: str, node: InferenceNode) -> Iterator[GraphMessage]:
    assert node.belief is not None and node.fuse is not None and node.fuse.latent is not None
    kind = node.belief.kind
    for setting in sorted(node.belief.settings.model_fields_set):
        found = f"{setting} has no effect below the root: a latent node has its parent's hypotheses"
        yield plate.message(name, found, f"belief: {kind}", key=("belief", kind, setting), on_key=True)
    if kind != "particles" and "draw" in node.fuse.latent.model_fields_set:
        found = f"draw says how particles are joined, and the belief here is {kind}"
        key = ("fuse", "latent", "draw")
        yield plate.message(name, found, "belief: particles, or no draw", key=key, on_key=True)


def parts_have_a_whole(plate: Plate) -> Iterator[GraphMessage]:
    """A part lies in the box of a node above: the root is no part."""
    for name, node in plate.inference.items():
        if node.parent is not None or node.fuse is None or node.fuse.latent is None:
            continue
        given = node.fuse.latent.given
        for key in sorted({"offset_box", "size_box", *given.written} & given.model_fields_set):
            found = f"{key} at the root, which is no part of anything"
            where = ("fuse", "latent", "given", key)
            yield plate.message(name, found, "a node below the root", key=where, on_key=True)


def latent_nodes_move(plate: Plate) -> Iterator[GraphMessage]:
    """A latent node's motion is a random walk in px, by at most the noise of `given`.

    Its deviations are fields of the root's states: these are particles drawn from the motion, without modes.
    """
    moving = [name for name, node in plate.inference.items() if node.parent is not None and node.motion]
    for name in moving:
        node = plate.inference[name]
        if node.motion is None or node.fuse is None or node.fuse.latent is None:
            continue
        if node.motion.random_walk is None:
            found = f"{node.motion.kind} at a latent node, whose motion is that of a deviation"
            yield plate.message(name, found, ["random_walk"], key=("motion", node.motion.kind), on_key=True)
            continue
        yield from _walk_in_px(plate, name, node.motion.random_walk, node.fuse.latent)
        if node.belief is not None and node.belief.particles is None:
            found = f"motion beside belief: {node.belief.kind}, which is made anew in each frame"
            yield plate.message(name, found, "belief: particles, or none", key=("motion",), on_key=True)
    for root in plate.roots[:1] if moving else ():
        yield from _states_hold_deviations(plate, root, moving[0])


def _walk_in_px(plate: Plate, name: str, walk: Moving, latent: Latent) -> Iterator[GraphMessage]:
    here = ("motion", "random_walk")
    usual = type(walk)()
    for setting in sorted(walk.model_fields_set - {"sd_px"}):
        if getattr(walk, setting) == getattr(usual, setting):
            continue
        found = f"{setting} in the motion of a latent node"
        yield plate.message(name, found, ["sd_px"], key=(*here, setting), on_key=True)
    given = latent.given
    if given.written:
        found = "given by expressions, and a deviation that moves is Gaussian in px"
        yield plate.message(name, found, "sd_px, or no motion", key=("fuse", "latent", "given"))
        return
    further = [*beyond_position(Noise(sd_box=given.sd_box, sd_log=given.sd_log))]
    further += ["heavy_tail"] if given.heavy_tail is not None else []
    if further:
        found = f"given has {', '.join(further)}, and a deviation that moves is Gaussian in px"
        yield plate.message(name, found, "sd_px alone, or no motion", key=("fuse", "latent", "given"))
    if latent.draw == "kernel":
        key = ("fuse", "latent", "draw")
        found = "draw beside motion: what moves is not drawn anew"
        yield plate.message(name, found, "no draw, or no motion", key=key, on_key=True)
    for axis in PixelSd.model_fields:
        own, limit = getattr(walk.sd_px, axis), getattr(given.sd_px, axis)
        if (own > 0) != (limit > 0) or own > limit:
            found = f"sd_px.{axis} is {own:g} a frame, and given's is {limit:g} in the long run"
            allowed = f"above 0 and at most {limit:g}" if limit > 0 else f"no {axis}, or noise of it in given"
            key = (*here, "sd_px", *((axis,) if axis in walk.sd_px.model_fields_set else ()))
            yield plate.message(name, found, allowed, key=key)


def _states_hold_deviations(plate: Plate, root: str, first: str) -> Iterator[GraphMessage]:
    node, moves = plate.inference[root], f"{first!r} has a motion"
    if node.modes is not None:
        yield plate.message(
            root, f"modes, and {moves} of its own", "one of them", key=("modes",), on_key=True
        )
    if node.belief is not None and node.belief.particles is None:
        found = f"belief: {node.belief.kind}, and {moves} of its own"
        yield plate.message(root, found, "belief: particles", key=("belief", node.belief.kind), on_key=True)
    elif node.belief is not None and node.belief.settings.proposal.kind != "bootstrap":
        kind = node.belief.settings.proposal.kind
        found = f"proposal: {kind}, and {moves} of its own"
        key = ("belief", "particles", "proposal")
        yield plate.message(root, found, "proposal: bootstrap", key=key, on_key=True)


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
            found = f"given has no noise in {' and '.join(still)}, and the grid has cells for both x and y"
            allowed = "sd_px with x and y, or belief: gaussian or particles"
            yield plate.message(name, found, allowed, key=("fuse", "latent", "given"))
        further = beyond_position(latent.given)
        if further:
            found = f"a latent node's grid has no cells for {', '.join(further)}"
            allowed = "sd_px of x and y alone, or belief: gaussian or particles"
            yield plate.message(name, found, allowed, key=("fuse", "latent", "given"))
        for above, noise in _noises_above(plate, name):
            sized = [part for part in beyond_position(noise) if not part.startswith("sd_box")]
            if sized:
                found = (
                    f"the size changes by {', '.join(sized)} of {above!r}, and the grid has no cells for it"
                )
                allowed = "a size that rests, or belief: gaussian or particles"
                yield plate.message(name, found, allowed, key=("belief",))


def has_a_state(node: InferenceNode) -> bool:
    """Whether it has a state of its own."""
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
    above = plate.inference[name].parent
    seen: set[str] = set()
    while above is not None and above in plate.inference and above not in seen:
        seen.add(above)
        node = plate.inference[above]
        if node.parent is None and node.motion is not None:
            yield above, node.motion.settings
        elif node.fuse is not None and node.fuse.latent is not None:
            yield above, node.fuse.latent.given
        above = node.parent
