"""Graphs read and checked, however they are named: installed, by path, or written in Python."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from copy import deepcopy
from dataclasses import replace
from importlib.resources.abc import Traversable
from itertools import pairwise
from os import PathLike
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.checks.run import Cues, check, check_graph, mapped_cues
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.document import MAX_BYTES, PositionedData, read_document
from bayesnet_track.graph.text.explain import explain_errors
from bayesnet_track.graph.text.messages import (
    GraphError,
    GraphMessage,
    KeyPath,
    Positions,
    nearest,
    shown_name,
)
from bayesnet_track.graphs import find_graph, graph_names
from bayesnet_track.observation.cue import CueDeclaration, CueError

ROUNDS = 6
"""How often what was found is mended, and the rest is checked again."""

NODE = 4
"""Keys from the top to a node: targets, its type, nodes, its name."""

TREE = frozenset({"parent", "agent", "factor", "fuse", "given"})
"""Keys of a node that say where it stands in the tree, and what its parent needs."""

BESIDE_QUESTION = frozenset({"unit", "interval", "event_above"})
"""Keys that a query can do without."""


def errors_behind(
    value: Any, first: Iterable[GraphMessage], find: Callable[[Any], object]
) -> list[GraphMessage]:
    """Messages that `find` reports of `value` (plain data) with `first` mended; it raises GraphError.

    What may follow from a guess is left out: what concerns the same node, what stands below a guessed key, or
    any node of a type of target from which one was taken out.
    """
    value, messages, newest = deepcopy(value), list[GraphMessage](), list(first)
    touched = set[KeyPath]()
    for _ in range(ROUNDS):
        touched |= {place for message in reversed(newest) for place in _mend(value, message)}
        try:
            find(value)
        except CueError:
            break
        except GraphError as error:
            newest = [message for message in error.errors if not _follows(message, touched)]
        else:
            break
        if not newest:
            break
        messages += newest
    return messages


def _follows(message: GraphMessage, touched: set[KeyPath]) -> bool:
    """True if a message may be due to what was mended."""
    path = message.path
    return any(path[: len(place)] == place or place[: len(path)] == path for place in touched)


def _mend(value: Any, message: GraphMessage) -> list[KeyPath]:
    """Put right what a message is about, in place, or take it out; the places that this was a guess for.

    A name is replaced by the nearest one, a missing parent by the only root. What else is wrong is taken out,
    with its whole node where that cannot do without it.
    """
    path = _written(value, message.path)
    if message.path[:1] == ("queries",) and len(message.path) > 1:
        # Nothing refers to a query; without its question it would be none.
        place = message.path[: 3 if len(path) > 2 and path[2] in BESIDE_QUESTION else 2]
        if len(path) >= len(place):
            del _value_at(value, place[:-1])[place[-1]]
        return [place]
    node = path[:NODE]
    if not path:
        return [()]
    holder, key, word = _value_at(value, path[:-1]), path[-1], message.nearest
    # What makes a node a child, or a child of another one, concerns the whole tree.
    concerned = [path[:2], ("joins",)] if TREE & {*path[NODE:]} else [node]
    if word and isinstance(holder, dict) and repr(key) in message.found and word not in holder:
        holder[word] = holder.pop(key)
        return [(*path[:-1], word)] if message.found.startswith("unknown key") else concerned
    if word and isinstance(holder[key], str) and repr(holder[key]) in message.found:
        holder[key] = word
        return [] if key == "fuse" else concerned
    if len(node) == NODE and message.found.startswith("key 'parent'"):
        roots = [
            name
            for name, sibling in _value_at(value, node[:-1]).items()
            if isinstance(sibling, dict) and not {"agent", "parent"} & sibling.keys()
        ]
        if len(roots) == 1:
            _value_at(value, node)["parent"] = roots[0]
            return [path[:2], ("joins",)]
    if len(path) > NODE and key != "parent" and "missing" not in message.found:
        del holder[key]
        return concerned
    del _value_at(value, node[:-1])[node[-1]]
    # A node that stands outside all targets may belong to any of them.
    return [()] if "`nodes:`" in message.hint and len(path) < 3 else [path[:2], ("joins",)]


def _written(value: Any, path: KeyPath) -> KeyPath:
    """Part of a path that leads through values that are there."""
    for length, key in enumerate(path):
        try:
            value = value[key]
        except (KeyError, IndexError, TypeError):
            return path[:length]
    return path


def _value_at(value: Any, path: KeyPath) -> Any:
    for key in path:
        value = value[key]
    return value


def read_graph(
    source: str | bytes | PathLike[str] | Traversable, file: str = "<text>"
) -> tuple[GraphSpec, Positions]:
    """The specification in a YAML text (str or bytes) or file (a path), and where each part of it stands.

    `file` names a text in messages; a path names itself.

    Raises:
        GraphError: every error of the file, each with file, line and column.
    """
    if not isinstance(source, (str, bytes)):
        file = source.name if not isinstance(source, PathLike) else str(source)
        source = bytes_of(source, file)
    document = read_document(source, file)
    return specify(document), document.at


def specify(document: PositionedData) -> GraphSpec:
    """The specification in a document; raises GraphError with everything that is wrong with its form."""
    errors = list(_only_in_python(document))
    try:
        spec = GraphSpec.model_validate(document.value)
    except ValidationError as error:
        empty = {message.path for message in errors}
        explained = explain_errors(error, GraphSpec, document.value, document.at)
        errors += [message for message in explained if message.path not in empty]
    if errors:
        raise GraphError(errors)
    return spec


def bytes_of(source: PathLike[str] | Traversable, file: str) -> bytes:
    """The content of a file, up to the limit of a graph; raises GraphError where it cannot be read."""
    path = Path(source) if isinstance(source, PathLike) else source
    try:
        with path.open("rb") as stream:
            content: bytes = stream.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        fault = f"cannot be read: {reason}"
        raise GraphError([GraphMessage(file, 1, 1, (), "graph", fault, nearest=_beside(path))]) from None
    return content


def _beside(path: Path | Traversable) -> str:
    """The graph file in the same folder whose name is nearest; empty where there is none."""
    if not isinstance(path, Path):
        return ""
    try:
        suggestion = nearest(path.name, [sibling.name for sibling in path.parent.glob("*.y*ml")])
    except OSError:  # a folder that cannot be read, or whose name is too long
        return ""
    return str(path.parent / suggestion) if suggestion else ""


def _only_in_python(document: PositionedData) -> Iterator[GraphMessage]:
    """Values that Python may give and a file may not: None, `cue:`, `detector:`."""
    waiting: list[tuple[KeyPath, Any]] = [((), document.value)]
    while waiting:
        path, value = waiting.pop()
        name = path[-1] if path else "graph"
        if value is None:
            yield document.at.message(path, f"{shown_name(name)} is empty", "a value, or no such key")
        elif len(path) == 4 and isinstance(value, dict) and "factor" in value:
            for key in (key for key, content in value.items() if content is None):
                fault, remedy = "factor is cut at a comma", "quotes around the expression"
                yield document.at.message((*path, key), fault, remedy, on_key=True)
        elif len(path) == 2 and path[0] == "queries" and isinstance(value, dict) and None in value.values():
            for key in (key for key, content in value.items() if content is None):
                fault, remedy = "expression is cut at a comma", "quotes around the expression"
                yield document.at.message((*path, key), fault, remedy, on_key=True)
        elif isinstance(value, dict) and (cut := _cut_at_a_comma(value)):
            fault, remedy = f"{cut} is cut at a comma", "quotes around the expression"
            yield document.at.message((*path, cut), fault, remedy)
        elif name == "agent" and len(path) == 5 and isinstance(value, dict):
            if "cue" in value:
                yield document.at.message(
                    (*path, "cue"), "unknown cue 'cue'", "a cue, or one cue with its parameters", on_key=True
                )
            for cue, content in value.items():
                for key, parameter in content.items() if isinstance(content, dict) else ():
                    if isinstance(parameter, dict) and (cut := _cut_at_a_comma(parameter)):
                        fault, remedy = f"{cut} is cut at a comma", "quotes around the expression"
                        yield document.at.message((*path, cue, key, cut), fault, remedy)
        elif name == "detector" and len(path) == 4 and isinstance(value, dict) and "detector" in value:
            yield document.at.message(
                (*path, "detector"),
                "unknown detector 'detector'",
                "a detector, or one detector with its parameters",
                on_key=True,
            )
        elif isinstance(value, dict):
            waiting += [((*path, key), content) for key, content in value.items()]
        elif isinstance(value, list):
            waiting += [((*path, index), content) for index, content in enumerate(value)]


def _cut_at_a_comma(value: Mapping[str, Any]) -> str:
    """The key whose text opens a bracket that the next keys, without values, close; empty where none is."""
    for key, next_key in pairwise(value):
        text = value[key]
        if value[next_key] is None and isinstance(text, str) and text.count("(") > text.count(")"):
            return str(key)
    return ""


def load_graph(
    graph: str | PathLike[str] | GraphSpec | Mapping[str, Any] | CheckedGraph, cues: Cues | None = None
) -> CheckedGraph:
    """The checked graph of an installed name (``"general"``), a file's path, a specification, or plain data.

    A word without a dot or slash is an installed graph's name; anything else is a path. `cues` are some of
    one's own beside the installed ones: declarations, or paths of Python files with a ``CUE``, which are run.
    A mapping stands for all cues that there are.

    Raises:
        GraphError: no such graph, or all of its errors.
        CueError: one of `cues` cannot be used.
    """
    if isinstance(graph, CheckedGraph):
        passed_cues = mapped_cues(cues)
        available: dict[str, CueDeclaration] = {**graph.declarations, **passed_cues}
        return check(graph.spec, None, available, graph.masks, graph.calibrations) if passed_cues else graph
    if isinstance(graph, GraphSpec | Mapping):
        return check_graph(graph, cues)
    if isinstance(graph, str) and not any(mark in graph for mark in "./\\"):
        if graph not in graph_names():
            raise GraphError([_no_such_graph(graph)])
        spec, positions = read_graph(find_graph(graph))
        return check(spec, positions, cues)
    return _load_file(Path(graph), cues)


def _load_file(path: Path, cues: Cues | None) -> CheckedGraph:
    document = read_document(bytes_of(path, str(path)), str(path))
    cues = tuple(cues) if isinstance(cues, Iterator) else cues  # it is needed more than once

    def load(value: Any) -> CheckedGraph:
        return check(specify(replace(document, value=value)), document.at, cues)

    try:
        return load(document.value)
    except GraphError as error:
        if error.more:
            raise
        raise GraphError(error.errors, errors_behind(document.value, error.errors, load)) from None


def _no_such_graph(name: str) -> GraphMessage:
    remedy = "a name that `bayesnet-track list` prints, or a path to a file"
    return GraphMessage(
        name, 1, 1, (), "graph", "no installed graph of this name", remedy, nearest(name, graph_names())
    )
