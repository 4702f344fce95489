"""A graph error as a terminal shows it: each message with its line of the file, a caret, and a hint."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from bayesnet_track.graph.text.document import MAX_BYTES
from bayesnet_track.graph.text.hints import hint_of
from bayesnet_track.graph.text.messages import GraphError, GraphMessage

MOST_SHOWN = 10
"""Errors that are shown at once."""
WIDTH = 100
"""Columns of a line that are shown."""


def describe_error(error: GraphError) -> str:
    """The messages of an error, each with what stands in the file at its place, where that can be read."""
    texts = {message.file: _lines(message.file) for message in error.errors}
    parts = [part for message in error.errors[:MOST_SHOWN] for part in _describe(message, texts)]
    left = len(error.errors) - MOST_SHOWN
    if error.more or left > 0:
        how_many = "more errors" if error.more else f"{left} more"
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
    shown = line.replace("\t", " ")[begin : begin + WIDTH]
    head = f"  {number} | "
    return [f"{head}{shown}".rstrip(), f"{' ' * (len(head) - 2)}| {' ' * (column - 1 - begin)}^"]


def _lines(file: str) -> list[str]:
    """Of a file that can be read; none of any other, such as an installed graph."""
    path = Path(file)
    try:
        if not path.is_file() or path.stat().st_size > MAX_BYTES:
            return []
        return path.read_text(encoding="utf-8", errors="replace").removeprefix("\ufeff").splitlines()
    except (OSError, ValueError):
        return []
