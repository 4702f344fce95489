"""Messages of pydantic in words of the language, and the excerpt of the file that a terminal shows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from math import isfinite
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel, Tag, ValidationError

from bayesnet_track.graph.settings.base import Choice, Model, Name, PluginChoice
from bayesnet_track.graph.settings.net import node_kind
from bayesnet_track.graph.spec import AgentNode, FactorNode, GraphSpec, InferenceNode, Target
from bayesnet_track.graph.text.document import MAX_BYTES
from bayesnet_track.graph.text.hints import A_NODE, NODE_KEYS, Shape, expects, hint_of, shape_of
from bayesnet_track.graph.text.messages import (
    MAX_MESSAGES,
    GraphError,
    GraphMessage,
    KeyPath,
    Positions,
    listed,
    nearest,
    shown_name,
    shown_value,
)

NODES: Mapping[Any, str] = {InferenceNode: "an inference", AgentNode: "an agent", FactorNode: "a factor"}
MARKED: Mapping[str, type[Model]] = {"agent": AgentNode, "factor": FactorNode}
"""Key that makes a node something else than an inference node -> what it makes it."""
MAX_EXPLAINED = 4 * MAX_MESSAGES


def explain_errors(
    error: ValidationError, model: type[BaseModel], data: Any, positions: Positions, prefix: KeyPath = ()
) -> list[GraphMessage]:
    """The messages for what pydantic found wrong in `data`, a value of `model` at the path `prefix`."""
    messages: dict[tuple[KeyPath, str], GraphMessage] = {}
    for details in error.errors(include_url=False, include_context=False)[:MAX_EXPLAINED]:
        steps = _walk(details["loc"], model, data)
        if details["type"] == "extra_forbidden" and _follows(steps):
            continue
        message = _explain(details["type"], details["msg"], steps, positions, prefix)
        messages.setdefault((message.path, message.found), message)
    return list(messages.values())


def _follows(steps: list[_Step]) -> bool:
    """True if a key is unknown only because `nodes` is missing above it, or the key that makes an agent."""
    *_, enclosing, innermost = steps
    kind = enclosing.shape.only if enclosing.shape is not None else None
    if kind is InferenceNode:
        return innermost.key in _meant(enclosing.value).model_fields
    return (
        kind is Target
        and "nodes" not in enclosing.value
        and (is_like_node(enclosing.value) or is_like_node(innermost.value))
    )


def _meant(node: Mapping[str, Any]) -> type[Model]:
    """The kind of a node without `agent` and `factor`: by the one key that is no key of that kind."""
    for name, kind in MARKED.items():
        wrong = [key for key in node if key not in kind.model_fields]
        if len(wrong) == 1 and nearest(wrong[0], [*InferenceNode.model_fields, *MARKED]) == name:
            return kind
    return InferenceNode


@dataclass(frozen=True)
class _Step:
    """One step from the top of the data toward an error.

    Attributes:
        key: key or index, None at the top.
        shape: what is expected there; None when the key is unknown.
        value: what is there; None when nothing is.
        is_key: the error concerns the key itself.
    """

    key: str | int | None
    shape: Shape | None
    value: Any
    is_key: bool = False


def _walk(location: tuple[str | int, ...], model: type[BaseModel], data: Any) -> list[_Step]:
    """The steps along pydantic's location, without the labels of union members in it."""
    steps = [_Step(None, Shape((model,)), data)]
    for number, part in enumerate(location):
        shape = steps[-1].shape
        if part == "[key]":
            return [*steps, _Step(part, None, None, is_key=True)]
        if shape is None:
            return steps
        if shape.only is None:
            member = next((kind for kind in shape.kinds if _tag(kind) == part), None)
            is_last = number == len(location) - 1
            if member is None or (is_last and _is_other(steps[-1].value, shape_of(member).only)):
                return steps
            steps[-1] = replace(steps[-1], shape=shape_of(member))
            continue
        steps.append(_Step(part, _shape_inside(shape.only, part), _value_inside(steps[-1].value, part)))
    return steps


def _nested(key: str, value: Any, model: type[BaseModel]) -> str:
    """Hint for a value where a mapping is needed: its first key that takes such a value.

    >>> from bayesnet_track.graph.settings.beliefs import Particles
    >>> _nested("particles", 800, Particles), _nested("particles", True, Particles)
    ('write particles: {size: 800}', 'write particles: {}')
    """
    needed = [name for name, field in model.model_fields.items() if field.is_required()]
    if value is True or value is None:
        return "" if needed else f"write {key}: {{}}"
    plain = (str,) if isinstance(value, str) else (int, float) if isinstance(value, int | float) else ()
    shapes = {n: map(shape_of, shape_of(field.annotation).kinds) for n, field in model.model_fields.items()}
    fitting = [n for n in shapes if any(kind.only in plain and kind.takes(value) for kind in shapes[n])]
    names = [name for name in ("x", "y") if name in fitting] or fitting[:1]
    written = shown_value(value) if {*str(value)} & {*",:#{}[]'\""} else value
    pairs = [f"{name}: .." for name in needed if name not in names] + [f"{n}: {written}" for n in names]
    return f"write {'NAME' if key in names else key}: {{{', '.join(pairs)}}}" if names else ""


def _is_other(value: Any, kind: Any) -> bool:
    """True if a value is no word of a member that is one, or no number of a member that is a number."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return get_origin(kind) is Literal or (kind in (int, float) and not is_number)


def _value_inside(data: Any, part: str | int) -> Any:
    if isinstance(data, BaseModel):
        return getattr(data, str(part), None)
    if isinstance(data, Mapping):
        return data.get(part)
    if isinstance(data, (list, tuple)) and isinstance(part, int) and part < len(data):
        return data[part]
    return None


def _shape_inside(kind: Any, part: str | int) -> Shape | None:
    if isinstance(kind, type) and issubclass(kind, PluginChoice):
        return None
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        field = kind.model_fields.get(str(part))
        return None if field is None else shape_of(field.annotation, field.metadata)
    arguments = get_args(kind)
    if get_origin(kind) in (tuple, list):
        return shape_of(arguments[0])
    return shape_of(arguments[1]) if len(arguments) == 2 else None


def _explain(
    kind: str, reason: str, steps: list[_Step], positions: Positions, prefix: KeyPath
) -> GraphMessage:
    innermost, parent = steps[-1], steps[max(len(steps) - 2, 0)]
    path = prefix + tuple(step.key for step in steps[1:] if step.key is not None and not step.is_key)
    owner = parent.shape.only if parent.shape is not None else None
    name = _name_of(path)
    if innermost.is_key:
        bad = path[-1] if path else ""
        return positions.message(path, f"name {shown_value(bad)}", expects(Name), on_key=True)
    if kind == "extra_forbidden":
        return _unknown_key(str(innermost.key), owner, parent, path, positions)
    if kind == "missing" and path and isinstance(path[-1], int):  # a list with too few members
        fault = f"{_name_of(path[:-1])} is {shown_value(parent.value)}"
        return positions.message(path[:-1], fault, _valid_values(steps[:-1]))
    if kind == "missing":
        message = positions.message(path[:-1], f"key {name!r} is missing", _valid_values(steps))
        if owner is not Target or name != "nodes":
            return message
        return replace(message, allowed="nodes by name, indented below it", hint=_without_nodes(parent.value))
    if isinstance(owner, type) and issubclass(owner, PluginChoice):
        if kind == "value_error":
            numbers = _not_finite(parent.value)
            if numbers:
                return positions.message(
                    (*path[:-1], *numbers), f"{_name_of(numbers)} is not finite", "a number"
                )
            fault, remedy = "parameters that are not plain data", "words, finite numbers, lists and mappings"
        else:
            fault = "parameters that are not a mapping"
            remedy = f"a mapping of parameters, or the {owner.WORD} alone"
        return positions.message(path[:-1], fault, remedy)
    if isinstance(innermost.value, (list, tuple)) and name == "parent":
        fault = (
            f"two parents ({listed(innermost.value)})"
            if len(innermost.value) == 2
            else f"parent is {shown_value(innermost.value)}"
        )
        return positions.message(path, fault, "one parent, so that evidence reaches a node by one path only")
    if isinstance(innermost.shape.only if innermost.shape else None, type) and kind == "value_error":
        return _bad_choice(innermost, name, reason, path, positions)
    remedy = "at least one" if kind == "too_short" else _valid_values(steps)
    fault = (
        f"{name} is {shown_value(innermost.value)}"
        if innermost.value not in ({}, [], ())
        else f"{name} is empty"
    )
    word = innermost.value if isinstance(innermost.value, str) else ""
    message = positions.message(
        path, fault, remedy or _reason(reason), word=word, candidates=_words(innermost.shape)
    )
    return replace(message, hint=_as_written(innermost, name, steps[0].value))


def _as_written(step: _Step, name: str, data: Any) -> str:
    """Hint for a value of another form: the mapping that it would be, or a constant where none is read."""
    only = step.shape.only if step.shape is not None else None
    if isinstance(only, type) and issubclass(only, BaseModel) and not issubclass(only, Choice | PluginChoice):
        return _nested(name, step.value, only)
    constants = data.get("constants") if isinstance(data, Mapping) else None
    if isinstance(step.value, str) and isinstance(constants, Mapping) and step.value in constants:
        return "constants are read by expressions alone: write the number here"
    return ""


def _not_finite(value: Any) -> KeyPath | None:
    """The keys above a number of parameters that is infinite or NaN; None where all are finite."""
    if isinstance(value, float) and not isfinite(value):
        return ()
    pairs = (
        value.items() if isinstance(value, Mapping) else enumerate(value if isinstance(value, list) else ())
    )
    keys = ((key, _not_finite(content)) for key, content in pairs)
    return next(((key, *tail) for key, tail in keys if tail is not None), None)


def _without_nodes(target: Any) -> str:
    """Hint for a target without the key `nodes`; empty where nothing in it looks like a node."""
    nodes = [name for name, value in target.items() if name not in NODE_KEYS and is_like_node(value)]
    if nodes:
        return f"`{nodes[0]}` looks like a node: write `nodes:` above it and indent the nodes under it"
    return A_NODE if is_like_node(target) else ""


def _valid_values(steps: list[_Step]) -> str:
    """Valid values of the last step: for a parent, the inference nodes of the target."""
    innermost = steps[-1]
    if innermost.shape is None:
        return ""
    if innermost.key == "parent" and len(steps) > 2 and isinstance(steps[-3].value, Mapping):
        nodes = steps[-3].value.items()
        candidates = [
            name for name, node in nodes if node_kind(node) == "inference" and name != steps[-2].key
        ]
        return listed(candidates) or "the name of an inference node"
    return expects(*_parts(innermost.shape))


def _unknown_key(word: str, owner: Any, parent: _Step, path: KeyPath, positions: Positions) -> GraphMessage:
    owner = _meant(parent.value) if owner is InferenceNode else owner
    fields = list(owner.model_fields) if isinstance(owner, type) and issubclass(owner, BaseModel) else []
    candidates = [*fields, *MARKED] if owner is InferenceNode else fields
    fault = f"unknown key {shown_value(word)}"
    if isinstance(owner, type) and issubclass(owner, Choice):
        choice = str(path[-2]) if len(path) > 1 else "choice"
        if isinstance(parent.value, str):
            path = path[:-1]
        fault = f"unknown {shown_name(choice)} {shown_value(word)}"
    elif owner in NODES:
        fault += f" of {NODES[owner]} node"
    message = positions.message(
        path, fault, fields or "no settings", word=word, candidates=candidates, on_key=True
    )
    hint = (_misplaced(word, parent.value, owner) if fields else "") or hint_of(message) or _home(word)
    return replace(message, nearest="", hint=hint) if hint else message


def _home(word: str) -> str:
    """Hint of where in the language a key stands; empty where that may be at several places.

    >>> _home("static_discount"), _home("sd")
    ('`static_discount` is a key of targets: NAME: nodes: NAME: motion: expressions', '')
    """
    node = ("targets", "NAME", "nodes", "NAME")
    places = sorted(place for place in _places().get(word, ()) if "modes" not in place)
    if node in places and len(places) < 4:
        return f"`{word}` is a key of {': '.join(node)}"
    if not places or any(place[:-1] != places[0][:-1] for place in places):
        return ""
    home = (*places[0][:-1], " or ".join(place[-1] for place in places if place))
    return f"`{word}` is a key of {': '.join(home)}"


@cache
def _places() -> Mapping[str, set[tuple[str, ...]]]:
    """Each key of the language -> the keys above it, of every place where it may stand."""
    places: dict[str, set[tuple[str, ...]]] = {}
    waiting: list[tuple[tuple[str, ...], Any]] = [((), GraphSpec)]
    while waiting:
        path, annotation = waiting.pop()
        for kind in (shape_of(kind).only for kind in shape_of(annotation).kinds):
            arguments = get_args(kind)
            if arguments and get_origin(kind) is not Literal:
                waiting += (
                    [((*path, "NAME"), arguments[1])] if len(arguments) == 2 else [(path, arguments[0])]
                )
            elif (
                isinstance(kind, type) and issubclass(kind, BaseModel) and not issubclass(kind, PluginChoice)
            ):
                for name, setting in kind.model_fields.items():
                    places.setdefault(name, set()).add(path)
                    if name not in path:
                        waiting.append(((*path, name), setting.annotation))
    return places


def _misplaced(word: str, mapping: Any, model: type[BaseModel]) -> str:
    """Place where an unknown key of `mapping`, a value of `model`, belongs: below `nodes` or a key beside it.

    Empty where nothing says so.
    """
    if not isinstance(mapping, Mapping) or word not in mapping:
        return ""
    if issubclass(model, (GraphSpec, Target)) and is_like_node(mapping[word]):
        return A_NODE
    if issubclass(model, Target) and word in GraphSpec.model_fields:
        return f"`{word}` stands beside `targets:`, not inside a target"
    names = list(mapping)
    index = names.index(word)
    # A key that stands too far left follows what it belongs to.
    for name in (*reversed(names[:index]), *names[index:]):
        content = {} if mapping[name] is None else mapping[name]
        if isinstance(content, Mapping) and word not in content and word in _keys_below(model, name):
            return f"`{word}` is a key of `{name}`: indent it under `{name}:`"
    return ""


def _keys_below(model: type[BaseModel], name: str) -> set[str]:
    """The keys that the value of a field may have."""
    field = model.model_fields.get(name)
    kinds = shape_of(field.annotation).kinds if field is not None else ()
    models = [kind for kind in (shape_of(kind).only for kind in kinds) if isinstance(kind, type)]
    return {
        key
        for kind in models
        if issubclass(kind, BaseModel) and not issubclass(kind, PluginChoice)
        for key in kind.model_fields
    }


def _bad_choice(
    innermost: _Step, name: str, reason: str, path: KeyPath, positions: Positions
) -> GraphMessage:
    kind: Any = innermost.shape.only if innermost.shape is not None else None
    if not issubclass(kind, (Choice, PluginChoice)) or not isinstance(innermost.value, Mapping):
        return positions.message(path, f"{name} is {shown_value(innermost.value)}", _reason(reason))
    names = listed(innermost.value)
    fault = f"{name} names {names}" if len(innermost.value) else f"{name} is empty"
    if issubclass(kind, PluginChoice):
        is_single = len(innermost.value) == 1
        return positions.message(path, fault, _reason(reason) if is_single else f"exactly one {kind.WORD}")
    return positions.message(path, fault, f"exactly one of {', '.join(kind.model_fields)}")


def _name_of(path: KeyPath) -> str:
    if not path:
        return "the graph"
    if isinstance(path[-1], int):
        return f"{_name_of(path[:-1])}[{path[-1]}]"
    return shown_name(path[-1])


def _parts(shape: Shape) -> tuple[Any, tuple[Any, ...]]:
    if shape.only is not None:
        return shape.only, shape.constraints
    union: Any = shape.kinds[0]
    for kind in shape.kinds[1:]:
        union = union | kind
    return union, ()


def _words(shape: Shape | None) -> list[str]:
    kinds = shape.kinds if shape is not None else ()
    words: list[str] = []
    for kind in kinds:
        bare = shape_of(kind).only
        if get_origin(bare) is Literal:
            words += [str(word) for word in get_args(bare)]
        elif isinstance(bare, type) and issubclass(bare, Choice):
            words += list(bare.model_fields)
    return words


def _reason(reason: str) -> str:
    return (
        reason.removeprefix("Value error, ")
        .removeprefix("Assertion failed, ")
        .removeprefix("Input should be ")
    )


def _tag(kind: Any) -> str | None:
    return next((part.tag for part in getattr(kind, "__metadata__", ()) if isinstance(part, Tag)), None)


MOST_SHOWN = 10
"""Errors that are shown at once."""
WIDTH = 100
"""Columns of a line that are shown."""


def describe_error(error: GraphError) -> str:
    """The messages of an error, each with what stands in the file at its place, where that can be read."""
    texts = {message.file: _lines(message.file) for message in error.errors}
    parts = [part for message in error.errors[:MOST_SHOWN] for part in _describe(message, texts)]
    omitted = len(error.errors) - MOST_SHOWN
    if error.more or omitted > 0:
        how_many = "more errors" if error.more else f"{omitted} more"
        parts.append(f"{error.errors[0].file}: and {how_many}")
    return "\n".join(parts)


def _describe(message: GraphMessage, texts: Mapping[str, list[str]]) -> list[str]:
    lines = texts[message.file]
    parts = [str(message)]
    if message.line is not None and message.line <= len(lines) and lines[message.line - 1].strip():
        parts += _excerpt(lines[message.line - 1], message.line, message.column or 1)
    hint = hint_of(message)
    return [*parts, f"  hint: {hint}"] if hint else parts


def _excerpt(line: str, number: int, column: int) -> list[str]:
    """The line with its number, and a caret below the column; a tab is as wide as one space."""
    begin = max(0, column - WIDTH // 2) if len(line) > WIDTH else 0
    excerpt = line.replace("\t", " ")[begin : begin + WIDTH]
    head = f"  {number} | "
    return [f"{head}{excerpt}".rstrip(), f"{' ' * (len(head) - 2)}| {' ' * (column - 1 - begin)}^"]


def _lines(file: str) -> list[str]:
    """Of a file that can be read; none of any other, such as an installed graph."""
    path = Path(file)
    try:
        if not path.is_file() or path.stat().st_size > MAX_BYTES:
            return []
        return path.read_text(encoding="utf-8", errors="replace").removeprefix("\ufeff").splitlines()
    except (OSError, ValueError):
        return []


def is_like_node(value: Any) -> bool:
    """True if a value has a key by which a node is known."""
    return isinstance(value, Mapping) and not NODE_KEYS.isdisjoint(value)
