"""Worker processes as the engine sees them: forked off by a server, asked, found dead or hanging, ended."""

from __future__ import annotations

import os
import select
import signal
import socket
import struct
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from threading import Lock
from types import MappingProxyType
from typing import IO, Any, Protocol

from bayesnet_track.inference.asking import AgentUnavailable
from bayesnet_track.observation.child import cut, python, tie
from bayesnet_track.observation.cue_files import pack_cue_files
from bayesnet_track.observation.settings import setting
from bayesnet_track.runtime.executors.messages import (
    CallOutcome,
    CueCall,
    Dismiss,
    Employ,
    EncodedReference,
    Sent,
    receive,
    send,
)

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
            tied, lifeline = tie()
        except OSError:
            ours.close()
            theirs.close()
            raise
        pid = None
        try:
            with self._lock:
                pid = self._ask(WORKER, (theirs.fileno(), tied))
                if pid is None and not self._is_closed:
                    self._end()
                    self._start()
                    pid = self._ask(WORKER, (theirs.fileno(), tied))
        finally:
            theirs.close()
            cut(tied)
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
        tied, self._lifeline = tie()
        numbers = (theirs.fileno(), self._frames, self._memory_mb)
        try:
            with _cue_files() as files:
                self._process = subprocess.Popen(
                    python(f"from {MODULE} import main; main{numbers}", descriptor=tied),
                    stdin=files,
                    pass_fds=(*numbers[:2], tied),
                    env={**os.environ, **ONE_THREAD},
                    # Ctrl-C in a terminal reaches the engine only, which then ends its workers.
                    start_new_session=True,
                )
        finally:
            theirs.close()
            cut(tied)

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
    """The file from which the fork server reads the engine's cue files."""
    content = pack_cue_files()
    if not content:
        yield subprocess.DEVNULL
        return
    with tempfile.TemporaryFile() as file:
        file.write(content)
        file.seek(0)
        yield file


class WorkerLost(Exception):
    """A worker died, was killed because it did not answer, or needed too much memory; says which."""


class PlacingError(ValueError):
    """An agent cannot be where it was put; says why."""


class NoWorkerError(BaseException):
    """No worker process can be started, for a reason of the system; says which.

    The net would go on without agents that nothing is wrong with, and other tracks would come of it. So this
    is no `Exception`: what handles the faults of agents lets it pass, and it ends the run.
    """

    def __init__(self, reason: str) -> None:
        fewer, serial = setting("--workers", "N"), setting("--executor", "serial", "'serial'")
        super().__init__(
            f"no worker process can be started ({reason}); raise the limits (`ulimit -n`, `ulimit -u`), give "
            f"fewer workers ({fewer}), or use {serial}, which gives the same results"
        )


class NoHostError(NoWorkerError):
    """A camera has no host on any other machine; says why."""

    def __init__(self, camera: str, reason: str) -> None:
        BaseException.__init__(self, f"no host of camera {camera} can be started: {reason}")


class WorkerGone(WorkerLost):
    """A worker that had answered died before it was asked this: nobody's question killed it."""


class Late(AgentUnavailable):
    """The answer did not come by the deadline; the worker still works on it."""


@dataclass(frozen=True)
class Limits:
    """Limits of a worker.

    Attributes:
        answer_s: seconds for an answer.
        first_s: seconds for the first answer of an agent to a kind of question, for which kernels may be
            compiled.
        memory_mb: above what it has when it is ready; 0 for no limit.
        allow_other_machine: whether a host may have another type of processor, or other versions, than the
            engine, which give other last digits.
    """

    answer_s: float = 10.0
    first_s: float = 30.0
    memory_mb: int = 0
    allow_other_machine: bool = False


class Launcher(Protocol):
    """Starts workers, and sees them off."""

    def ended(self, pid: int) -> int | None:
        """The exit code of a worker that has ended, or is ended now; None when nobody knows."""


class Worker:
    """One process with some agents, which is asked one question at a time. Not for several threads at a time.

    Attributes:
        pid: its process id, or the number of its actor.
        agents: those whose cues it has.
        channel: readable when its answer is there, or its end.
        busy_with: the agent whose question it works on, or whose answer has not been received; else None.
        until: the moment by which it has to answer.
    """

    def __init__(self, launcher: Launcher, process: tuple[socket.socket, int, int], limits: Limits) -> None:
        self._launcher = launcher
        self.channel, self._lifeline, self.pid = process
        # A worker that is stopped reads nothing, or has sent half an answer: neither is waited for for ever.
        patience = struct.pack("@ll", int(limits.answer_s), int(limits.answer_s % 1 * 1e6))
        for side in (socket.SO_SNDTIMEO, socket.SO_RCVTIMEO):
            self.channel.setsockopt(socket.SOL_SOCKET, side, patience)
        self._limits, self._patience_s, self.until = limits, 0.0, 0.0
        self._sent = Sent()
        self._known: set[tuple[str, str]] = set()
        self._asked = ("", "")
        self.agents: set[str] = set()
        self.busy_with: str | None = None

    @property
    def is_dead(self) -> bool:
        """True if its end of the channel is closed."""
        try:
            return self.channel.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT) == b""
        except BlockingIOError:
            return False
        except OSError:
            return True

    def assign(self, agent: str, make: Any, parameters: Any) -> None:
        """Have it make the cue of an agent."""
        self._send(Employ(agent, make, parameters))
        self.agents.add(agent)

    def unassign(self, agent: str) -> None:
        """Have it drop an agent."""
        self._send(Dismiss(agent))
        self.agents.discard(agent)

    def ask(self, call: CueCall) -> None:
        """Send it a question; raises WorkerLost."""
        question = self._sent.question(call)
        agent, method = call[:2]
        is_first = (agent, method) not in self._known
        self._patience_s = (
            max(self._limits.first_s, self._limits.answer_s) if is_first else self._limits.answer_s
        )
        self._asked = agent, method
        self.busy_with, self.until = agent, time.monotonic() + self._patience_s
        self._send(question)

    def answer(self) -> CallOutcome:
        """Its answer, which is there; references told in it are understood.

        Raises:
            WorkerLost: there is none, and never will be.
        """
        try:
            answer: CallOutcome = receive(self.channel)
        except (EOFError, OSError):
            raise WorkerLost(self._death()) from None
        except Exception:  # nor could what follows in the channel
            self.close()
            raise WorkerLost("gave an answer that cannot be read") from None
        self.busy_with = None
        if answer.out_of_memory:
            self.close()
            raise WorkerLost(
                f"needs more than {self._limits.memory_mb} MB above what its process starts with"
            )
        self._known.add(self._asked)
        if isinstance(answer.value, EncodedReference):
            return replace(answer, value=self._sent.decode(answer.value))
        return answer

    def overdue(self) -> WorkerLost:
        """Kill it, since it has not answered `until` then; what is to be said of that."""
        self.close()
        return WorkerLost(f"gave no answer in {self._patience_s:.3g} s, and was killed")

    def close(self) -> int | None:
        """Let it go, and see it off: its exit code, None when nobody knows."""
        self.let_go()
        return self._launcher.ended(self.pid)

    def let_go(self) -> None:
        """Close what it is connected by, which ends it, whatever it does."""
        self.channel.close()
        lifeline, self._lifeline = self._lifeline, -1
        cut(lifeline)

    def _send(self, message: Any) -> None:
        try:
            send(self.channel, message)
        except BlockingIOError:
            self.close()
            raise WorkerLost(f"took no question in {self._limits.answer_s:.3g} s, and was killed") from None
        except OSError:
            raise (WorkerGone if self._known else WorkerLost)(self._death()) from None

    def _death(self) -> str:
        code = self.close()
        if code is None:
            return "its process ended"
        if code >= 0:
            return f"its process ended with exit code {code}"
        try:
            return f"its process was killed by {signal.Signals(-code).name}"
        except ValueError:
            return f"its process was killed by signal {-code}"
