"""A worker process as the engine sees it: started, asked, found dead or hanging, ended."""

from __future__ import annotations

import os
import pickle
import select
import signal
import socket
import struct
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

from bayesnet_track.executor import AgentUnavailable
from bayesnet_track.runtime.executors.nursery import Nursery
from bayesnet_track.runtime.executors.questions import Answer, Sent, Told


class WorkerLost(Exception):
    """A worker died, was killed because it did not answer, or needed too much memory; says which."""


class Late(AgentUnavailable):
    """The answer did not come by the deadline; the worker still works on it."""


@dataclass(frozen=True)
class Limits:
    """What a worker may take.

    Attributes:
        answer_s: seconds for an answer.
        first_s: seconds for the first answer of an agent to a kind of question, for which kernels may be
            compiled.
        memory_mb: above what it has when it is ready; 0 for no limit.
    """

    answer_s: float = 10.0
    first_s: float = 30.0
    memory_mb: int = 0


class Worker:
    """One process with some agents. Not for several threads at a time.

    Attributes:
        pid: its process id.
        agents: those whose cues it has.
        busy_with: the agent whose question it still works on, though nobody waits; else None.
    """

    def __init__(self, nursery: Nursery, limits: Limits) -> None:
        self._nursery = nursery
        self._socket, self._lifeline, self.pid = nursery.worker()
        # A worker that is stopped reads nothing: a long question would then wait for ever.
        patience = struct.pack("@ll", int(limits.answer_s), int(limits.answer_s % 1 * 1e6))
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, patience)
        self._channel = Connection(os.dup(self._socket.fileno()))
        self._readable = select.poll()
        self._readable.register(self._socket, select.POLLIN)
        self._limits, self._patience_s, self._until = limits, 0.0, 0.0
        self._sent = Sent()
        self._known: set[tuple[str, str]] = set()
        self.agents: set[str] = set()
        self.busy_with: str | None = None

    @property
    def is_dead(self) -> bool:
        """Whether its end of the channel is closed."""
        try:
            return self._socket.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT) == b""
        except BlockingIOError:
            return False
        except OSError:
            return True

    def employ(self, agent: str, make: Any, parameters: Any) -> None:
        """Have it make the cue of an agent."""
        self._send(("employ", agent, make, parameters))
        self.agents.add(agent)

    def dismiss(self, agent: str) -> None:
        """Have it drop an agent."""
        self._send(("dismiss", agent))
        self.agents.discard(agent)

    def ask(
        self,
        agent: str,
        method: str,
        frames: tuple[Any, Any] | None,
        region: Any,
        arguments: tuple[Any, ...],
        deadline: float | None = None,
    ) -> Answer:
        """The agent's answer, references told in it understood.

        Raises:
            WorkerLost: it gives none, and never will.
            Late: it gives none by `deadline`, seconds of the monotonic clock.
        """
        if self.busy_with is not None:  # with a question whose answer nobody waited for
            self._receive(deadline)
        question = self._sent.question(agent, method, frames, region, arguments)
        is_first = (agent, method) not in self._known
        limit = max(self._limits.first_s, self._limits.answer_s) if is_first else self._limits.answer_s
        self.busy_with, self._patience_s, self._until = agent, limit, time.monotonic() + limit
        self._send(("ask", question))
        answer = self._receive(deadline)
        self._known.add((agent, method))
        return answer

    def close(self) -> int | None:
        """Let it go, and see it off: its exit code, None when nobody knows."""
        self.let_go()
        return self._nursery.ended(self.pid)

    def let_go(self) -> None:
        """Close what it is connected by, which ends it, whatever it does."""
        self._channel.close()
        self._socket.close()
        lifeline, self._lifeline = self._lifeline, -1
        if lifeline >= 0:
            os.close(lifeline)

    def _receive(self, deadline: float | None) -> Answer:
        answer: Answer = pickle.loads(self._received(deadline))
        self.busy_with = None
        if answer.out_of_memory:
            reason = f"needs more than {self._limits.memory_mb} MB above what its process starts with"
            self.close()
            raise WorkerLost(reason)
        if isinstance(answer.value, Told):
            return Answer(self._sent.heard(answer.value), seconds=answer.seconds)
        return answer

    def _received(self, deadline: float | None) -> bytes:
        end = self._until if deadline is None else min(self._until, deadline)
        try:
            while not self._readable.poll(1e3 * max(end - time.monotonic(), 0.0)):
                if time.monotonic() >= self._until:
                    self.close()
                    raise WorkerLost(f"gave no answer in {self._patience_s:.3g} s, and was killed")
                if deadline is not None and time.monotonic() >= deadline:
                    raise Late("gave no answer by the deadline")
            return self._channel.recv_bytes()
        except (EOFError, OSError):
            raise WorkerLost(self._death()) from None

    def _send(self, message: Any) -> None:
        try:
            self._channel.send_bytes(pickle.dumps(message, protocol=5))
        except BlockingIOError:
            self.close()
            raise WorkerLost(f"took no question in {self._limits.answer_s:.3g} s, and was killed") from None
        except OSError:
            raise WorkerLost(self._death()) from None

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
