"""Where worker processes come from: a process that has imported what cues need, and forks them off."""

from __future__ import annotations

import os
import select
import socket
import struct
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from threading import Lock
from types import MappingProxyType
from typing import IO

from bayesnet_track.inference.executor import AgentUnavailable
from bayesnet_track.observation.child import cut, python, tie
from bayesnet_track.observation.cue_files import pack

MODULE = "bayesnet_track.runtime.executors.worker"

WORKER = b"w"
END = b"e"
NUMBER = struct.Struct("=q")
READY, UNKNOWN = -(1 << 40), -(1 << 41)
"""What it says when it has imported everything, and of the exit code of a process that it does not know."""
END_S = 0.5
"""Seconds in which a worker that is let go has ended; then it is killed."""
ONE_THREAD: Mapping[str, str] = MappingProxyType(
    dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
)
START_S = 60.0
"""Seconds in which the fork server has imported everything, on the slowest machine."""
LOOK_S = 0.25
"""Seconds after which it is looked whether a fork server that does not answer is stopped."""


class ForkServer:
    """The engine's side. For several threads.

    A process that the engine forked itself would hold whatever locks its threads held then; one that starts
    anew takes a second.
    """

    def __init__(self, frames: int, memory_mb: int, answer_s: float) -> None:
        """Start it; it becomes ready while the engine goes on.

        Args:
            frames: descriptor of the frames' memory.
            memory_mb: what a worker may take above what it starts with; 0 for no limit.
            answer_s: seconds for which a fork server that hangs, or is stopped, is waited for.
        """
        self._frames, self._memory_mb = frames, memory_mb
        self._patience_s = answer_s + 2 * END_S  # it may wait END_S for a worker's end itself
        self._lock = Lock()
        self._is_closed = False
        self._start()

    def worker(self) -> tuple[socket.socket, int, int]:
        """A new worker: the channel to it, its lifeline (it dies when that is closed) and its process id.

        Raises:
            AgentUnavailable: the run is over.
            OSError: none can be started.
        """
        ours, theirs = socket.socketpair()
        try:
            held, lifeline = tie()
        except OSError:
            ours.close()
            theirs.close()
            raise
        pid = None
        try:
            with self._lock:
                pid = self._ask(WORKER, (theirs.fileno(), held))
                if pid is None and not self._is_closed:
                    self._end()
                    self._start()
                    pid = self._ask(WORKER, (theirs.fileno(), held))
        finally:
            theirs.close()
            cut(held)
            if pid is None:
                ours.close()
                cut(lifeline)
        if pid is None:
            if self._is_closed:
                raise AgentUnavailable("the run is over")
            raise OSError("the process that forks them off has ended twice")
        return ours, lifeline, pid

    def ended(self, pid: int) -> int | None:
        """The exit code of a worker that was let go or has died, minus the signal that killed it.

        It is killed if need be; None when nobody knows.
        """
        with self._lock:
            code = self._ask(END + NUMBER.pack(pid), ())
        return None if code == UNKNOWN else code

    def close(self) -> None:
        """End it, and the workers that are left."""
        self._is_closed = True
        with suppress(OSError):  # wakes a thread that waits for a worker
            self._control.shutdown(socket.SHUT_RDWR)
        with self._lock:
            self._end()

    def _start(self) -> None:
        self._control, theirs = socket.socketpair()
        self._is_ready = False
        held, self._lifeline = tie()
        numbers = (theirs.fileno(), self._frames, self._memory_mb)
        try:
            with _cue_files() as files:
                self._process = subprocess.Popen(
                    python(f"from {MODULE} import main; main{numbers}", held=held),
                    stdin=files,
                    pass_fds=(*numbers[:2], held),
                    env={**os.environ, **ONE_THREAD},
                    # Ctrl-C in a terminal reaches the engine only, which then ends its workers.
                    start_new_session=True,
                )
        finally:
            theirs.close()
            cut(held)

    def _ask(self, request: bytes, files: tuple[int, ...]) -> int | None:
        """Its answer to a request; None when it has ended, and when it hangs, for which it is killed."""
        try:
            if not self._is_ready:
                self._receive()
                self._is_ready = True
            socket.send_fds(self._control, [request], files)
            return self._receive()
        except (OSError, ValueError):  # ValueError: closed here
            return None

    def _receive(self) -> int:
        """The next number that it sends; raises OSError."""
        began = time.monotonic()
        poll = select.poll()
        poll.register(self._control, select.POLLIN)
        # While it imports, it is waited for longer, unless it is stopped and imports nothing.
        while not poll.poll(1e3 * LOOK_S):
            waited = time.monotonic() - began
            if waited > START_S or (waited > self._patience_s and (self._is_ready or self._is_stopped())):
                self._process.kill()
                raise TimeoutError
        reply = self._control.recv(NUMBER.size)
        if not reply:
            raise ConnectionError
        number: int = NUMBER.unpack(reply)[0]
        return number

    def _is_stopped(self) -> bool:
        if not hasattr(os, "waitid"):
            return False
        stopped = os.WSTOPPED | os.WNOHANG | os.WNOWAIT
        with suppress(ChildProcessError):
            return os.waitid(os.P_PID, self._process.pid, stopped) is not None
        return False

    def _end(self) -> None:
        self._control.close()
        if self._is_stopped():
            self._process.kill()
        try:
            self._process.wait(2 * END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        lifeline, self._lifeline = self._lifeline, -1
        cut(lifeline)


@contextmanager
def _cue_files() -> Iterator[int | IO[bytes]]:
    """What the fork server reads the engine's cue files from."""
    content = pack()
    if not content:
        yield subprocess.DEVNULL
        return
    with tempfile.TemporaryFile() as file:
        file.write(content)
        file.seek(0)
        yield file
