"""Checks of factors: expressions of the words and names that there are at their node."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from pydantic import ValidationError

from bayesnet_track.graph.checked import Factor
from bayesnet_track.graph.checks.cues import plugin_parameters
from bayesnet_track.graph.checks.joins import GraphCheck
from bayesnet_track.graph.checks.plates import Check, Plate
from bayesnet_track.graph.expressions.parse import parse
from bayesnet_track.graph.expressions.terms import ExpressionError, names_in
from bayesnet_track.graph.expressions.vocabulary import FRAME_NAMES, PARENT, STATE_NAMES, WORDS
from bayesnet_track.graph.spec import GraphSpec, InferenceNode
from bayesnet_track.graph.text.messages import GraphMessage, Positions, nearest

BOX = ("x", "y", "w", "h")
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
            parse(node.factor, names_at(plate, str(node.parent)))
        except ExpressionError as error:
            message = plate.message(name, error.found, error.allowed, key=("factor",))
            yield plate.at.inside(_explain_name(message, error.word, error.near), error.at)


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
        has_parent = draws and fuse.latent.draw == "one"
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
        term = parse(node.factor)
        used = {one: plate.constants[one] for one in names_in(term) if one in plate.constants}
        found[name] = Factor(str(node.parent), term, used)
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


FACTOR_CHECKS: tuple[Check, ...] = (factors_can_be_read, agents_find_what_they_read)
CONSTANT_CHECKS: tuple[GraphCheck, ...] = (constants_have_their_own_names,)
