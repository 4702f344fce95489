"""In which values two graphs differ, as paths."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import yaml

from bayesnet_track.graph.text.write import flow_text


@dataclass(frozen=True)
class Difference:
    """One value that two graphs do not share.

    Attributes:
        path: keys from the top to the value, joined by dots.
        first: its text in the first graph; empty when it is not written there.
        second: its text in the second graph.
    """

    path: str
    first: str
    second: str

    def __str__(self) -> str:
        """``path: first → second``."""
        return f"{self.path}: {self.first or 'not written'} → {self.second or 'not written'}"


def differences(first: str, second: str) -> tuple[Difference, ...]:
    """The values that two canonical graph texts do not share, in the order of the first.

    >>> for one in differences("a: {b: 1, c: x}\\n", "a: {b: 2, d: {e: 3}}\\n"):
    ...     print(one)
    a.b: 1 → 2
    a.c: x → not written
    a.d: not written → {e: 3}
    >>> print(*differences("a: {b: 1}\\n", "a: {b: 1, c: {}}\\n"))
    a.c: not written → {}, all at their defaults
    """
    return tuple(_between(yaml.safe_load(first), yaml.safe_load(second), ""))


def _between(first: Any, second: Any, path: str) -> Iterator[Difference]:
    if isinstance(first, Mapping) and isinstance(second, Mapping):
        for key in dict.fromkeys([*first, *second]):
            below = f"{path}.{key}" if path else str(key)
            if key in first and key in second:
                yield from _between(first[key], second[key], below)
            else:
                yield Difference(below, _text(first, key), _text(second, key))
    elif first != second:
        yield Difference(path, flow_text(first), flow_text(second))


def _text(mapping: Mapping[Any, Any], key: Any) -> str:
    if key not in mapping:
        return ""
    # Canonical text leaves out what has its default value: of {share: 0.1} nothing may remain.
    return flow_text(mapping[key]) if mapping[key] != {} else "{}, all at their defaults"
