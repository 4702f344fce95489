"""Stop between two frames when a signal arrives, so that every file ends with a whole line."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Any, Self

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Terminated(KeyboardInterrupt):
    """SIGTERM arrived: wind up as for Ctrl-C, with another exit code."""


class StopRequest:
    """While entered, SIGINT and SIGTERM are noted instead of acted on; the second one acts at once.

    Outside the main thread, where Python handles no signals, it notes none.

    Attributes:
        signal: number of the signal that arrived, or None.
        is_patient: while False, the first one acts at once, too.
    """

    def __init__(self, is_patient: bool = True) -> None:
        self.signal: int | None = None
        self.is_patient = is_patient
        self._before: dict[int, Any] = {}

    @property
    def exit_code(self) -> int:
        """128 + the signal, as shells have it; 0 when none arrived."""
        return 0 if self.signal is None else 128 + self.signal

    def __enter__(self) -> Self:
        self._before = _handle(SIGNALS, self._note)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._restore()

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.signal = number
        self._restore()
        if not self.is_patient:
            signal.raise_signal(number)

    def _restore(self) -> None:
        before, self._before = self._before, {}
        _put_back(before)


@contextmanager
def terminable() -> Iterator[None]:
    """Inside it SIGTERM raises `Terminated`."""
    before = _handle((signal.SIGTERM,), _terminate)
    try:
        yield
    finally:
        _put_back(before)


def _terminate(number: int, frame: FrameType | None) -> None:
    raise Terminated


def _handle(numbers: Iterable[int], handler: Callable[[int, FrameType | None], None]) -> dict[int, Any]:
    """Set `handler`; the handlers that it replaced.

    An ignored signal stays ignored, as a shell wants it of what runs in the background, and a handler that
    was not set by Python is left alone, since it could not be put back.
    """
    if threading.current_thread() is not threading.main_thread():
        return {}
    before = {number: signal.getsignal(number) for number in numbers}
    replaced = {n: old for n, old in before.items() if old is not None and old is not signal.SIG_IGN}
    for number in replaced:
        signal.signal(number, handler)
    return replaced


def _put_back(before: dict[int, Any]) -> None:
    for number, handler in before.items():
        signal.signal(number, handler)
