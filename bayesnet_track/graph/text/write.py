"""Canonical YAML of a specification, the values in which two graphs differ, and the JSON Schema.

Editors complete and check graph files with it. What only the checks know (parents, cycles, thresholds) is not
in it.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import yaml
from pydantic import BaseModel, ValidationError

from bayesnet_track.graph.settings.base import Choice, Model, PluginChoice
from bayesnet_track.graph.settings.lifecycle import DetectorChoice
from bayesnet_track.graph.spec import AgentChoice, GraphSpec
from bayesnet_track.graph.text.document import plain_scalar
from bayesnet_track.observation.cue import CueDeclaration, installed_cues
from bayesnet_track.observation.detector import DetectorDeclaration, detectors_of_graphs
from bayesnet_track.observation.plugins import allowed

_PLAIN_WORD = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_NODE_DEPTH = 4


def write_graph(spec: GraphSpec) -> str:
    """The YAML text of a specification; reading it gives an equal one.

    >>> print(write_graph(GraphSpec.model_validate(
    ...     {"name": "g", "targets": {"t": {"nodes": {"t": {"fuse": {"pool": "equal"}}}}}})), end="")
    bayesnet: 1
    name: g
    targets:
      t:
        nodes:
          t:
            fuse: pool
    """
    return plain_text({"bayesnet": spec.bayesnet, **as_plain(spec)})


def plain_text(data: Mapping[str, Any]) -> str:
    """A graph that is plain data as YAML, each value as it is."""
    return "\n".join(_block(data, "", depth=0)) + "\n"


def graph_sha256(text: str) -> str:
    """The SHA-256 of a graph's canonical text, in hexadecimal."""
    return hashlib.sha256(text.encode()).hexdigest()


def as_plain(value: Any) -> Any:
    """A part of the specification as mappings, lists and scalars, as short as it can be written."""
    if isinstance(value, PluginChoice):
        return {value.plugin: dict(value.parameters)} if value.parameters else value.plugin
    if isinstance(value, Choice):
        settings = as_plain(value.settings)
        return value.kind if settings == value.bare(value.kind) else {value.kind: settings}
    if isinstance(value, BaseModel):
        fields = type(value).model_fields
        names = (name for name in fields if fields[name].is_required() or not _is_default(value, name))
        return {name: as_plain(getattr(value, name)) for name in names}
    if isinstance(value, Mapping):
        return {key: as_plain(element) for key, element in value.items()}
    if isinstance(value, (list, tuple)):
        return [as_plain(element) for element in value]
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e15:
        return int(value)
    return value


def _is_default(model: BaseModel, name: str) -> bool:
    return bool(
        getattr(model, name) == type(model).model_fields[name].get_default(call_default_factory=False)
    )


def _block(mapping: Mapping[str, Any], indent: str, depth: int) -> Iterator[str]:
    """Lines of a mapping; the levels down to each node's keys stand in block form, the rest in one line."""
    for key, value in mapping.items():
        if isinstance(value, dict) and value and depth < _NODE_DEPTH:
            yield f"{indent}{_scalar(key)}:"
            yield from _block(value, indent + "  ", depth + 1)
        else:
            yield f"{indent}{_scalar(key)}: {flow_text(value)}"


def flow_text(value: Any) -> str:
    """Plain data in one line of YAML."""
    if isinstance(value, dict):
        return (
            "{" + ", ".join(f"{_scalar(key)}: {flow_text(element)}" for key, element in value.items()) + "}"
        )
    if isinstance(value, list):
        return "[" + ", ".join(flow_text(element) for element in value) + "]"
    return _scalar(value)


def _scalar(value: Any) -> str:
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value)
    if _PLAIN_WORD.fullmatch(value) and isinstance(plain_scalar(value), str):
        return str(value)
    return '"' + "".join(map(_escape, value)) + '"'


def _escape(character: str) -> str:
    code = ord(character)
    if character in '"\\':
        return "\\" + character
    if character == "\n":
        return "\\n"
    if character.isprintable() and code != 0xFEFF:
        return character
    return f"\\x{code:02x}" if code < 256 else f"\\u{code:04x}" if code < 65536 else f"\\U{code:08x}"


@dataclass(frozen=True)
class Difference:
    """One value that two graphs do not share.

    Attributes:
        path: keys from the top to the value, joined by dots.
        first: its text in the first graph; empty when it is not written there.
        second: its text in the second graph.
    """

    path: str
    first: str
    second: str

    def __str__(self) -> str:
        """``path: first → second``."""
        return f"{self.path}: {self.first or 'not written'} → {self.second or 'not written'}"


def differences(first: str, second: str) -> tuple[Difference, ...]:
    """The values that two canonical graph texts do not share, in the order of the first.

    >>> for one in differences("a: {b: 1, c: x}\\n", "a: {b: 2, d: {e: 3}}\\n"):
    ...     print(one)
    a.b: 1 → 2
    a.c: x → not written
    a.d: not written → {e: 3}
    >>> print(*differences("a: {b: 1}\\n", "a: {b: 1, c: {}}\\n"))
    a.c: not written → {}, all at their defaults
    """
    return tuple(_between(yaml.safe_load(first), yaml.safe_load(second), ""))


def _between(first: Any, second: Any, path: str) -> Iterator[Difference]:
    if isinstance(first, Mapping) and isinstance(second, Mapping):
        for key in dict.fromkeys([*first, *second]):
            key_path = f"{path}.{key}" if path else str(key)
            if key in first and key in second:
                yield from _between(first[key], second[key], key_path)
            else:
                yield Difference(key_path, _text(first, key), _text(second, key))
    elif first != second:
        yield Difference(path, flow_text(first), flow_text(second))


def _text(mapping: Mapping[Any, Any], key: Any) -> str:
    if key not in mapping:
        return ""
    # Canonical text leaves out what has its default value: of {share: 0.1} nothing may remain.
    return flow_text(mapping[key]) if mapping[key] != {} else "{}, all at their defaults"


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
    single = {**schema, "minProperties": 1, "maxProperties": 1}
    description = single.pop("description", "")
    either = [{"enum": words}, single] if words else [single]
    return {"description": description, "anyOf": either}


def _plugin(
    kind: str,
    title: str,
    plugins: Mapping[str, CueDeclaration] | Mapping[str, DetectorDeclaration],
    definitions: Schema,
) -> Schema:
    """One plug-in of those installed, with its own parameters; defines each one's parameters."""
    words, keys = [], {}
    for name, plugin in plugins.items():
        own_name = f"{kind}_{name}"
        parameters = plugin.parameters.model_json_schema(ref_template=f"#/definitions/{own_name}_{{model}}")
        for inner, part in parameters.pop("$defs", {}).items():
            definitions[f"{own_name}_{inner}"] = _draft7(part, keep_null=True)
        definition = _draft7(parameters, keep_null=True)
        definitions[own_name] = {**definition, "description": plugin.summary}
        keys[name] = {"$ref": f"#/definitions/{own_name}"}
        if _accepts(plugin.parameters, {}):
            words.append(name)
    described = [{"const": word, "description": plugins[word].summary} for word in words]
    single = {"type": "object", "properties": keys, "additionalProperties": False}
    single |= {"minProperties": 1, "maxProperties": 1}
    description = f"{title}: its name, or its name with parameters."
    return {"description": description, "anyOf": [*described, single]}


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
        return {key: _plain_default(element) for key, element in value.items() if element is not None}
    return value


def _without_null(part: Schema) -> Schema:
    branches = [branch for branch in part["anyOf"] if branch != {"type": "null"}]
    annotations = {key: value for key, value in part.items() if key != "anyOf"}
    return {**branches[0], **annotations} if len(branches) == 1 else {**annotations, "anyOf": branches}
