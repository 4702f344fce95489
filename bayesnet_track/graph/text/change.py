"""Changes of a graph's values, as plain data or in its text, whose order, comments and layout stay."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from typing import Any

import yaml

from bayesnet_track.graph.checked import Calibration, CheckedGraph
from bayesnet_track.graph.checks.run import check_graph
from bayesnet_track.graph.settings.net import ADAPTATION, node_kind
from bayesnet_track.graph.text.messages import GraphError, listed, nearest, shown_name
from bayesnet_track.graph.text.write import flow_text
from bayesnet_track.observation.image_files import Mask
from bayesnet_track.observation.settings import to_caller

Keys = tuple[str, ...]


class ChangeError(ValueError):
    """A change that cannot be made; says which names there are and which is nearest."""


def change_graph(
    text: str,
    changes: Sequence[str],
    adaptation: bool = True,
    masks: Mapping[str, Mask] | None = None,
    calibrations: Mapping[str, Calibration] | None = None,
) -> CheckedGraph:
    """The graph of a canonical text with other values.

    Args:
        text: YAML without comments, as a run directory keeps it.
        changes: each ``path=value``. The path names keys from the top, joined by dots; ``targets``, the plate
            and ``nodes`` may be left out (``square.adapt.activate.above.ud_px2=200``). The value is YAML.
        adaptation: False for all agents always on: no rule switches one, none stops itself.
        masks: images of its factors by their paths as written; others are read.
        calibrations: its cameras in the same way.

    Raises:
        ChangeError: no such path, or one that may mean several; a value that is no YAML.
        GraphError: what comes out fails a check; every error, with the path.
    """
    data = yaml.safe_load(text)
    for change in changes:
        path, equals, value = change.partition("=")
        if not equals or not path.strip():
            raise ChangeError(
                f"{change!r}: PATH=VALUE is needed, such as square.adapt.activate.above.ud_px2=200"
            )
        keys = resolve(data, tuple(path.strip().split(".")))
        data = _with(data, keys, _value(path, value))
    try:
        return check_graph(data if adaptation else always_on(data), None, masks, calibrations)
    except GraphError as error:
        raise GraphError(
            [replace(message, file=to_caller("--set", "changes")) for message in error.errors]
        ) from None


def always_on(data: Mapping[str, Any]) -> dict[str, Any]:
    """The graph with every agent on from the start and nothing that switches it."""
    graph = deepcopy(dict(data))
    for target in graph["targets"].values():
        for node in target["nodes"].values():
            for key in ADAPTATION[node_kind(node)]:
                node.pop(key, None)
    return graph


def resolve(data: Mapping[str, Any], path: Keys) -> Keys:
    """The keys from the top that a path means.

    Raises:
        ChangeError: nothing begins so, or several places do.

    >>> tree = {"name": "g", "targets": {"ball": {"nodes": {"ball": {"fuse": "pool"}}}}}
    >>> resolve(tree, ("ball", "fuse"))
    ('targets', 'ball', 'nodes', 'ball', 'fuse')
    """
    places = [(*prefix, *path) for prefix in _prefixes(data)]
    depth = {place: _depth(data, place) - (len(place) - len(path)) for place in places}
    matching = [place for place in places if depth[place] > 0]
    if not matching:
        names = list(dict.fromkeys(key for prefix in _prefixes(data) for key in _mapping_at(data, prefix)))
        suggestion = next(_deeper(data, path[0]), ()) or (nearest(path[0], names),)
        example = "; a path begins with one of them, as in NODE.belief.particles.size=1000"
        raise ChangeError(
            f"{'.'.join(path)}: nothing is called {shown_name(path[0])}; there are {listed(names)}"
            + (f"; nearest: {'.'.join((*suggestion, *path[1:]))}" if suggestion[0] else example)
        )
    max_depth = max(depth[place] for place in matching)
    deepest = [place for place in matching if depth[place] == max_depth]
    # A plate and its root often share a name: a node is meant, unless a plate alone may have the key.
    if len(deepest) > 1 and max_depth == 1 and len(path) > 1:
        plates = [place for place in deepest if len(place) == len(path) + 1]
        nodes = [place for place in deepest if place not in plates]
        deepest = plates if path[1] in _plate_keys() and plates else nodes or deepest
    if len(deepest) > 1:
        ways = ", ".join(".".join(place) for place in deepest)
        raise ChangeError(f"{'.'.join(path)}: may mean {ways}; write one of them")
    return deepest[0]


def _plate_keys() -> frozenset[str]:
    from bayesnet_track.graph.spec import Target

    return frozenset(Target.model_fields)


def _prefixes(data: Mapping[str, Any]) -> Iterator[Keys]:
    yield ()
    yield ("targets",)
    for plate in data.get("targets", {}):
        yield ("targets", plate)
        yield ("targets", plate, "nodes")


def _mapping_at(data: Any, keys: Keys) -> Mapping[str, Any]:
    for key in keys:
        data = data[key]
    return data if isinstance(data, Mapping) else {}


def _deeper(data: Mapping[str, Any], name: str) -> Iterator[Keys]:
    """Paths from a node to a key of this name, wherever it stands; shallow ones first."""
    waiting: list[tuple[Keys, Any]] = [
        ((node,), content)
        for target in data.get("targets", {}).values()
        for node, content in target.get("nodes", {}).items()
    ]
    while waiting:
        path, part = waiting.pop(0)
        if isinstance(part, Mapping):
            if name in part:
                yield (*path, name)
            waiting += [((*path, str(key)), child) for key, child in part.items()]


def _depth(data: Any, keys: Keys) -> int:
    """Number of the keys that are there."""
    for number, key in enumerate(keys):
        if not isinstance(data, Mapping) or key not in data:
            return number
        data = data[key]
    return len(keys)


def _with(data: Any, keys: Keys, value: Any) -> Any:
    """The data with a value at these keys; a bare word in their way becomes a mapping (`fuse: pool`)."""
    if not keys:
        return value
    if isinstance(data, str) and data == keys[0]:
        data = {}
    mapping = dict(data) if isinstance(data, Mapping) else {}
    return {**mapping, keys[0]: _with(mapping.get(keys[0]), keys[1:], value)}


def _value(path: str, text: str) -> Any:
    try:
        return yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ChangeError(f"{path}: {text!r} is no value: {' '.join(str(error).split())}") from None


MARK = "# fit: "
"""How a comment begins that belongs to a value that was set here, and goes with it."""


def set_value(text: str, path: tuple[str, ...], value: Any, comment: str = "") -> str:
    """The YAML text with plain data `value` at `path`, whose mapping must be there.

    A key that is there gets the new value in its place; a new one is the last of its mapping. `comment`
    stands on a line of its own above the key (above the nearest key that begins a line where the mapping is
    written in one line), in place of an earlier one that was set here.

    Raises:
        KeyError: the mapping that should hold the key is not there.

    >>> print(set_value("a:\\n  b: 1 # one\\n  c: {d: 2}  # two\\n", ("a", "c", "e"), 3.5, "by hand"), end="")
    a:
      b: 1 # one
      # fit: by hand
      c: {d: 2, e: 3.5}  # two
    """
    top = yaml.compose(text, Loader=yaml.SafeLoader)
    holder, line = top, None
    for name in path[:-1]:
        key, holder = _entry(holder, name)
        line = key.start_mark.line if _begins(text, key) else line
    if not isinstance(holder, yaml.MappingNode):
        raise KeyError(path)
    written = flow_text(value)
    entries = {key.value: (key, node) for key, node in holder.value}
    if path[-1] in entries:
        key, node = entries[path[-1]]
        end = _end(text, node)
        text = f"{text[: node.start_mark.index]}{written}{text[end:]}"
        if _begins(text, key):
            line = key.start_mark.line
    elif holder.flow_style:
        closing = holder.end_mark.index - 1
        body = text[:closing].rstrip()
        joint = " " if body.endswith(",") else ", " if holder.value else ""
        text = f"{body}{joint}{path[-1]}: {written}{text[closing:]}"
    else:
        first = holder.value[0][0].start_mark
        end = _end(text, holder.value[-1][1])
        end = _line_end(text, end)
        line = text.count("\n", 0, end) + 1
        text = f"{text[:end]}\n{' ' * first.column}{path[-1]}: {written}{text[end:]}"
    return _comment(text, line or 0, comment)


def _entry(holder: Any, name: str) -> tuple[Any, Any]:
    if isinstance(holder, yaml.MappingNode):
        for key, node in holder.value:
            if key.value == name:
                return key, node
    raise KeyError(name)


def _begins(text: str, key: Any) -> bool:
    """True if nothing but space stands before the key in its line."""
    begin = text.rfind("\n", 0, key.start_mark.index) + 1
    return not text[begin : key.start_mark.index].strip()


def _end(text: str, node: Any) -> int:
    """End of a value: a block collection's mark lies behind the comments that follow it."""
    while isinstance(node, yaml.CollectionNode) and not node.flow_style and node.value:
        last_child = node.value[-1]
        node = last_child[1] if isinstance(last_child, tuple) else last_child
    end: int = node.end_mark.index
    return len(text[:end].rstrip()) if isinstance(node, yaml.ScalarNode) and node.style in ("|", ">") else end


def _line_end(text: str, index: int) -> int:
    newline = text.find("\n", index)
    return len(text) if newline < 0 else newline


def _comment(text: str, line: int, comment: str) -> str:
    lines = text.split("\n")
    indent = lines[line][: len(lines[line]) - len(lines[line].lstrip())]
    begin = line
    while begin > 0 and lines[begin - 1].lstrip().startswith(MARK):
        begin -= 1
    comment_lines = [f"{indent}{MARK}{part}" for part in comment.split("\n")] if comment else []
    return "\n".join([*lines[:begin], *comment_lines, *lines[line:]])
