"""Canonical YAML of a specification, and the values in which two graphs differ."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import yaml
from pydantic import BaseModel

from bayesnet_track.graph.settings.base import Choice, PluginChoice
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.document import plain_scalar

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
            below = f"{path}.{key}" if path else str(key)
            if key in first and key in second:
                yield from _between(first[key], second[key], below)
            else:
                yield Difference(below, _text(first, key), _text(second, key))
    elif first != second:
        yield Difference(path, flow_text(first), flow_text(second))


def _text(mapping: Mapping[Any, Any], key: Any) -> str:
    if key not in mapping:
        return ""
    # Canonical text leaves out what has its default value: of {share: 0.1} nothing may remain.
    return flow_text(mapping[key]) if mapping[key] != {} else "{}, all at their defaults"
