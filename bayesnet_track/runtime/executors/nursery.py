"""Where worker processes come from: a process that has imported what cues need, and forks them off."""

from __future__ import annotations

import os
import socket
import struct
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from threading import Lock
from types import MappingProxyType

from bayesnet_track.executor import AgentUnavailable

WORKER = b"w"
END = b"e"
NUMBER = struct.Struct("=q")
END_S = 0.5
"""Seconds in which a worker that is let go has ended; then it is killed."""
ONE_THREAD: Mapping[str, str] = MappingProxyType(
    dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
)
START_S = 60.0
"""Seconds in which the nursery has imported everything, on the slowest machine."""


class Nursery:
    """The engine's side. For several threads.

    A process that the engine forked itself would hold whatever locks its threads held then; one that starts
    anew takes a second.
    """

    def __init__(self, frames: int, memory_mb: int) -> None:
        """Start it; it becomes ready while the engine goes on. `frames` is the descriptor of their memory."""
        self._frames, self._memory_mb = frames, memory_mb
        self._lock = Lock()
        self._is_closed = False
        self._start()

    def worker(self) -> tuple[socket.socket, int, int]:
        """A new worker: the channel to it, its lifeline (it dies when that is closed) and its process id.

        Raises:
            AgentUnavailable: none can be started.
        """
        ours, theirs = socket.socketpair()
        held, lifeline = os.pipe()
        try:
            with self._lock:
                pid = self._told(WORKER, (theirs.fileno(), held))
                if pid is None and not self._is_closed:
                    self._end()
                    self._start()
                    pid = self._told(WORKER, (theirs.fileno(), held))
        finally:
            theirs.close()
            os.close(held)
        if pid is None:
            ours.close()
            os.close(lifeline)
            raise AgentUnavailable("no worker process can be started")
        return ours, lifeline, pid

    def ended(self, pid: int) -> int | None:
        """The exit code of a worker that was let go or has died, minus the signal that killed it.

        It is killed if need be; None when nobody knows.
        """
        with self._lock:
            return self._told(END + NUMBER.pack(pid), ())

    def close(self) -> None:
        """End it, and the workers that are left."""
        self._is_closed = True
        with suppress(OSError):  # wakes a thread that waits for a worker
            self._control.shutdown(socket.SHUT_RDWR)
        with self._lock:
            self._end()

    def _start(self) -> None:
        self._control, theirs = socket.socketpair()
        self._control.settimeout(START_S)
        numbers = (theirs.fileno(), self._frames, self._memory_mb)
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "bayesnet_track.runtime.executors.worker", *map(str, numbers)],
                stdin=subprocess.DEVNULL,
                pass_fds=numbers[:2],
                env={**os.environ, **ONE_THREAD, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
                # Ctrl-C in a terminal reaches the engine only, which then ends its workers.
                start_new_session=True,
            )
        finally:
            theirs.close()

    def _told(self, request: bytes, files: tuple[int, ...]) -> int | None:
        try:
            socket.send_fds(self._control, [request], files)
            reply = self._control.recv(NUMBER.size)
        except OSError:
            return None
        return NUMBER.unpack(reply)[0] if reply else None

    def _end(self) -> None:
        self._control.close()
        try:
            self._process.wait(2 * END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
