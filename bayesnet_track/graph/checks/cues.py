"""Checks of the cues of agents and verifiers: installed, and with parameters that they take."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from bayesnet_track.graph.checks.plates import Check, Plate
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


def declares(plate: Plate, node: AgentNode, what: Callable[[CueDeclaration, NoParameters], bool]) -> bool:
    """Whether an agent's cue is such a one; what is wrong with its parameters is said elsewhere."""
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
