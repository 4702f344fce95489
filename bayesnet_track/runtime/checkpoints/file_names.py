"""Names of files that are no UTF-8, in what is stored as text."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any

BYTES_AT = 0x10FF00
"""Private characters for bytes in names of files (PEP 383), which pydantic takes for no text."""


def hide_bytes(text: str) -> str:
    """The text with private characters for bytes that are no text."""
    return "".join(chr(BYTES_AT + ord(c) - 0xDC00) if "\udc80" <= c <= "\udcff" else c for c in text)


def restore_bytes(text: str) -> str:
    """The text with its bytes again: the inverse of `hide_bytes`."""
    first, last = chr(BYTES_AT + 0x80), chr(BYTES_AT + 0xFF)
    return "".join(chr(ord(c) - BYTES_AT + 0xDC00) if first <= c <= last else c for c in text)


def change_texts(value: Any, change: Callable[[str], str]) -> Any:
    """The value with every text in it changed."""
    if isinstance(value, str):
        return change(value)
    if isinstance(value, Mapping):
        return {key: change_texts(item, change) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(change_texts(item, change) for item in value)
    if is_dataclass(value) and not isinstance(value, type):
        own = {item.name: change_texts(getattr(value, item.name), change) for item in fields(value)}
        return replace(value, **own)
    return value
