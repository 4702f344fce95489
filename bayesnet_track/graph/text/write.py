"""Write a specification as canonical YAML: choices in their short form, defaults left out, floats exact."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel

from bayesnet_track.graph.settings.base import Choice, PluginChoice
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.scalars import plain_scalar

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
        changed = (name for name in fields if fields[name].is_required() or not _is_default(value, name))
        return {name: as_plain(getattr(value, name)) for name in changed}
    if isinstance(value, Mapping):
        return {key: as_plain(inside) for key, inside in value.items()}
    if isinstance(value, (list, tuple)):
        return [as_plain(inside) for inside in value]
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
        return "{" + ", ".join(f"{_scalar(key)}: {flow_text(inside)}" for key, inside in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(flow_text(inside) for inside in value) + "]"
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
