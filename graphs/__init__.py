"""The library of graph files, one per task; each can be named without a path."""

from __future__ import annotations

from difflib import get_close_matches
from importlib.resources import files
from importlib.resources.abc import Traversable

SUFFIX = ".yaml"


def graph_names() -> tuple[str, ...]:
    """The names of the installed graphs, sorted."""
    here = files(__name__).iterdir()
    return tuple(sorted(item.name.removesuffix(SUFFIX) for item in here if item.name.endswith(SUFFIX)))


def graph_folder() -> str:
    """Where the files of the installed graphs are."""
    return str(files(__name__))


def graphs_about() -> dict[str, str]:
    """What each installed graph is for, in its own words."""
    import yaml

    return {name: str(yaml.safe_load(find_graph(name).read_text("utf-8"))["about"]) for name in graph_names()}


def find_graph(name: str) -> Traversable:
    """The file of an installed graph.

    Raises:
        KeyError: no graph of that name; the message lists the names and the nearest one.
    """
    names = graph_names()
    if name not in names:
        near = "".join(f"; nearest: {close}" for close in get_close_matches(name, names, n=1))
        raise KeyError(f"no graph {name!r}; there are {', '.join(names)}{near}")
    return files(__name__).joinpath(name + SUFFIX)
