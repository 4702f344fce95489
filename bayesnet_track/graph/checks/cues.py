"""Checks of the cues of agents and verifiers, and that evidence reaches a node by one path only."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from bayesnet_track.graph.checks.plates import Check, Plate, camera_above
from bayesnet_track.graph.settings.base import PluginChoice
from bayesnet_track.graph.spec import AgentChoice, AgentNode
from bayesnet_track.graph.text.explain import explain
from bayesnet_track.graph.text.messages import GraphMessage
from bayesnet_track.observation.cue import ENTRY_POINT_GROUP, CueDeclaration, NoParameters
from bayesnet_track.observation.plugins import why_absent

Parameters = TypeVar("Parameters", bound=BaseModel)


def cues_are_installed(plate: Plate) -> Iterator[GraphMessage]:
    """Every agent and verifier names an installed cue; one of another package must be allowed."""
    for name, where, chosen in plate.spec.cue_choices():
        cue = chosen.cue
        if cue not in plate.cues:
            key, absent = (*where, cue), why_absent(ENTRY_POINT_GROUP, cue)
            if absent is not None:
                yield plate.message(name, f"cue {absent[0]}", absent[1], key=key, on_key=True)
                continue
            allowed = list(plate.cues) or "no cue is installed"
            yield plate.message(name, f"unknown cue {cue!r}", allowed, key=key, word=cue, on_key=True)


def parameters_fit_the_cue(plate: Plate) -> Iterator[GraphMessage]:
    """Every parameter is one that the cue declares, of its type and within its range."""
    for name, where, chosen in plate.spec.cue_choices():
        declaration = plate.cues.get(chosen.cue)
        if declaration is None:
            continue
        try:
            cue_parameters(chosen, declaration)
        except ValidationError as error:
            path = ("targets", plate.name, "nodes", name, *where, chosen.cue)
            model = declaration.parameters
            for message in explain(error, model, chosen.parameters, plate.at, path):
                field = model.model_fields.get(str(message.path[-1]))
                meaning = field.description if field is not None else None
                yield (
                    replace(message, allowed=f"{message.allowed} ({meaning.rstrip('.')})")
                    if meaning
                    else message
                )


def cues_have_what_they_need(plate: Plate) -> Iterator[GraphMessage]:
    """Files and parts of other libraries that a cue's parameters need are there."""
    for name, where, chosen in plate.spec.cue_choices():
        declaration = plate.cues.get(chosen.cue)
        if declaration is None or declaration.missing is None:
            continue
        try:
            parameters = cue_parameters(chosen, declaration)
        except ValidationError:
            continue
        absent = declaration.missing(parameters)
        if absent is not None:
            yield plate.message(name, absent, key=(*where, chosen.cue))


def cue_parameters(agent: AgentChoice, declaration: CueDeclaration) -> NoParameters:
    """The agent's parameters as the cue's own type; raises as `plugin_parameters`."""
    return plugin_parameters(agent, declaration.parameters)


def noises_of(plate: Plate, node: AgentNode) -> Mapping[str, str]:
    """Quantity -> the distribution of its error as text, of an agent whose errors are written so."""
    declaration = plate.cues.get(node.agent.cue)
    if declaration is None or declaration.noises is None:
        return {}
    try:
        return declaration.noises(cue_parameters(node.agent, declaration))
    except ValidationError:
        return {}  # said where parameters are checked


def declares(plate: Plate, node: AgentNode, what: Callable[[CueDeclaration, NoParameters], bool]) -> bool:
    """True if an agent's cue is such a one; what is wrong with its parameters is said elsewhere."""
    declaration = plate.cues.get(node.agent.cue)
    if declaration is None:
        return False
    try:
        return what(declaration, cue_parameters(node.agent, declaration))
    except ValidationError:
        return True


def plugin_parameters(chosen: PluginChoice, model: type[Parameters]) -> Parameters:
    """The parameters of a plug-in as its own type.

    Numbers must be numbers, as everywhere in the language; a list stands for a tuple.

    Raises:
        pydantic.ValidationError: some parameter does not fit.
    """
    return model.model_validate_json(json.dumps(dict(chosen.parameters)), strict=True)


CUE_CHECKS: tuple[Check, ...] = (cues_are_installed, parameters_fit_the_cue, cues_have_what_they_need)


Evidence = tuple[str, str, str | None]
"""A cue and its parameters: what an agent reads of the pixels; and of which camera these are."""

Box = tuple[float, float, float, float]
ELSEWHERE = 1e6
WHOLE: Box = (0.0, 0.0, 1.0, 1.0)
"""The target's own box: centre, width and height in its own."""

SHARED = 0.5
"""Share of the smaller of two boxes from which on they hold the same pixels."""


def evidence_counts_once(plate: Plate) -> Iterator[GraphMessage]:
    """Two agents that compute the same are not multiplied, which would count it twice; a pool may hold them.

    For a sound tree. Thesis 2.6: colour is counted once by a node of its own. Agents that look at parts of
    the target compute the same where half of one part lies in the other.
    """
    boxes = _boxes(plate)
    reached: dict[str, dict[Evidence, list[str]]] = {name: {} for name in plate.order}
    for name in reversed(plate.order):
        if name in plate.agents:
            evidence = _evidence(plate, name)
            if evidence is not None:
                reached[name] = {evidence: [name]}
            continue
        fuse = plate.inference[name].fuse
        here = reached[name]
        for child in plate.children[name]:
            pairs = [(evidence, agent) for evidence, below in reached.pop(child).items() for agent in below]
            for evidence, agent in pairs:
                others = here.setdefault(evidence, [])
                first = next((one for one in others if _share_pixels(boxes[one], boxes[agent])), None)
                if first is None:
                    others.append(agent)
                elif fuse is None or fuse.pool is None:
                    found = f"the same evidence as {first!r}: {evidence[0]} counts twice in {name!r}"
                    advice = "both under one node with fuse: pool, or different parameters"
                    yield plate.message(agent, found, advice, key=("agent",))


def _boxes(plate: Plate) -> dict[str | None, Box]:
    """Node -> the box that it is about, in the target's own."""
    boxes: dict[str | None, Box] = {None: WHOLE}
    for name in plate.order:
        x, y, w, h = boxes[plate.spec.nodes[name].parent]
        fuse = plate.inference[name].fuse if name in plate.inference else None
        if fuse is not None and fuse.latent is not None:
            at, size = fuse.latent.given.offset_box, fuse.latent.given.size_box
            if fuse.latent.given.written:  # where it is, is not known here: it shares no pixels with another
                x += ELSEWHERE * len(boxes)
            x, y = (x, y) if at is None else (x + at.x * w, y + at.y * h)
            w, h = (w, h) if size is None else (w * size.w, h * size.h)
        boxes[name] = (x, y, w, h)
    return boxes


def _share_pixels(one: Box, other: Box) -> bool:
    """At least the share `SHARED` of the smaller box lies in the other."""
    sides = [
        min(one[k] + one[k + 2] / 2, other[k] + other[k + 2] / 2)
        - max(one[k] - one[k + 2] / 2, other[k] - other[k + 2] / 2)
        for k in (0, 1)
    ]
    common = max(sides[0], 0.0) * max(sides[1], 0.0)
    return common >= SHARED * min(one[2] * one[3], other[2] * other[3])


def _evidence(plate: Plate, agent: str) -> Evidence | None:
    choice = plate.agents[agent].agent
    if choice.cue not in plate.cues:
        return None
    try:
        parameters = cue_parameters(choice, plate.cues[choice.cue]).model_dump_json()
        return choice.cue, parameters, camera_above(plate.spec, agent)
    except ValidationError:
        return None
