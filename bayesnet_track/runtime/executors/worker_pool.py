"""Agents and their workers: workers started, agents packed, set apart and let go."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, wait
from dataclasses import dataclass
from threading import Thread
from typing import Any

from bayesnet_track.inference.asking import AgentUnavailable
from bayesnet_track.runtime.executors.workers import (
    ForkServer,
    Late,
    Limits,
    NoWorkerError,
    Worker,
    WorkerLost,
)

WORTH_MOVING = 0.8
"""Agents are packed anew when the busiest worker would then have less than this share of its work."""
NOTEWORTHY_S = 0.0005
"""... and it spends more than this on a frame."""


def pack(costs: Mapping[str, float], workers: int) -> list[set[str]]:
    """Agents for each worker: the most expensive first, each to the worker that has least to do.

    >>> [sorted(own) for own in pack({"a": 3.0, "b": 2.0, "c": 2.0}, 2)]
    [['a'], ['b', 'c']]
    """
    loads, own = [0.0] * workers, [set[str]() for _ in range(workers)]
    for agent in sorted(costs, key=lambda name: (-costs[name], name)):
        worker = loads.index(min(loads))
        own[worker].add(agent)
        loads[worker] += costs[agent]
    return own


def busiest(costs: Mapping[str, float], packing: Sequence[set[str]]) -> float:
    """The load of the worker that has most to do."""
    return max((sum(costs[agent] for agent in own) for own in packing), default=0.0)


def repack(costs: Mapping[str, float], packing: Sequence[set[str]]) -> list[set[str]] | None:
    """A better packing of the same agents, or None where moving them is not worth it."""
    now, better = busiest(costs, packing), pack(costs, len(packing))
    if now < NOTEWORTHY_S or busiest(costs, better) >= WORTH_MOVING * now:
        return None
    return better


IDLE_FRAMES = 30
"""After so many frames without a question an agent leaves its worker, and a worker without agents ends."""
REPACK_EVERY = 50
"""Frames after which it is looked whether agents should be packed anew."""
MEMORY_OF_COST = 0.9
"""Weight of the past in the running mean of what an agent costs a frame."""


@dataclass(frozen=True, eq=False)
class AgentSpec:
    """The recipe of an agent's cue for a worker.

    Attributes:
        make: parameters -> cue.
        parameters: of the cue.
        cost_s: expected cost, seconds a frame.
        stream: the stream of frames beside which it works, a recipe, too; "" where it may be anywhere.
    """

    make: Callable[[Any], Any]
    parameters: Any
    cost_s: float
    stream: str = ""


class Slot:
    """A place for a worker, which may be empty, or one that is being started for it.

    Attributes:
        asked: the question that its worker works on, and that is waited for; else None.
    """

    def __init__(self) -> None:
        self.worker: Worker | None = None
        self.coming: Future[Worker] | None = None
        self.agents: set[str] = set()
        self.asked: Any = None


class WorkerPool:
    """The slots of some agents. Not for several threads at a time.

    Args:
        frames: descriptor of the frames' memory.
    """

    def __init__(self, workers: int, limits: Limits, frames: int) -> None:
        self._hosts: dict[str, Slot] = {}
        self._free: list[Slot] = []
        self.slots: list[Slot] = []
        self._agents: dict[str, AgentSpec] = {}
        self._workers, self._limits = workers, limits
        self._fork_server = ForkServer(frames, limits.memory_mb, limits.answer_s)
        self._costs: dict[str, float] = {}
        self._spent: dict[str, float] = {}
        self._asked_in: dict[str, int] = {}
        self._slot_of: dict[str, Slot] = {}
        self._frames = 0
        self._is_closed = False

    def add(self, agents: Mapping[str, AgentSpec]) -> None:
        """Take in agents: each beside its stream; those without one, which come all at once, packed."""
        free = {agent: spec.cost_s for agent, spec in agents.items() if not spec.stream}
        new = dict.fromkeys(spec.stream for spec in agents.values() if spec.stream)
        self._hosts |= {stream: Slot() for stream in new if stream not in self._hosts}
        self._agents |= agents
        self._costs |= {agent: spec.cost_s for agent, spec in agents.items()}
        self._spent |= dict.fromkeys(agents, 0.0)
        self._asked_in |= dict.fromkeys(agents, 0)
        if free:
            self._free = [Slot() for _ in range(min(self._workers, len(free)))]
            self._assign(pack(free, len(self._free)))
        self.slots = [*self._free, *self._hosts.values()]

    def slot(self, agent: str) -> Slot:
        """The slot of the agent, which is to be asked something."""
        self._asked_in[agent] = self._frames
        slot = self._slot_of.get(agent)
        if slot is None:
            slot = self._hosts.get(self._agents[agent].stream) or min(self._free, key=self._load)
            slot.agents.add(agent)
            self._slot_of[agent] = slot
        return slot

    def spent(self, agent: str, seconds: float) -> None:
        """The agent has worked for so long."""
        self._spent[agent] += seconds

    def set_apart(self, slot: Slot, late: str) -> None:
        """Leave the slot's worker to the agent that it still works for: the others are not to wait for it."""
        empty = (one for one in self.slots if not one.agents)
        own = next((one for one in empty if one.worker is None and one.coming is None), None)
        if own is None:
            own = Slot()
            self.slots.append(own)
            self._free.append(own)
        own.worker, slot.worker = slot.worker, None
        slot.agents.discard(late)
        own.agents.add(late)
        self._slot_of[late] = own

    def come(self, slot: Slot) -> Worker | None:
        """The slot's worker, if it is there; else one is being started."""
        if slot.worker is None:
            coming = self.start(slot)
            if coming.done() and coming.exception() is None:
                slot.coming, slot.worker = None, coming.result()
        return slot.worker

    def await_answer(self, slot: Slot, until: float | None) -> Worker:
        """The slot's worker; raises Late when it is not there by `until`, AgentUnavailable, NoWorkerError."""
        worker = self.come(slot)
        if worker is not None:
            return worker
        coming = self.start(slot)
        if not wait([coming], None if until is None else max(until - time.monotonic(), 0.0)).done:
            raise Late("its worker was not there by the deadline")
        slot.coming = None
        slot.worker = worker = coming.result()
        return worker

    def assign(self, worker: Worker, agent: str) -> None:
        """See that the worker has the agent; raises WorkerLost."""
        spec = self._agents[agent]
        for name in (spec.stream, agent):
            if name and name not in worker.agents:
                worker.assign(name, self._agents[name].make, self._agents[name].parameters)

    def start(self, slot: Slot) -> Future[Worker]:
        """Have a worker started for the slot, unless one comes already; nobody need wait for it."""
        if self._is_closed:
            raise AgentUnavailable("the run is over")
        if slot.coming is None:
            coming: Future[Worker] = Future()
            slot.coming = coming

            def start() -> None:
                try:
                    coming.set_result(Worker(self._fork_server, self._limits))
                except OSError as error:
                    coming.set_exception(NoWorkerError(error.strerror or str(error)))
                except BaseException as error:
                    coming.set_exception(error)

            Thread(target=start, name="worker starts", daemon=True).start()
        return slot.coming

    def look_after(self, frames: int) -> None:
        """Once a frame: costs, workers with nothing to do, and now and then another packing."""
        self._frames = frames
        for agent, spent in self._spent.items():
            if frames > 1:
                self._costs[agent] += (1 - MEMORY_OF_COST) * (spent - self._costs[agent])
            self._spent[agent] = 0.0
        for agent in list(self._slot_of):
            if frames - self._asked_in[agent] > IDLE_FRAMES:
                self._slot_of.pop(agent).agents.discard(agent)
        if frames % REPACK_EVERY == 0:
            costs = {agent: self._costs[agent] for agent in self._slot_of if not self._agents[agent].stream}
            better = repack(costs, [slot.agents for slot in self._free])
            if better is not None:
                self._assign(better)
        for slot in self.slots:
            self._release(slot)

    def close(self) -> None:
        """End all workers."""
        self._is_closed = True
        for slot in self.slots:
            if slot.worker is not None:
                slot.worker.let_go()
        self._fork_server.close()
        for slot in self.slots:
            coming = slot.coming
            if coming is not None and coming.done() and coming.exception() is None:
                coming.result().let_go()

    def _load(self, slot: Slot) -> float:
        return sum(self._costs[agent] for agent in slot.agents)

    def _assign(self, packing: list[set[str]]) -> None:
        for slot, agents in zip(self._free, packing, strict=True):
            slot.agents = set(agents)
            self._slot_of.update(dict.fromkeys(agents, slot))

    def _release(self, slot: Slot) -> None:
        worker = slot.worker
        if worker is None or slot.asked is not None:
            return
        try:
            if not slot.agents:
                worker.close()
                slot.worker = None
                return
            for agent in worker.agents - slot.agents - self._hosts.keys():
                worker.unassign(agent)
        except WorkerLost:
            slot.worker = None
