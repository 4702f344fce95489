"""Lines of a commented YAML file: each key with what it does and when to change it above it."""

from __future__ import annotations

from collections.abc import Iterable
from textwrap import wrap

WIDTH = 100

Lines = tuple[str, ...]


def key(text: str, comment: str, inside: Iterable[str] = ()) -> Lines:
    """A key with its comment above it, and the lines inside it, indented."""
    return (*remark(comment), text, *indent(inside))


def remark(comment: str) -> Lines:
    """A comment, broken into lines."""
    return tuple(f"# {line}" for line in wrap(comment, WIDTH - 12))


def indent(lines: Iterable[str]) -> Lines:
    """The lines, two spaces further in."""
    return tuple(f"  {line}" if line else line for line in lines)
