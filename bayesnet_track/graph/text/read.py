"""Read a graph file: YAML with positions into the typed specification, all errors at once."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.resources.abc import Traversable
from os import PathLike
from pathlib import Path as FilePath
from typing import Any

from pydantic import ValidationError

from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.document import MAX_BYTES, Document, read_document
from bayesnet_track.graph.text.explain import explain
from bayesnet_track.graph.text.messages import GraphError, GraphMessage, Path, Positions, nearest, shown_name


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


def specify(document: Document) -> GraphSpec:
    """The specification in a document; raises GraphError with everything that is wrong with its form."""
    errors = list(_only_in_python(document))
    try:
        spec = GraphSpec.model_validate(document.value)
    except ValidationError as error:
        empty = {message.path for message in errors}
        explained = explain(error, GraphSpec, document.value, document.at)
        errors += [message for message in explained if message.path not in empty]
    if errors:
        raise GraphError(errors)
    return spec


def bytes_of(source: PathLike[str] | Traversable, file: str) -> bytes:
    """The content of a file, up to the limit of a graph; raises GraphError where it cannot be read."""
    path = FilePath(source) if isinstance(source, PathLike) else source
    try:
        with path.open("rb") as stream:
            content: bytes = stream.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        found = f"cannot be read: {reason}"
        raise GraphError([GraphMessage(file, 1, 1, (), "graph", found, nearest=_beside(path))]) from None
    return content


def _beside(path: FilePath | Traversable) -> str:
    """The graph file in the same folder whose name is nearest; empty where there is none."""
    if not isinstance(path, FilePath):
        return ""
    try:
        near = nearest(path.name, [one.name for one in path.parent.glob("*.y*ml")])
    except OSError:  # a folder that cannot be read, or whose name is too long
        return ""
    return str(path.parent / near) if near else ""


def _only_in_python(document: Document) -> Iterator[GraphMessage]:
    """What the specification takes from Python but a file does not say: None, `cue:`, `detector:`."""
    waiting: list[tuple[Path, Any]] = [((), document.value)]
    while waiting:
        path, value = waiting.pop()
        name = path[-1] if path else "graph"
        if value is None:
            yield document.at.message(path, f"{shown_name(name)} is empty", "a value, or no such key")
        elif len(path) == 4 and isinstance(value, dict) and "factor" in value:
            for key in (key for key, inside in value.items() if inside is None):
                found, allowed = "factor is cut at a comma", "quotes around the expression"
                yield document.at.message((*path, key), found, allowed, on_key=True)
        elif name == "agent" and len(path) == 5 and isinstance(value, dict):
            if "cue" in value:
                yield document.at.message(
                    (*path, "cue"), "unknown cue 'cue'", "a cue, or one cue with its parameters", on_key=True
                )
        elif name == "detector" and len(path) == 4 and isinstance(value, dict) and "detector" in value:
            yield document.at.message(
                (*path, "detector"),
                "unknown detector 'detector'",
                "a detector, or one detector with its parameters",
                on_key=True,
            )
        elif isinstance(value, dict):
            waiting += [((*path, key), inside) for key, inside in value.items()]
        elif isinstance(value, list):
            waiting += [((*path, index), inside) for index, inside in enumerate(value)]
