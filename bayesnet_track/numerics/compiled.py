"""Compile a kernel with Numba, cached on disk where a folder for it can be written."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def compiled(function: Kernel) -> Kernel:
    """`function` compiled in no-Python mode, serial, releasing the interpreter lock.

    A read-only installation without a writable cache folder compiles in memory instead of failing.
    """
    return _compiled(function, False)


def compiled_summing(function: Kernel) -> Kernel:
    """As `compiled`, with leave to add up in another order: sums of floats may use vector instructions.

    The order is fixed when it is compiled, so that results are the same bits on the same type of machine.
    Nothing else is relaxed: NaN and infinities keep their meaning.
    """
    return _compiled(function, {"reassoc", "contract", "nsz"})


def _compiled(function: Kernel, relaxed: bool | set[str]) -> Kernel:
    try:
        kernel: Kernel = numba.njit(cache=True, nogil=True, fastmath=relaxed)(function)
    except RuntimeError:  # Numba found no folder that it may write
        kernel = numba.njit(cache=False, nogil=True, fastmath=relaxed)(function)
    return kernel
