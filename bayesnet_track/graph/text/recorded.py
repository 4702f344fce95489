"""Graphs that earlier versions recorded: their words are replaced by today's before they are read."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args, get_origin

from pydantic import BaseModel

from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.checks.run import Cues, check
from bayesnet_track.graph.settings.base import Choice, PluginChoice
from bayesnet_track.graph.settings.net import node_kind
from bayesnet_track.graph.spec import AgentNode, FactorNode, GraphSpec, InferenceNode
from bayesnet_track.graph.text.document import read_document
from bayesnet_track.graph.text.messages import GraphError, Positions
from bayesnet_track.graph.text.read import bytes_of, read_graph
from bayesnet_track.graph.text.renamed import new_word
from bayesnet_track.graph.text.shapes import shape_of
from bayesnet_track.graph.text.write import plain_text
from bayesnet_track.observation.masks import Mask


def recorded_text(text: str) -> str:
    """The text of a recorded graph in today's words; the text itself where nothing was renamed.

    >>> recorded_text("name: g\\ntargets: {t: {recall: {frames: 9}}}\\n")
    'name: g\\ntargets:\\n  t:\\n    reidentify:\\n      frames: 9\\n'
    """
    try:
        before = read_document(text, "graph.yaml").value
    except GraphError:
        return text  # whoever reads the text says what is wrong with it
    after = _current(before, GraphSpec)
    return text if after == before else plain_text(after)


def read_recorded(path: Path) -> tuple[GraphSpec, Positions]:
    """The specification in a file of a run directory.

    Raises:
        GraphError: every error of it.
    """
    content = bytes_of(path, str(path))
    try:
        return read_graph(recorded_text(content.decode()), str(path))
    except UnicodeDecodeError:
        return read_graph(content, str(path))


def load_recorded(
    path: Path, cues: Cues | None = None, masks: Mapping[str, Mask] | None = None
) -> CheckedGraph:
    """The checked graph of a run directory; `cues` as of `load_graph`, `masks` as of `check`.

    Raises:
        GraphError: every error of it.
    """
    return check(*read_recorded(path), cues, masks)


def _current(data: Any, annotation: Any) -> Any:
    kind = _kind(data, annotation)
    if isinstance(kind, type) and issubclass(kind, PluginChoice):
        return _plugin(data)
    if isinstance(kind, type) and issubclass(kind, Choice) and isinstance(data, str):
        return new_word(kind, data) or data
    if isinstance(kind, type) and issubclass(kind, BaseModel) and isinstance(data, Mapping):
        return dict(_entry(kind, key, value) for key, value in data.items())
    arguments = get_args(kind)
    if isinstance(data, Mapping) and len(arguments) == 2:
        return {key: _current(value, arguments[1]) for key, value in data.items()}
    if isinstance(data, list) and get_origin(kind) in (tuple, list):
        return [_current(item, arguments[0]) for item in data]
    return data


def _kind(data: Any, annotation: Any) -> Any:
    """The type that the data are of; of several, the one of settings (an agent node where it names one)."""
    shape = shape_of(annotation)
    kinds = [shape_of(kind).only for kind in shape.kinds]
    if AgentNode in kinds:
        return {"agent": AgentNode, "factor": FactorNode}.get(node_kind(data), InferenceNode)
    settings = [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)]
    return (settings or kinds)[0]


def _entry(kind: type[BaseModel], key: str, value: Any) -> tuple[str, Any]:
    name = new_word(kind, key) or key
    field = kind.model_fields.get(name)
    if isinstance(value, str) and (new := new_word(kind, f"{name}.{value}")):
        return name, new
    return name, value if field is None else _current(value, field.annotation)


def _plugin(data: Any) -> Any:
    if not isinstance(data, Mapping):
        return data
    return {
        name: {new_word(name, key) or key: value for key, value in inside.items()}
        if isinstance(inside, Mapping)
        else inside
        for name, inside in data.items()
    }
