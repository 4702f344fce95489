"""Calls that are made in the background, in order: a frame does not wait for the disk or the encoder."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from queue import Queue
from threading import Thread
from typing import Any

Call = tuple[Future[None], Callable[..., None], tuple[Any, ...]]


class Background:
    """Makes calls one after the other on a thread of its own, which starts with the first one.

    Unlike that of a `ThreadPoolExecutor` it works until a program has called everything that it left for its
    end. Where no thread can start any more, calls are made at once, by the caller.

    Args:
        name: of the thread.
        most: calls that may wait; with more, the caller waits.

    >>> seen = []
    >>> background = Background("example")
    >>> background.submit(seen.append, 1).result()
    >>> background.submit(seen.append, 2)  # doctest: +ELLIPSIS
    <Future at ...>
    >>> background.shutdown()
    >>> seen
    [1, 2]
    """

    def __init__(self, name: str, most: int = 1) -> None:
        self._name, self._most = name, most
        self._calls: Queue[Call | None] = Queue(most)
        self._thread: Thread | None = None

    def submit(self, call: Callable[..., None], *arguments: Any) -> Future[None]:
        """Have a call made; what it raises is raised by the `result` of what is returned."""
        made: Future[None] = Future()
        if self._is_at_work():
            self._calls.put((made, call, arguments))
        else:
            _make(made, call, arguments)
        return made

    def shutdown(self) -> None:
        """Wait until every call is made; safe to call twice."""
        thread, self._thread = self._thread, None
        if thread is not None and thread.is_alive():
            self._calls.put(None)
            thread.join()

    def _is_at_work(self) -> bool:
        """True if there is a thread, which is started where there is none; a forked process has none."""
        if self._thread is None or not self._thread.is_alive():
            self._calls = Queue(self._most)
            thread = Thread(target=_work, args=(self._calls,), name=self._name, daemon=True)
            try:
                thread.start()
            except RuntimeError:  # the interpreter ends, or the system has no more threads
                return False
            self._thread = thread
        return True


def _work(calls: Queue[Call | None]) -> None:
    while (item := calls.get()) is not None:
        _make(*item)
        del item  # the arguments of the last call may be large


def _make(made: Future[None], call: Callable[..., None], arguments: tuple[Any, ...]) -> None:
    try:
        call(*arguments)
    except BaseException as error:
        made.set_exception(error)
        if not isinstance(error, Exception):
            raise
    else:
        made.set_result(None)
