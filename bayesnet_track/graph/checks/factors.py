"""Checks of factors: expressions of the words and names that there are at their node."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from pydantic import ValidationError

from bayesnet_track.graph.checked import Factor
from bayesnet_track.graph.checks.cues import plugin_parameters
from bayesnet_track.graph.checks.joins import GraphCheck
from bayesnet_track.graph.checks.plates import Check, Plate
from bayesnet_track.graph.expressions.parse import parse
from bayesnet_track.graph.expressions.terms import Call, ExpressionError, names_in, walk
from bayesnet_track.graph.expressions.vocabulary import FRAME_NAMES, MASK, PARENT, STATE_NAMES, WORDS
from bayesnet_track.graph.spec import FactorNode, GraphSpec, InferenceNode
from bayesnet_track.graph.text.messages import GraphMessage, Positions, nearest
from bayesnet_track.graphs import graph_folder
from bayesnet_track.observation.image_size import PictureError
from bayesnet_track.observation.masks import Mask, read_mask
from bayesnet_track.observation.protocols import BOX

FURTHER = {
    "constant_velocity": ("vx", "vy"),
    "damped_velocity": ("vx", "vy"),
    "constant_acceleration": ("vx", "vy", "ax", "ay"),
    "box_velocity": ("vx", "vy", "vw", "vh"),
}


def constants_have_their_own_names(spec: GraphSpec, at: Positions) -> Iterator[GraphMessage]:
    """No constant has the name of a function or of a field of the state."""
    for name in spec.constants:
        if name in WORDS:
            found = f"constant {name!r}, which is a word of expressions"
            yield at.message(("constants", name), found, "another name", on_key=True)


def factors_can_be_read(plate: Plate) -> Iterator[GraphMessage]:
    """Every factor is an expression of names that exist at its node."""
    for name, node in plate.factors.items():
        try:
            parse(node.expression, names_at(plate, str(node.parent)), mask=node.mask is not None)
        except ExpressionError as error:
            message = plate.message(name, error.found, error.allowed, key=("factor",))
            yield plate.at.inside(_explain_name(message, error.word, error.near), error.at)


def masks_can_be_read(plate: Plate) -> Iterator[GraphMessage]:
    """The image of a factor is there, can be read, and is asked."""
    for name, node in plate.factors.items():
        if node.mask is None:
            continue
        wrong = plate.masks.get(node.mask)
        if isinstance(wrong, str):
            found, _, allowed = wrong.partition("; allowed: ")
            allowed = allowed or "an image file of the frames' size, its path from where the graph file is"
            yield plate.message(name, found, allowed, key=("mask",))
        elif not _asks_its_mask(node.expression):
            found, allowed = "a mask that the factor does not ask", "mask(x, y) in the factor, or no factor"
            yield plate.message(name, found, allowed, key=("mask",), on_key=True)


def _asks_its_mask(text: str) -> bool:
    try:
        return any(isinstance(one, Call) and one.function == MASK for one in walk(parse(text, mask=True)))
    except ExpressionError:
        return True  # said where expressions are checked


def masks_of(spec: GraphSpec, folder: Path, given: Mapping[str, Mask] | None = None) -> dict[str, Mask | str]:
    """Path as written -> the mask, or what is wrong with it; of `given` as it is given there.

    Others are looked for in `folder`, then among the installed graphs.
    """
    found: dict[str, Mask | str] = {}
    for target in spec.targets.values():
        for node in target.nodes.values():
            name = node.mask if isinstance(node, FactorNode) else None
            if name is None or name in found:
                continue
            found[name] = given[name] if given is not None and name in given else _read(name, folder)
    return found


def _read(name: str, folder: Path) -> Mask | str:
    here = folder / name
    installed = Path(graph_folder()) / name
    try:
        return read_mask(here if here.exists() or not installed.is_file() else installed)
    except (PictureError, ValueError) as error:
        return f"mask {str(error)[:300]}"


def names_at(plate: Plate, node: str) -> tuple[str, ...]:
    """The names of an expression about the state of an inference node.

    A latent node has a box of its own, beside that of its parent where each of its hypotheses has one. A grid
    takes evidence once for all velocities at a place, so it knows no velocity.
    """
    latent = latent_above(plate, node)
    if latent is not None:
        fuse, belief = plate.inference[latent].fuse, plate.inference[latent].belief
        assert fuse is not None and fuse.latent is not None
        draws = belief is None or belief.particles is not None or latent == plate.roots[0]
        has_parent = draws and fuse.latent.draw != "kernel"
        own = (*BOX, *(f"{PARENT}{field}" for field in BOX if has_parent))
    else:
        own = (*BOX, *_further(plate.inference[plate.roots[0]]))
    return (*own, *FRAME_NAMES, *plate.constants)


def agents_find_what_they_read(plate: Plate) -> Iterator[GraphMessage]:
    """The state has the fields that agents ask for, as `against: velocity` asks for `vx`, `vy`."""
    for name, node in plate.agents.items():
        declaration = plate.cues.get(node.agent.cue)
        if declaration is None or declaration.reads is None:
            continue
        try:
            wanted = declaration.reads(plugin_parameters(node.agent, declaration.parameters))
        except ValidationError:
            continue  # said where parameters are checked
        state = names_at(plate, str(node.parent))
        missing = [field for field in wanted if field not in state]
        if missing:
            found = f"{node.agent.cue} reads {', '.join(missing)}, which the state of this node does not have"
            allowed = "a motion with a velocity, at no latent node and on no grid"
            yield plate.message(name, found, allowed, key=("agent", node.agent.cue))


def latent_above(plate: Plate, node: str | None) -> str | None:
    """The nearest latent node at or above `node`, whose hypotheses are seen there; None for the root's."""
    while node is not None:
        fuse = plate.inference[node].fuse
        if fuse is not None and fuse.latent is not None:
            return node
        node = plate.inference[node].parent
    return None


def read_factors(plate: Plate) -> dict[str, Factor]:
    """The factors of a plate that passed the checks."""
    found = {}
    for name, node in plate.factors.items():
        term = parse(node.expression, mask=True)
        used = {one: plate.constants[one] for one in names_in(term) if one in plate.constants}
        mask = plate.masks.get(node.mask or "")
        found[name] = Factor(str(node.parent), term, used, mask if isinstance(mask, Mask) else None)
    return found


def _further(root: InferenceNode) -> tuple[str, ...]:
    if root.motion is None or (root.belief is not None and root.belief.grid is not None):
        return ()
    if root.motion.expressions is not None:
        return tuple(root.motion.expressions.fields)
    angle = ("angle",) if root.motion.settings.sd_angle_deg > 0 else ()
    return (*FURTHER.get(root.motion.kind, ()), *angle)


def _explain_name(message: GraphMessage, word: str, near: tuple[str, ...]) -> GraphMessage:
    if word.startswith(PARENT):
        where = "known only at a latent node that draws one state for each hypothesis"
        return replace(message, found=f"name {word!r}, {where}")
    if word in STATE_NAMES:
        return replace(message, found=f"name {word!r}, which the state of this node does not have")
    return replace(message, nearest=nearest(word, near)) if word else message


FACTOR_CHECKS: tuple[Check, ...] = (factors_can_be_read, masks_can_be_read, agents_find_what_they_read)
CONSTANT_CHECKS: tuple[GraphCheck, ...] = (constants_have_their_own_names,)
