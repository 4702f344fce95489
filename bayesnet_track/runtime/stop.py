"""The process of a run: what its system lacks, and requests that stop it between two frames.

Found by what is there, not by the system's name. Nothing heavy is imported: `doctor` asks, too.
"""

from __future__ import annotations

import atexit
import os
import platform
import signal
import socket
import sys
import threading
from collections.abc import Callable, Generator, Iterator
from contextlib import suppress
from functools import wraps
from importlib.util import find_spec
from queue import Empty, SimpleQueue
from types import FrameType, TracebackType
from typing import Any, ParamSpec, Self, TypeVar
from weakref import WeakSet

from bayesnet_track.observation.settings import setting, to_caller

SIGNALS = (signal.SIGINT, signal.SIGTERM)

REPEAT_S = 0.1
"""Seconds after which what was raised, and came to nothing, is raised again."""

PATIENCE_S = 1.0
"""Seconds that a frame may take to end: what takes longer compiles kernels, or has an agent that hangs."""

LEFT = b"\0"
"""What is sent in place of a signal when the request is left."""


class Terminated(KeyboardInterrupt):
    """SIGTERM arrived: wind up as for Ctrl-C, with another exit code."""


class StopRequest:
    """While entered, SIGINT raises `KeyboardInterrupt` and SIGTERM `Terminated`, wherever the program is.

    Python gives up what is raised in a callback from C, in a finalizer and wherever C code clears errors. So
    it is raised again and again, without a traceback of each that was given up, until the request is left;
    never while one of them passes through, which would cut short the closing of files.

    Python runs a handler between two of its own instructions: a signal that arrives just before a call that
    waits, or in another thread, is seen when that call ends. So a thread of its own is told of each signal
    by the system, and sends it again until the handler has run.

    Outside the main thread, where Python handles no signals, nothing changes.

    Attributes:
        signal: number of the last signal that arrived, or None.
        is_patient: while True, the first signal is noted for `between_frames`, and raised only when
            `PATIENCE_S` have passed; a further one is raised at once.
    """

    def __init__(self) -> None:
        self.signal: int | None = None
        self.is_patient = False
        self._before: dict[int, Any] = {}
        self._is_repeat = False
        self._is_heard = False
        self._is_over = False
        self._has_raised = False
        self._pending: SimpleQueue[tuple[int, float] | None] = SimpleQueue()
        self._repeater = threading.Thread(target=self._repeat, name="stop", daemon=True)

    @property
    def exit_code(self) -> int:
        """128 + the signal, as shells have it; 0 when none arrived."""
        return 0 if self.signal is None else 128 + self.signal

    def between_frames(self) -> bool:
        """True if to stop here; nothing is then raised again. If not, the next signal waits for a frame."""
        self.is_patient = True
        self._is_heard = self.signal is not None
        return self._is_heard

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            self._hooks = sys.unraisablehook, sys.excepthook
            self._arrivals, self._arrived = socket.socketpair()
            self._arrived.setblocking(False)
            self._wakeup_fd = signal.set_wakeup_fd(self._arrived.fileno(), warn_on_full_buffer=False)
            self._repeater.start()
            try:
                sys.unraisablehook, sys.excepthook = self._given_up, self._printed
                self._handle()
            except KeyboardInterrupt:
                self._leave()
                raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if isinstance(error, KeyboardInterrupt):
            _let_go(error)
        if self._repeater.is_alive():
            self._leave()

    def _handle(self) -> None:
        for number in SIGNALS:
            handler = signal.getsignal(number)
            # An ignored signal stays ignored, as a shell wants it of what runs in the background, and a
            # handler that was not set by Python is left alone, since it could not be put back.
            if handler is not None and handler is not signal.SIG_IGN:
                self._before[number] = handler
                signal.signal(number, self._act)

    def _leave(self) -> None:
        self._is_over = True
        self._pending.put(None)
        with suppress(BlockingIOError):  # full of signals, each of which says as much
            self._arrived.send(LEFT)
        # Once it has ended, no repetition can reach the handlers that are put back.
        self._repeater.join()
        signal.set_wakeup_fd(self._wakeup_fd)
        self._arrivals.close()
        self._arrived.close()
        sys.unraisablehook, sys.excepthook = self._hooks
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _act(self, number: int, frame: FrameType | None) -> None:
        is_repeat, self._is_repeat = self._is_repeat, False
        is_noted = self.is_patient and self.signal is None
        self.signal = number
        if self._is_over or (is_repeat and (self._is_heard or _is_passing())):
            return
        # A queue of this kind may be used in a handler, unlike locks.
        self._pending.put((number, PATIENCE_S if is_noted else REPEAT_S))
        if not is_noted:
            self._has_raised = True
            raise Terminated if number == signal.SIGTERM else KeyboardInterrupt

    def _repeat(self) -> None:
        pending: tuple[int, float] | None = (self._wait_for_signal(), REPEAT_S)
        while pending is not None:
            number, seconds = pending
            try:
                pending = self._pending.get(timeout=seconds)
            except Empty:
                self._is_repeat = self.signal is not None
                _send(number)
                pending = number, REPEAT_S

    def _wait_for_signal(self) -> int:
        while (number := self._arrivals.recv(1)[0]) not in (*self._before, *LEFT):
            pass  # a signal that others handle
        return number

    def _given_up(self, error: sys.UnraisableHookArgs) -> None:
        """Once interrupted, other errors are silent, too: what is left half made complains when it goes."""
        if not self._has_raised:
            self._hooks[0](error)

    def _printed(self, kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        """C code prints so what it gives up (that of NumPy's `import_array` does)."""
        if self.signal is None or not issubclass(kind, KeyboardInterrupt):
            self._hooks[1](kind, error, trace)


def _let_go(error: BaseException | None) -> None:
    """Drop what the frames that an interruption left hold, so that all of it goes before the hooks do."""
    while error is not None:
        trace = error.__traceback__
        while trace is not None:
            with suppress(RuntimeError):  # a frame that still runs
                trace.tb_frame.clear()
            trace = trace.tb_next
        error = error.__context__


def _is_passing() -> bool:
    """True if an interruption is on its way out: an `except`, a `finally` or an `__exit__` is running."""
    error = sys.exception()
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__context__
    return False


def _send(number: int) -> None:
    """Let a signal reach the main thread; where the system can, out of a call that waits."""
    main = threading.main_thread().ident
    if sys.platform == "win32" or main is None:
        signal.raise_signal(number)
    else:
        signal.pthread_kill(main, number)


P = ParamSpec("P")
Item = TypeVar("Item")

OPEN: WeakSet[Generator[Any, None, None]] = WeakSet()


def closed_at_exit(
    make: Callable[P, Generator[Item, None, None]],
) -> Callable[P, Generator[Item, None, None]]:
    """A generator function whose generators are closed when the program ends before they do."""

    @wraps(make)
    def remembered(*args: P.args, **kwargs: P.kwargs) -> Generator[Item, None, None]:
        results = make(*args, **kwargs)
        OPEN.add(results)
        return results

    return remembered


@atexit.register
def close_all() -> None:
    """Close every generator that is left, but for one that a thread is in."""
    for results in list(OPEN):
        with suppress(ValueError):
            results.close()


TESTED = ("Linux", "x86_64")


def has_workers() -> bool:
    """True if agents can be in processes of their own: forked, with descriptors handed over a socket."""
    return hasattr(os, "fork") and hasattr(socket, "send_fds")


def no_workers() -> str:
    """The reason why there are no worker processes, and what to do."""
    serial = setting("--executor", "serial", "'serial'")
    place = to_caller("no --place AGENT=process", "no agent in places= a process")
    return f"this system cannot start worker processes (it has no fork); take {serial}, and {place}"


def lacking() -> Iterator[str]:
    """Missing parts of the operating system, and what that means, one clause each."""
    if not has_workers():
        yield f"no worker processes ({setting('--executor', 'processes', repr('processes'))})"
    if sys.platform == "darwin":
        yield f"no limit on memory ({to_caller('--agent-memory', 'Limits.memory_mb')} limits nothing)"
    if find_spec("fcntl") is None and find_spec("msvcrt") is None:
        yield "no lock on files (two runs may write one folder)"
    if sys.platform == "win32":
        yield "no SIGTERM (a run that is ended from outside closes no file; `resume` goes on from there)"
    if os.name != "posix":
        yield "no sync of folders (a power cut may lose the newest files)"


def describe_missing() -> str:
    """One sentence for who begins a run here; empty on the system that is tested."""
    machine = (platform.system(), platform.machine())
    missing = ", ".join(lacking())
    if machine == TESTED and not missing:
        return ""
    name = " ".join(part for part in machine if part) or sys.platform
    return f"{name} is not tested ({' '.join(TESTED)} is); missing here: {missing or 'nothing that is known'}"
