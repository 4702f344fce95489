"""Runs that are open when a program ends: they are closed while the interpreter can still write files."""

from __future__ import annotations

import atexit
from collections.abc import Callable, Generator
from contextlib import suppress
from functools import wraps
from typing import Any, ParamSpec, TypeVar
from weakref import WeakSet

P = ParamSpec("P")
Item = TypeVar("Item")

OPEN: WeakSet[Generator[Any, None, None]] = WeakSet()


def closed_at_exit(
    make: Callable[P, Generator[Item, None, None]],
) -> Callable[P, Generator[Item, None, None]]:
    """A generator function whose generators are closed when the program ends before they do."""

    @wraps(make)
    def remembered(*args: P.args, **more: P.kwargs) -> Generator[Item, None, None]:
        results = make(*args, **more)
        OPEN.add(results)
        return results

    return remembered


@atexit.register
def close_all() -> None:
    """Close every generator that is left, but for one that a thread is in."""
    for results in list(OPEN):
        with suppress(ValueError):
            results.close()
