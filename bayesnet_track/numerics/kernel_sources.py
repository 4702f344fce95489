"""What a kernel is compiled from besides its own file: constants and kernels of other files, and settings.

They become part of the machine code. Numba's cache on disk knows the file of the kernel alone: without this a
kernel would be found there in its former form after a neighbour has changed.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

OF_LIBRARIES = frozenset({"math", "numba", "numpy"})
"""Modules whose contents change with their version only, which Numba looks at."""


def fingerprint(kernel: Any) -> str:
    """A digest of a kernel's code, its settings, and all that it refers to, in whatever files.

    Args:
        kernel: a dispatcher of Numba's, or a plain function.
    """
    return hashlib.sha256(repr(_describe(kernel, ())).encode()).hexdigest()


def _describe(value: Any, within: tuple[int, ...]) -> object:
    """Something whose `repr` differs whenever `value` would be compiled differently."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, bool | int | float | complex | str | bytes | np.generic | None):
        return type(value).__qualname__, repr(value)
    if isinstance(value, tuple | list):
        return type(value).__qualname__, [_describe(one, within) for one in value]
    if isinstance(value, set | frozenset):
        return sorted(repr(_describe(one, within)) for one in value)
    if isinstance(value, dict):
        return [(name, _describe(one, within)) for name, one in sorted(value.items())]
    function = getattr(value, "py_func", value)
    if not isinstance(function, FunctionType):
        return getattr(value, "__qualname__", type(value).__qualname__)
    if id(function) in within:  # it calls itself
        return function.__qualname__
    within = (*within, id(function))
    return (
        function.__qualname__,
        _code(function.__code__),
        [(name, _describe(one, within)) for name, one in _globals(function)],
        [_describe(cell.cell_contents, within) for cell in function.__closure__ or ()],
        _describe(getattr(value, "targetoptions", {}), within),
    )


def _code(code: CodeType) -> object:
    constants = [_code(one) if isinstance(one, CodeType) else repr(one) for one in code.co_consts]
    return code.co_code, code.co_names, constants


def _names(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for one in code.co_consts:
        if isinstance(one, CodeType):
            yield from _names(one)


def _globals(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """What a function finds by names, directly or in a module that it names."""
    names = sorted(set(_names(function.__code__)))
    for name in names:
        if name not in function.__globals__:
            continue
        value = function.__globals__[name]
        if not isinstance(value, ModuleType):
            yield name, value
        elif value.__name__.split(".")[0] not in OF_LIBRARIES:
            yield from (
                (f"{name}.{inner}", getattr(value, inner)) for inner in names if hasattr(value, inner)
            )
