"""Agents as actors on a Ray cluster, local or remote: one actor per agent, spread over the cluster's nodes.

Ray's actors lose what they know when they are started again, and so may any process: the engine keeps it and
tells it again, as to the workers of `processes`.
"""

from __future__ import annotations

import os
import pickle
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from threading import Lock
from typing import Any

from bayesnet_track.inference.executor import AgentUnavailable
from bayesnet_track.observation.planes import Frame, Region
from bayesnet_track.runtime.deadline import Patience
from bayesnet_track.runtime.executors.nursery import START_S
from bayesnet_track.runtime.executors.processes import (
    IDLE_FRAMES,
    Employed,
    again,
    check_sendable,
)
from bayesnet_track.runtime.executors.questions import ADVANCE, Answer, Foreign, Question, Sent, Told
from bayesnet_track.runtime.executors.ray.ray_cluster import calmest, connect, living
from bayesnet_track.runtime.executors.ray.ray_frames import RayFrameStore, StoredFrame, fetched
from bayesnet_track.runtime.executors.workers import Late, Limits, WorkerLost


class AgentActor:
    """What runs in an actor: the cue of one agent, as in a worker process."""

    def __init__(self, memory_mb: int) -> None:
        from bayesnet_track.runtime.executors.host import AgentHost
        from bayesnet_track.runtime.executors.memory import limit_memory
        from bayesnet_track.runtime.executors.single import one_thread_inside

        one_thread_inside(opencv=True).__enter__()  # for as long as the actor lives
        limit_memory(memory_mb)
        self._host = AgentHost(fetched, memory_mb > 0)

    def employ(self, message: bytes) -> int:
        """Make the cue of an agent; the process id."""
        self._host.employ(*pickle.loads(message))
        return os.getpid()

    def answer(self, question: Question) -> bytes:
        """What the cue says."""
        return pickle.dumps(self._host.answer(question), protocol=5)


@dataclass(eq=False)
class _Hired:
    """An agent's actor, the node that it is on, and what it was told."""

    actor: Any
    ready: Any
    node: str
    sent: Sent
    asked: set[str]
    pid: int = 0


class RayActors:
    """Agents in actors of Ray, which start when they are first asked and end when they were idle for a while.

    One whose process or node dies, or which does not answer in time, is replaced by a fresh one, which is
    asked the same again; after `retries` such attempts `AgentUnavailable` says why. Actors ask Ray for no
    processor: else a task of somebody else would wait for ever once there are as many of them as processors.
    Each begins on the node with the fewest of them, of those that lost the fewest: Ray itself needs a quarter
    of a minute to see that a node is gone, and puts actors there until then.

    Attributes:
        retries: further attempts; 0 where time does not wait for them.
        patience: for how long answers are waited for; None for as long as they take.
    """

    patience: Patience | None

    def __init__(
        self, agents: Mapping[str, Employed], limits: Limits, retries: int = 2, address: str | None = None
    ) -> None:
        for agent, employed in agents.items():
            check_sendable(agent, employed)
        self.retries, self.patience = retries, None
        self._agents, self._limits = agents, limits
        self._owns_ray = connect(address)
        self._store = RayFrameStore()
        self._hired: dict[str, _Hired] = {}
        self._lost_on: Counter[str] = Counter()
        self._hiring = Lock()
        self._locks = {agent: Lock() for agent in agents}
        self._asked_in = dict.fromkeys(agents, 0)
        self._frames = 0
        self._is_closed = False

    def send_frame(self, frame: Frame) -> StoredFrame:
        """The frame in Ray's object store; with a new one, actors that were idle for long are released."""
        stored = self._store.put(frame)
        if stored.number > self._frames:
            self._frames = stored.number
            for agent in list(self._hired):
                if self._frames - self._asked_in[agent] > IDLE_FRAMES:
                    with self._locks[agent]:
                        self._dismiss(agent)
        return stored

    def ask(
        self,
        agent: str,
        method: str,
        frames: tuple[Any, Any] | None,
        region: Region | None,
        arguments: tuple[Any, ...],
    ) -> Any:
        """What the agent's cue returns; raises what it raised, by type name and text, or AgentUnavailable."""
        reasons: list[str] = []
        self._asked_in[agent] = self._frames
        patience = None if method == ADVANCE else self.patience
        with self._locks[agent]:
            for _ in range(1 + self.retries):
                began = time.monotonic()
                try:
                    until = None if patience is None else patience.until(agent, began)
                    answer = self._asked(agent, method, frames, region, arguments, until)
                except WorkerLost as lost:
                    if (hired := self._hired.get(agent)) is not None:
                        self._lost_on[hired.node] += 1
                    self._dismiss(agent)
                    reasons.append(str(lost))
                    continue
                finally:
                    if patience is not None:
                        patience.waited(agent, time.monotonic() - began)
                if answer.raised is not None:
                    raise again(*answer.raised)
                if isinstance(answer.value, Foreign):
                    return type(answer.value.type_name, (), {})()
                return answer.value
        tries = f", {len(reasons)} times" if len(reasons) > 1 else ""
        raise AgentUnavailable(f"{reasons[-1]}{tries}")

    def workers(self) -> dict[int, tuple[str, ...]]:
        """Process id of every actor that has answered -> its agent."""
        return {hired.pid: (agent,) for agent, hired in self._hired.items() if hired.pid}

    def nodes(self) -> dict[str, str]:
        """Agent whose actor has answered -> the node of the cluster that it is on."""
        return {agent: hired.node for agent, hired in self._hired.items() if hired.pid}

    def close(self) -> None:
        """End all actors, and Ray where it was started here."""
        self._is_closed = True
        for agent in list(self._hired):
            self._dismiss(agent)
        self._store.close()
        if self._owns_ray:
            import ray

            ray.shutdown()

    def _asked(
        self,
        agent: str,
        method: str,
        frames: tuple[Any, Any] | None,
        region: Region | None,
        arguments: tuple[Any, ...],
        until: float | None,
    ) -> Answer:
        hired = self._hired.get(agent) or self._hire(agent)
        if until is not None and until <= time.monotonic():
            raise Late("there was no time left to ask it")
        if not hired.pid:
            hired.pid = self._received(hired.ready, START_S, until)
        question = hired.sent.question(agent, method, frames, region, arguments)
        is_first = method not in hired.asked
        limit = max(self._limits.first_s, self._limits.answer_s) if is_first else self._limits.answer_s
        answer: Answer = pickle.loads(self._received(hired.actor.answer.remote(question), limit, until))
        hired.asked.add(method)
        if answer.out_of_memory:
            raise WorkerLost(
                f"needs more than {self._limits.memory_mb} MB above what its process starts with"
            )
        if isinstance(answer.value, Told):
            return Answer(hired.sent.heard(answer.value), seconds=answer.seconds)
        return answer

    def _received(self, promised: Any, limit: float, until: float | None) -> Any:
        """What an actor returns within `limit` seconds; one that is not there by `until` is left behind."""
        import ray

        left = float("inf") if until is None else until - time.monotonic()
        try:
            return ray.get(promised, timeout=max(min(limit, left), 0.0))
        except ray.exceptions.GetTimeoutError:
            if left < limit:
                raise Late("no answer by the frame's deadline") from None
            raise WorkerLost(f"no answer in {limit:g} s") from None
        except ray.exceptions.RayError as error:
            raise WorkerLost(f"its actor was lost ({type(error).__name__})") from error

    def _hire(self, agent: str) -> _Hired:
        import ray
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        if self._is_closed:
            raise AgentUnavailable("the run is over")
        employed = self._agents[agent]
        message = pickle.dumps((agent, employed.make, employed.parameters), protocol=5)
        with self._hiring:  # two that begin at the same time see each other
            busy = Counter(hired.node for hired in list(self._hired.values()))
            node = calmest(living(), self._lost_on, busy)
            there = NodeAffinitySchedulingStrategy(node, soft=False)
            kind = ray.remote(AgentActor).options(num_cpus=0, max_restarts=0, scheduling_strategy=there)
            actor = kind.remote(self._limits.memory_mb)
            hired = self._hired[agent] = _Hired(actor, actor.employ.remote(message), node, Sent(), set())
        return hired

    def _dismiss(self, agent: str) -> None:
        import ray

        hired = self._hired.pop(agent, None)
        if hired is not None and ray.is_initialized():
            ray.kill(hired.actor)
