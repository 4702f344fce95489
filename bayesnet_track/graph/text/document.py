"""Bounded, safe reader of YAML that keeps line and column of every key and value.

Plain data only: mappings with distinct keys, lists, and the scalars of YAML 1.2. Tags, anchors, aliases and
merge keys are refused. Limits are checked while the text is read, so that a hostile file costs little.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from typing import Any

import yaml
from yaml.events import (
    AliasEvent,
    CollectionEndEvent,
    DocumentEndEvent,
    DocumentStartEvent,
    Event,
    MappingEndEvent,
    MappingStartEvent,
    NodeEvent,
    ScalarEvent,
    SequenceEndEvent,
    StreamEndEvent,
    StreamStartEvent,
)
from yaml.parser import Parser
from yaml.reader import Reader
from yaml.scanner import Scanner

from bayesnet_track.graph.text.messages import (
    MAX_MESSAGES,
    GraphError,
    GraphMessage,
    KeyPath,
    Positions,
    shown_name,
    shown_value,
)

_NULL = frozenset({"", "~", "null", "Null", "NULL"})
_BOOL = {"true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False}
_INT = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_INFINITY = re.compile(r"([-+]?)\.(inf|Inf|INF)")
_NAN = frozenset({".nan", ".NaN", ".NAN"})


def plain_scalar(text: str) -> str | int | float | bool | None:
    """The value of an unquoted scalar in the core schema of YAML 1.2.

    >>> [plain_scalar(t) for t in ("on", "1:30", "010", "0x1F", "1e3", "~", "TRUE")]
    ['on', '1:30', 10, 31, 1000.0, None, True]
    """
    if text in _NULL:
        return None
    if text in _BOOL:
        return _BOOL[text]
    if _INT.fullmatch(text):
        return int(text, 10 if text[1:2] not in ("o", "x") else 0)
    if _FLOAT.fullmatch(text):
        return float(text)
    if infinite := _INFINITY.fullmatch(text):
        return -math.inf if infinite[1] == "-" else math.inf
    return math.nan if text in _NAN else text


MAX_BYTES = 64 * 1024
MAX_DEPTH = 32
MAX_NODES = 20_000
MAX_SCALAR = 4096
MAX_DIGITS = 18

_REFUSED_CHARACTER = re.compile(
    "[^\t\n\r\x20-\x7e\xa0-\u2027\u202a-\ud7ff\ue000-\ufefe\uff00-\ufffd\U00010000-\U0010ffff]"
)


@dataclass(frozen=True)
class PositionedData:
    """The plain data of a file and where each part of it stands."""

    value: Any
    at: Positions


def read_document(text: str | bytes, file: str) -> PositionedData:
    """The single document of a YAML text.

    Raises:
        GraphError: not UTF-8, not YAML, more than one document, or outside the limits.
    """
    return _Building(file).document(_decode(text, file))


def _decode(source: str | bytes, file: str) -> str:
    content = source if isinstance(source, bytes) else source.encode("utf-8", "surrogatepass")
    if len(content) > MAX_BYTES:
        raise _error(file, 1, 1, f"more than {MAX_BYTES} bytes", f"at most {MAX_BYTES} bytes")
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError as error:
        good = content[: error.start].decode("utf-8")
        fault = f"byte 0x{content[error.start]:02x} that is not UTF-8"
        raise _error(file, *_line_and_column(good), fault, "text in UTF-8") from None
    text = text.removeprefix("\ufeff")
    if refused := _REFUSED_CHARACTER.search(text):
        fault = f"character U+{ord(refused[0]):04X}"
        raise _error(file, *_line_and_column(text[: refused.start()]), fault, "printable characters")
    return text


def _line_and_column(text: str) -> tuple[int, int]:
    lines = re.split("\r\n|\r|\n", text.removeprefix("\ufeff"))
    return len(lines), len(lines[-1]) + 1


def _error(file: str, line: int, column: int, fault: str, remedy: str = "") -> GraphError:
    return GraphError([GraphMessage(file, line, column, (), "graph", fault, remedy)])


class _Events(Reader, Scanner, Parser):
    """PyYAML's pure parser, which stops at deep flow collections before it looks ahead into them."""

    def __init__(self, text: str) -> None:
        Reader.__init__(self, text)
        Scanner.__init__(self)
        Parser.__init__(self)

    def need_more_tokens(self) -> bool:
        """Inherited check, with a short way for the usual case; the parser asks some ten times a token."""
        if self.tokens and not self.possible_simple_keys:
            return False
        return bool(super().need_more_tokens())

    def fetch_flow_collection_start(self, token: Any) -> None:
        """Inherited step, to a depth."""
        if self.flow_level >= MAX_DEPTH:
            raise _TooMuch(self.get_mark(), *_TOO_DEEP)
        super().fetch_flow_collection_start(token)


def _length(event: Event) -> int:
    """Characters that a value takes in its line; -1 where it takes several lines."""
    start: Any = event.start_mark
    end: Any = event.end_mark
    return int(end.index - start.index) if end.line == start.line else -1


def _place(event: Event) -> tuple[int, int]:
    mark: Any = event.start_mark
    return (mark.line + 1, mark.column + 1)


class _TooMuch(Exception):
    """A limit is passed: mark, what was found, what is allowed."""


_TOO_DEEP = (f"nested deeper than {MAX_DEPTH} levels", f"at most {MAX_DEPTH} levels")


@dataclass
class _Building:
    """One pass over the events of a text."""

    file: str
    keys: dict[KeyPath, tuple[int, int]] = field(default_factory=dict)
    values: dict[KeyPath, tuple[int, int]] = field(default_factory=dict)
    texts: dict[KeyPath, int] = field(default_factory=dict)
    errors: list[GraphMessage] = field(default_factory=list)
    nodes: int = 0

    def document(self, text: str) -> PositionedData:
        try:
            value = self._single(_Events(text))
        except _TooMuch as limit:
            mark: Any
            mark, fault, remedy = limit.args
            raise GraphError([*self.errors, self._message_at(mark, (), fault, remedy)]) from None
        except yaml.MarkedYAMLError as error:
            mark = error.problem_mark or error.context_mark
            began = error.context_mark
            opened = f" from line {began.line + 1}" if began is not None and began.line != mark.line else ""
            problem = " ".join(
                filter(None, (f"{error.context}{opened}" if error.context else "", error.problem))
            )
            raise GraphError(
                [*self.errors, self._message_at(mark, (), f"not YAML: {problem[:300]}")]
            ) from None
        if self.errors:
            raise GraphError(self.errors)
        return PositionedData(value, Positions(self.file, self.keys, self.values, self.texts))

    def _single(self, events: Any) -> Any:
        value = None
        count = 0
        while True:
            event = events.get_event()
            if isinstance(event, StreamEndEvent):
                break
            if isinstance(event, (StreamStartEvent, DocumentEndEvent)):
                continue
            if isinstance(event, DocumentStartEvent):
                count += 1
                if count > 1:
                    raise _TooMuch(event.start_mark, "a second document", "one document per file")
                continue
            value = self._value(events, event, (), 1)
        if count == 0 or value is None:
            self.values.setdefault((), (1, 1))
            self.errors.append(
                GraphMessage(
                    self.file,
                    1,
                    1,
                    (),
                    "graph",
                    "nothing in the file",
                    "a mapping that begins with bayesnet: 1",
                )
            )
        return value

    def _value(self, events: Any, event: Event, path: KeyPath, depth: int) -> Any:
        """The data of the node that `event` begins; consumes its events."""
        self._admit(event, path, depth)
        self.values[path] = _place(event)
        if isinstance(event, ScalarEvent):
            return self._scalar(event, path)
        if isinstance(event, MappingStartEvent):
            return self._mapping(events, path, depth)
        if isinstance(event, AliasEvent):
            return None
        items: list[Any] = []
        while not isinstance(event := events.get_event(), SequenceEndEvent):
            items.append(self._value(events, event, (*path, len(items)), depth + 1))
        return items

    def _mapping(self, events: Any, path: KeyPath, depth: int) -> dict[str, Any]:
        mapping: dict[str, Any] = {}
        while not isinstance(event := events.get_event(), MappingEndEvent):
            if not isinstance(event, ScalarEvent):
                self._admit(event, path, depth)
                self._refuse(event, path, "a key that is not a word", "words as keys")
                self._skip(events, event, path, depth + 1)
                self._value(events, events.get_event(), (*path, "?"), depth + 1)
                continue
            self._admit(event, path, depth)
            key = event.value
            key_path = (*path, key)
            if key == "<<" and event.implicit[0]:
                self._refuse(event, key_path, "a merge key", "every key written out")
            elif key in mapping:
                first, _ = self.keys[key_path]
                self._refuse(
                    event, key_path, f"key {shown_value(key)} again, first in line {first}", "every key once"
                )
            else:
                self.keys[key_path] = _place(event)
                mapping[key] = self._value(events, events.get_event(), key_path, depth + 1)
                continue
            self._skip(events, events.get_event(), key_path, depth + 1)
        return mapping

    def _skip(self, events: Any, event: Event, path: KeyPath, depth: int) -> None:
        """Consumes a node whose data is not wanted; the limits hold in it too."""
        positions = self.keys, self.values
        self.keys, self.values = {}, {}
        self._value(events, event, path, depth)
        self.keys, self.values = positions

    def _admit(self, event: Event, path: KeyPath, depth: int) -> None:
        """Counts a node; refuses tags, anchors and aliases; stops at the limits."""
        self.nodes += 1
        if self.nodes > MAX_NODES:
            raise _TooMuch(event.start_mark, f"more than {MAX_NODES} values", f"at most {MAX_NODES} values")
        if depth > MAX_DEPTH and not isinstance(event, (ScalarEvent, CollectionEndEvent)):
            raise _TooMuch(event.start_mark, *_TOO_DEEP)
        if len(self.errors) > MAX_MESSAGES:
            raise GraphError(self.errors)
        if isinstance(event, AliasEvent):
            self._refuse(event, path, f"alias *{shown_name(event.anchor)}", "every value written out")
        elif isinstance(event, NodeEvent) and event.anchor is not None:
            self._refuse(event, path, f"anchor &{shown_name(event.anchor)}", "values without anchors")
        tag = getattr(event, "tag", None)
        if tag is not None:
            self._refuse(event, path, f"tag {shown_name(tag)}", "values without tags")

    def _scalar(self, event: ScalarEvent, path: KeyPath) -> Any:
        text = event.value
        if len(text) > MAX_SCALAR:
            fault, remedy = f"a value of {len(text)} characters", f"at most {MAX_SCALAR} characters"
            self._refuse(event, path, fault, remedy)
            return None
        quotes = 0 if event.style is None else 1
        if _length(event) == len(text) + 2 * quotes:
            self.texts[path] = quotes
        if not event.implicit[0]:
            return text
        value = plain_scalar(text)
        if isinstance(value, int) and len(text.lstrip("+-0ox")) > MAX_DIGITS:
            self._refuse(event, path, f"a number of {len(text)} digits", f"at most {MAX_DIGITS} digits")
            return None
        return value

    def _refuse(self, event: Event, path: KeyPath, fault: str, remedy: str) -> None:
        self.errors.append(self._message_at(event.start_mark, path, fault, remedy))

    def _message_at(self, mark: Any, path: KeyPath, fault: str, remedy: str = "") -> GraphMessage:
        placed = Positions(self.file, {}, {path: (mark.line + 1, mark.column + 1)})
        return placed.message(path, fault, remedy)
