"""One thread inside each agent: libraries that start threads of their own get in each other's way."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

NAMES = ("scipy_openblas_{}64_", "scipy_openblas_{}", "openblas_{}64_", "openblas_{}")


@contextmanager
def one_thread_inside(opencv: bool) -> Iterator[None]:
    """While entered, NumPy's matrix products use one thread each, and so do, with `opencv`, its functions.

    The last bits of a matrix product depend on the number of its threads. Workers have one, and so the engine
    must, for the same bytes; none of OpenCV's functions that are used here depends on it.
    """
    import cv2

    blas = _blas()
    before = cv2.getNumThreads(), [get() for get, _ in blas]
    if opencv:
        cv2.setNumThreads(1)
    for _, set_threads in blas:
        set_threads(1)
    try:
        yield
    finally:
        if opencv:
            cv2.setNumThreads(before[0])
        for (_, set_threads), threads in zip(blas, before[1], strict=True):
            set_threads(threads)


@cache
def _blas() -> list[tuple[Any, Any]]:
    """What gets and sets the number of threads of each OpenBLAS in the wheels of NumPy and SciPy."""
    site = Path(np.__file__).parent.parent
    found = []
    for package in ("numpy", "scipy"):
        if package not in sys.modules:
            continue
        for file in sorted((site / f"{package}.libs").glob("*openblas*")):
            try:
                library = ctypes.CDLL(str(file))
            except OSError:
                continue
            for name in NAMES:
                get = getattr(library, name.format("get_num_threads"), None)
                set_threads = getattr(library, name.format("set_num_threads"), None)
                if get is not None and set_threads is not None:
                    found.append((get, set_threads))
                    break
    return found
