"""A graph with what is wrong taken out or put right, so that the errors behind the first ones show, too."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from copy import deepcopy
from typing import Any

from bayesnet_track.graph.text.messages import GraphError, GraphMessage, Path
from bayesnet_track.observation.capabilities import CueError

ROUNDS = 6
"""How often what was found is mended, and the rest is checked again."""

NODE = 4
"""Keys from the top to a node: targets, its type, nodes, its name."""

TREE = frozenset({"parent", "agent", "factor", "fuse", "given"})
"""Keys of a node that say where it stands in the tree, and what its parent needs."""


def errors_behind(
    value: Any, first: Iterable[GraphMessage], find: Callable[[Any], object]
) -> list[GraphMessage]:
    """What `find` reports of `value` (plain data) once the `first` errors are mended; it raises GraphError.

    What may follow from a guess is left out: what concerns the same node, what stands below a guessed key, or
    any node of a type of target from which one was taken out.
    """
    value, found, newest = deepcopy(value), list[GraphMessage](), list(first)
    touched = set[Path]()
    for _ in range(ROUNDS):
        touched |= {place for message in reversed(newest) for place in _mend(value, message)}
        try:
            find(value)
        except CueError:
            break
        except GraphError as error:
            newest = [one for one in error.errors if not _follows(one, touched)]
        else:
            break
        if not newest:
            break
        found += newest
    return found


def _follows(message: GraphMessage, touched: set[Path]) -> bool:
    """Whether a message may be due to what was mended."""
    path = message.path
    return any(path[: len(place)] == place or place[: len(path)] == path for place in touched)


def _mend(value: Any, message: GraphMessage) -> list[Path]:
    """Put right what a message is about, in place, or take it out; the places that this was a guess for.

    A name is replaced by the nearest one, a missing parent by the only root. What else is wrong is taken out,
    with its whole node where that cannot do without it.
    """
    path = _written(value, message.path)
    node = path[:NODE]
    if not path:
        return [()]
    inside, key, word = _at(value, path[:-1]), path[-1], message.nearest
    # What makes a node a child, or a child of another one, concerns the whole tree.
    concerned = [path[:2], ("joins",)] if TREE & {*path[NODE:]} else [node]
    if word and isinstance(inside, dict) and repr(key) in message.found and word not in inside:
        inside[word] = inside.pop(key)
        return [(*path[:-1], word)] if message.found.startswith("unknown key") else concerned
    if word and isinstance(inside[key], str) and repr(inside[key]) in message.found:
        inside[key] = word
        return [] if key == "fuse" else concerned
    if len(node) == NODE and message.found.startswith("key 'parent'"):
        roots = [
            name
            for name, one in _at(value, node[:-1]).items()
            if isinstance(one, dict) and not {"agent", "parent"} & one.keys()
        ]
        if len(roots) == 1:
            _at(value, node)["parent"] = roots[0]
            return [path[:2], ("joins",)]
    if len(path) > NODE and key != "parent" and "missing" not in message.found:
        del inside[key]
        return concerned
    del _at(value, node[:-1])[node[-1]]
    # A node that stands outside all targets may belong to any of them.
    return [()] if message.hint and len(path) < 3 else [path[:2], ("joins",)]


def _written(value: Any, path: Path) -> Path:
    """As much of a path as leads through values that are there."""
    for length, key in enumerate(path):
        try:
            value = value[key]
        except (KeyError, IndexError, TypeError):
            return path[:length]
    return path


def _at(value: Any, path: Path) -> Any:
    for key in path:
        value = value[key]
    return value
