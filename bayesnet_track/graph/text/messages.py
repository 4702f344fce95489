"""What a graph error says: where, which node, what was found, what is allowed, the nearest name."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from typing import Any

KeyPath = tuple[str | int, ...]
"""Keys (and indices of lists) from the top of the file to a value."""

MAX_MESSAGES = 50
MAX_LISTED = 12
MAX_COMPARED = 100
MAX_SHOWN = 60


@dataclass(frozen=True)
class GraphMessage:
    """One error of a graph.

    Attributes:
        file: the file's name; ``<python>`` for a graph written in Python.
        line: line, from 1; None without a file.
        column: column in characters, from 1; None without a file.
        path: keys from the top of the graph to the value.
        node: the node, the target, or ``graph`` when it concerns neither.
        found: what was found.
        allowed: what is allowed instead, or empty.
        nearest: the allowed name nearest to what was found, or empty.
        hint: how it is mended, where only what stands around it says so, or empty.
    """

    file: str
    line: int | None
    column: int | None
    path: KeyPath
    node: str
    found: str
    allowed: str = ""
    nearest: str = ""
    hint: str = ""

    def __str__(self) -> str:
        """``file:line:column: node: found; allowed: ...; nearest: ...``."""
        file = self.file if self.file.isprintable() else repr(self.file)
        if self.line is None:
            place = f"{file}:{'.'.join(map(str, self.path)) or 'graph'}"
        else:
            place = f"{file}:{self.line}:{self.column}"
        text = f"{place}: {self.node}: {self.found}"
        if self.allowed:
            text += f"; allowed: {self.allowed}"
        if self.nearest:
            text += f"; nearest: {self.nearest}"
        return text


class GraphError(ValueError):
    """A graph that is not accepted.

    Attributes:
        errors: every error that was found (at most the first 50), in the order of the file; then those that
            show once these are mended, `behind` them.
        more: whether some were left out.
    """

    def __init__(self, errors: Sequence[GraphMessage], behind: Sequence[GraphMessage] = ()) -> None:
        ordered = [*_in_order(errors), *_in_order(behind)]
        self.errors = tuple(ordered[:MAX_MESSAGES])
        self.more = len(ordered) > MAX_MESSAGES
        super().__init__(self.errors)

    def __str__(self) -> str:
        """The messages, one a line."""
        lines = [str(error) for error in self.errors]
        if self.more:
            lines.append(f"{self.errors[0].file}: and more errors")
        return "\n".join(lines)


def _in_order(errors: Iterable[GraphMessage]) -> list[GraphMessage]:
    return sorted(errors, key=lambda error: (error.line or 0, error.column or 0))


@dataclass(frozen=True)
class Positions:
    """Positions of the keys and values of a graph: path -> (line, column), from 1.

    Without any (a graph written in Python) messages name the path of keys. `texts` holds the texts that stand
    in the file letter for letter, and how many quotes stand before each.
    """

    file: str = "<python>"
    keys: Mapping[KeyPath, tuple[int, int]] = field(default_factory=dict)
    values: Mapping[KeyPath, tuple[int, int]] = field(default_factory=dict)
    texts: Mapping[KeyPath, int] = field(default_factory=dict)

    def inside(self, message: GraphMessage, character: int) -> GraphMessage:
        """The message at a character of the text that it is about.

        Where the file writes the text in several lines or with escapes, the message names the character.
        """
        if message.column is None or message.path not in self.texts:
            return replace(message, found=f"{message.found} at character {character + 1}")
        return replace(message, column=message.column + self.texts[message.path] + character)

    def message(
        self,
        path: KeyPath,
        fault: str,
        remedy: str | Iterable[str] = "",
        *,
        word: str = "",
        candidates: Iterable[str] | None = None,
        on_key: bool = False,
    ) -> GraphMessage:
        """An error at the value (or key) at `path`, or at the nearest enclosing value that was written.

        `remedy` is a text or the allowed names; `word` is compared with `candidates` (or these names).
        """
        names = [] if isinstance(remedy, str) else list(remedy)
        text = remedy if isinstance(remedy, str) else listed(names)
        line, column = self._place(path, on_key)
        return GraphMessage(
            self.file,
            line,
            column,
            path,
            node_of(path),
            fault,
            text,
            nearest(word, names if candidates is None else candidates) if word else "",
        )

    def _place(self, path: KeyPath, on_key: bool) -> tuple[int | None, int | None]:
        if not self.values:
            return (None, None)
        if on_key and path in self.keys:
            return self.keys[path]
        while path not in self.values and path:
            path = path[:-1]
        return self.values.get(path, (1, 1))


def node_of(path: KeyPath) -> str:
    """The node a path lies in, else its target or query, else ``graph``.

    >>> node_of(("targets", "ball", "nodes", "color", "fuse")), node_of(("targets", "ball"))
    ('color', 'ball')
    """
    if path[:1] not in (("targets",), ("queries",)) or len(path) < 2:
        return "graph"
    is_node = path[0] == "targets" and len(path) > 3 and path[2] == "nodes"
    return shown_name(path[3] if is_node else path[1])


def nearest(word: str, names: Iterable[str]) -> str:
    """The name nearest to `word`, or empty when none is close.

    >>> nearest("activte", ["activate", "deactivate", "keep"]), nearest("x", ["size"])
    ('activate', '')
    >>> nearest("sd_x", ["sd_y_px", "sd_x_px"]), nearest("max_rate", ["early_rate", "learn_rate_max"])
    ('sd_x_px', 'learn_rate_max')
    >>> nearest("a.angel", ["a.x", "a.angle"]), nearest("a.turn", ["a.x", "a.angle"])
    ('a.angle', '')
    """
    names = list(names)
    owner, dot, name = word.rpartition(".")
    fields = [field.removeprefix(owner + dot) for field in names if dot and field.startswith(owner + dot)]
    if fields:  # the letters of the owner are right, and say nothing of the field
        field = nearest(name, fields)
        return f"{owner}.{field}" if field else ""
    some = [name for name in names if abs(len(name) - len(word)) <= 6 and name != word][:MAX_COMPARED]
    # `sd_x` is likelier to be `sd_x_px`, cut short, than `sd_y_px`, which has as many letters in common.
    parts = set(word.split("_"))
    begun = [name for name in some if name.startswith(word) or parts <= set(name.split("_"))]
    if len(word) > 2 and len(begun) == 1:
        return begun[0]
    # Half of the letters are enough only if the first one is among them: `deactivate` is not `estimate`.
    same_initial = [name for name in some if name[:1] == word[:1]]
    word = word[:MAX_SHOWN]
    return "".join(
        get_close_matches(word, some, n=1, cutoff=0.7) or get_close_matches(word, same_initial, n=1)
    )


def listed(names: Iterable[str]) -> str:
    """Names separated by commas; a long list is cut and says so."""
    all_names = list(names)
    text = ", ".join(map(shown_name, all_names[:MAX_LISTED]))
    return text if len(all_names) <= MAX_LISTED else f"{text}, ... ({len(all_names) - MAX_LISTED} more)"


def shown_name(name: object) -> str:
    """A name as it appears in a message: printable and short."""
    text = str(name)
    text = text if text.isprintable() and text else repr(text)
    return text if len(text) <= MAX_SHOWN else text[: MAX_SHOWN - 3] + "..."


def shown_value(value: Any) -> str:
    """A value as it appears in a message: in one short line, as YAML writes it.

    >>> shown_value("two"), shown_value(True), shown_value({"a": 1}), shown_value(None)
    ("'two'", 'true', '{"a": 1}', 'nothing')
    """
    if value is None:
        return "nothing"
    if isinstance(value, str):
        text = repr(value[:MAX_SHOWN] + "..." if len(value) > MAX_SHOWN else value)
        return text if len(text) <= 2 * MAX_SHOWN else text[: 2 * MAX_SHOWN] + "..."
    if isinstance(value, Mapping) and len(value) > 4:
        return f"a mapping of {len(value)} keys"
    if isinstance(value, (list, tuple)) and len(value) > 8:
        return f"a list of {len(value)}"
    try:
        text = json.dumps(value, ensure_ascii=True, default=repr)
    except (TypeError, ValueError, RecursionError):
        text = type(value).__name__
    return text if len(text) <= MAX_SHOWN else text[: MAX_SHOWN - 3] + "..."
