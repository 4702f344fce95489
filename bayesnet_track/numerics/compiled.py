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
    try:
        kernel: Kernel = numba.njit(cache=True, nogil=True, fastmath=False)(function)
    except RuntimeError:  # Numba found no folder that it may write
        kernel = numba.njit(cache=False, nogil=True, fastmath=False)(function)
    return kernel
