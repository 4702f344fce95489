"""The JSON Schema (draft-07) of graph files, made from the specification and the installed cues.

Editors complete and check graph files with it. What only the checks know (parents, cycles, thresholds) is not
in it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel, ValidationError

from bayesnet_track.graph.settings.base import Choice, Model
from bayesnet_track.graph.settings.lifecycle import DetectorChoice
from bayesnet_track.graph.spec import AgentChoice, GraphSpec
from bayesnet_track.observation.cue import CueDeclaration, installed_cues
from bayesnet_track.observation.detector import DetectorDeclaration, detectors_of_graphs
from bayesnet_track.observation.plugins import allowed

Schema = dict[str, Any]

DRAFT = "http://json-schema.org/draft-07/schema#"
_REFERENCE = "#/definitions/{model}"


def graph_schema(cues: Mapping[str, CueDeclaration] | None = None) -> Schema:
    """The schema of a graph file; `cues` are the built-in and the allowed ones unless given."""
    cues = installed_cues(allowed()) if cues is None else cues
    raw = GraphSpec.model_json_schema(ref_template=_REFERENCE)
    definitions: Schema = {name: _draft7(part) for name, part in raw.pop("$defs").items()}
    models = {model.__name__: model for model in _models(Model)}
    for name in definitions:
        if issubclass(models[name], Choice):
            definitions[name] = _choice(definitions[name], models[name])
    definitions[AgentChoice.__name__] = _plugin("cue", "The cue of an agent", cues, definitions)
    definitions[DetectorChoice.__name__] = _plugin(
        "detector", "What finds targets", detectors_of_graphs(allowed()), definitions
    )
    top = {"$schema": DRAFT, "title": "A graph of bayesnet_track", **_draft7(raw)}
    return {**top, "definitions": dict(sorted(definitions.items()))}


def _models(base: type[Model]) -> Iterator[type[Model]]:
    for model in base.__subclasses__():
        yield model
        yield from _models(model)


def _choice(schema: Schema, model: type[Model]) -> Schema:
    """Exactly one key, or the bare word of a choice whose settings may be left out."""
    words = [word for word in model.model_fields if _accepts(model, word)]
    one = {**schema, "minProperties": 1, "maxProperties": 1}
    description = one.pop("description", "")
    either = [{"enum": words}, one] if words else [one]
    return {"description": description, "anyOf": either}


def _plugin(
    kind: str,
    what: str,
    known: Mapping[str, CueDeclaration] | Mapping[str, DetectorDeclaration],
    definitions: Schema,
) -> Schema:
    """One plug-in of those installed, with its own parameters; defines each one's parameters."""
    words, keys = [], {}
    for name, plugin in known.items():
        own_name = f"{kind}_{name}"
        parameters = plugin.parameters.model_json_schema(ref_template=f"#/definitions/{own_name}_{{model}}")
        for inner, part in parameters.pop("$defs", {}).items():
            definitions[f"{own_name}_{inner}"] = _draft7(part, keep_null=True)
        own = _draft7(parameters, keep_null=True)
        definitions[own_name] = {**own, "description": plugin.summary}
        keys[name] = {"$ref": f"#/definitions/{own_name}"}
        if _accepts(plugin.parameters, {}):
            words.append(name)
    described = [{"const": word, "description": known[word].summary} for word in words]
    one = {"type": "object", "properties": keys, "additionalProperties": False}
    one |= {"minProperties": 1, "maxProperties": 1}
    description = f"{what}: its name, or its name with parameters."
    return {"description": description, "anyOf": [*described, one]}


def _accepts(model: type[BaseModel], value: Any) -> bool:
    try:
        model.model_validate(value)
    except ValidationError:
        return False
    return True


def _draft7(schema: Any, keep_null: bool = False) -> Any:
    """A part of pydantic's schema without what draft-07 lacks, without titles, and without null."""
    if isinstance(schema, list):
        return [_draft7(part, keep_null) for part in schema]
    if not isinstance(schema, dict):
        return schema
    part = {key: value for key, value in schema.items() if key not in ("title", "discriminator")}
    if "default" in part and not keep_null:
        part["default"] = _plain_default(part["default"])
        if part["default"] is None:
            del part["default"]
    for names in ("properties", "patternProperties"):
        if names in part:
            part[names] = {name: _draft7(inner, keep_null) for name, inner in part[names].items()}
    for key in ("items", "additionalProperties", "anyOf", "oneOf", "allOf"):
        if key in part:
            part[key] = _draft7(part[key], keep_null)
    if "prefixItems" in part:
        part["items"] = _draft7(part.pop("prefixItems"), keep_null)
        part["additionalItems"] = False
    if "patternProperties" in part:
        part["additionalProperties"] = False
    if "oneOf" in part:
        part["anyOf"] = part.pop("oneOf")
    if "anyOf" in part and not keep_null:
        part = _without_null(part)
    if "$ref" in part and len(part) > 1:
        part = {"allOf": [{"$ref": part.pop("$ref")}], **part}
    return part


def _plain_default(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain_default(inside) for key, inside in value.items() if inside is not None}
    return value


def _without_null(part: Schema) -> Schema:
    branches = [branch for branch in part["anyOf"] if branch != {"type": "null"}]
    rest = {key: value for key, value in part.items() if key != "anyOf"}
    return {**branches[0], **rest} if len(branches) == 1 else {**rest, "anyOf": branches}
