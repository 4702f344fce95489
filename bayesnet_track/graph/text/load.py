"""Load a graph, however it is named: an installed name, a path, or a graph written in Python."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.checks.run import Cues, check, check_graph, mapped_cues
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.document import read_document
from bayesnet_track.graph.text.mended import errors_behind
from bayesnet_track.graph.text.messages import GraphError, GraphMessage, nearest
from bayesnet_track.graph.text.read import bytes_of, read_graph, specify
from bayesnet_track.graphs import find_graph, graph_names
from bayesnet_track.observation.cue import CueDeclaration


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
        own = mapped_cues(cues)
        known: dict[str, CueDeclaration] = {**graph.declarations, **own}
        return check(graph.spec, cues=known, masks=graph.masks) if own else graph
    if isinstance(graph, GraphSpec | Mapping):
        return check_graph(graph, cues)
    if isinstance(graph, str) and not any(mark in graph for mark in "./\\"):
        if graph not in graph_names():
            raise GraphError([_no_such_graph(graph)])
        spec, at = read_graph(find_graph(graph))
        return check(spec, at, cues)
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
    names = graph_names()
    allowed = f"{', '.join(names)}, or a path to a file"
    return GraphMessage(
        name, 1, 1, (), "graph", "no installed graph of this name", allowed, nearest(name, names)
    )
