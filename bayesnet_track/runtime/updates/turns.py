"""Turns: a tracker changes in one thread at a time."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager


class Turns:
    """Lets one thread in at a time and refuses others.

    Waiting would give a result, too, but one that depends on which thread came first: the order of frames
    decides what a tracker finds.

    >>> turns = Turns("Tracker")
    >>> with turns.take("update"):
    ...     pass
    """

    def __init__(self, kind: str) -> None:
        self._kind, self._lock = kind, threading.Lock()
        self._at_work = ("", "")

    @contextmanager
    def take(self, call: str) -> Iterator[None]:
        """A turn for a call.

        Raises:
            RuntimeError: another thread, or an outer call of this one, has its turn; names both.
        """
        thread = threading.current_thread().name
        if not self._lock.acquire(blocking=False):
            other, since = self._at_work
            raise RuntimeError(
                f"{call} in thread {thread!r} while thread {other!r} is in {since} of the same {self._kind}: "
                "its frames must come in order; call it from one thread, or hold a lock around each call; a "
                f"{self._kind} of its own for each video can run in each thread"
            )
        try:
            self._at_work = (thread, call)
            yield
        finally:
            self._lock.release()
