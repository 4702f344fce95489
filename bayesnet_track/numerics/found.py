"""Values that are found when the first of them is asked for: what nobody reads costs nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TypeVar

Value = TypeVar("Value")


class Found(Mapping[str, Value]):
    """Name -> a value, found for all of `names` by `find` when the first is asked for.

    >>> lengths = Found(["a", "bc"], lambda: {name: len(name) for name in ("a", "bc")})
    >>> list(lengths), lengths["bc"], lengths == {"a": 1, "bc": 2}
    (['a', 'bc'], 2, True)
    """

    def __init__(self, names: Iterable[str], find: Callable[[], Mapping[str, Value]]) -> None:
        self._names = tuple(names)
        self._find: Callable[[], Mapping[str, Value]] | None = find
        self._found: Mapping[str, Value] = {}

    def __getitem__(self, name: str) -> Value:
        if self._find is not None:
            self._found, self._find = self._find(), None  # what it was found from is not needed any more
        return self._found[name]

    def __contains__(self, name: object) -> bool:
        return name in self._names

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __reduce__(self) -> tuple[type[dict[str, Value]], tuple[dict[str, Value]]]:
        return dict, (dict(self),)
