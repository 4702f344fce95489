"""Compile a kernel with Numba, cached on disk where a folder for it can be written."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.compile_watch import WATCH
from bayesnet_track.numerics.kernel_sources import fingerprint

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def compiled(function: Kernel) -> Kernel:
    """`function` compiled in no-Python mode, serial, releasing the interpreter lock.

    Where the cache on disk cannot be written (read-only, full) or read (damaged), it compiles in memory. It
    is compiled anew when something that it refers to has changed, in this file or in another. A division by
    zero is infinite or NaN, of whole numbers 0; none raises.
    """
    return _compiled(function, False)


def compiled_summing(function: Kernel) -> Kernel:
    """As `compiled`, with leave to add up in another order: sums of floats may use vector instructions.

    The order is fixed when it is compiled, so that results are the same bits on the same type of machine.
    Nothing else is relaxed: NaN and infinities keep their meaning.
    """
    return _compiled(function, {"reassoc", "contract", "nsz"})


def compiled_fusing(function: Kernel) -> Kernel:
    """As `compiled`, with leave to round a product and a sum once instead of twice."""
    return _compiled(function, {"contract"})


def plain(array: NDArray[np.float64]) -> NDArray[np.float64]:
    """`array` as float64, writable and in C order, so that a kernel has one compiled version only."""
    if array.dtype.char == "d" and array.flags.carray:
        return array
    return np.array(array, np.float64, order="C")


def _compiled(function: Kernel, relaxed: bool | set[str]) -> Kernel:
    if numba.config.DISABLE_JIT:  # NUMBA_DISABLE_JIT=1, to debug a kernel: it stays plain Python
        return function
    # A kernel that another one calls exists twice, alone and within the caller, and sums of the two may be
    # ordered differently. Which of them is called depends on what came from the cache, unless it is inlined.
    settings: dict[str, Any] = {
        "nogil": True,
        "fastmath": relaxed,
        "forceinline": True,
        "error_model": "numpy",  # a division that may raise keeps its loop from vector instructions
    }
    try:
        kernel: Any = numba.njit(cache=True, **settings)(function)
    except RuntimeError:  # Numba found no folder that it may write
        kernel = numba.njit(cache=False, **settings)(function)
    # Numba itself lets a full disk or a damaged file end the call that only wanted the kernel.
    cache = kernel._cache
    load, save = _at_best(cache.load_overload), _at_best(cache.save_overload)

    def load_or_begin(*arguments: Any) -> Any:
        found = load(*arguments)
        if found is None:
            WATCH.begins(function)
        return found

    def save_at_the_end(*arguments: Any) -> Any:
        WATCH.ends(function)
        return save(*arguments)

    cache.load_overload, cache.save_overload = load_or_begin, save_at_the_end
    if hasattr(cache, "_index_key"):  # there is a folder for it
        key_of = cache._index_key
        cache._index_key = lambda *arguments: (*key_of(*arguments), fingerprint(kernel))
    compiled_kernel: Kernel = kernel
    return compiled_kernel


def _at_best(use: Callable[..., Any]) -> Callable[..., Any]:
    """`use` of a cache, with None for what cannot be used."""

    def tried(*arguments: Any) -> Any:
        try:
            return use(*arguments)
        except Exception:
            return None

    return tried
