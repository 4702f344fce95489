"""How long kernels were compiled in this process, and who is told that it begins.

A kernel is compiled when it is called with types for which there is nothing in the cache on disk: all of them
at the first run on a machine, none later. Numba compiles under one lock, so that spans never overlap; those
of kernels that another one calls lie within its own.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager

Listener = Callable[[], object]


class CacheWarning(UserWarning):
    """A file of compiled kernels that is damaged: the kernel is compiled anew, and the file replaced."""


class _OfThread(threading.local):
    seconds = 0.0  # of the class: to ask for what an object lacks takes five times as long


class CompileWatch:
    """Adds up the spans in which something was compiled.

    Attributes:
        seconds: of all spans that are over.
        of_thread: `seconds` of those that are over in the calling thread.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self.seconds = 0.0
        self._clock = clock
        self._open: list[tuple[Hashable, float]] = []
        self.of_thread = _OfThread()
        self._listeners: list[Listener] = []

    def begins(self, kernel: Hashable) -> None:
        """A kernel was not in the cache, and is compiled now."""
        self._open.append((kernel, self._clock()))
        for listener in self._listeners:
            listener()

    def ends(self, kernel: Hashable) -> None:
        """It is compiled; those that failed within it are forgotten."""
        while self._open:
            innermost, began = self._open.pop()
            if innermost == kernel:
                if not self._open:
                    spent = self._clock() - began
                    self.seconds += spent
                    self.of_thread.seconds += spent
                return

    @property
    def seconds_here(self) -> float:
        """Of the spans that are over in the calling thread."""
        return self.of_thread.seconds

    @contextmanager
    def notifying(self, listener: Listener) -> Iterator[None]:
        """Inside it `listener` is called whenever a kernel begins to be compiled, in whatever thread."""
        self._listeners.append(listener)
        try:
            yield
        finally:
            self._listeners.remove(listener)


WATCH = CompileWatch()
"""That of this process."""


def working_clock() -> float:
    """Seconds that the calling thread did not compile, of any origin: what an agent's work is timed by."""
    return time.perf_counter() - WATCH.of_thread.seconds  # asked ten times a target
