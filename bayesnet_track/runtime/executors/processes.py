"""Agents in worker processes: which worker has which, and what happens when one dies or hangs."""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Lock, Thread
from typing import Any

from bayesnet_track.cue import AnyCue
from bayesnet_track.executor import AgentUnavailable
from bayesnet_track.planes import Frame, Region
from bayesnet_track.runtime.deadline import Patience
from bayesnet_track.runtime.executors.frames import FrameStore, SharedFrame
from bayesnet_track.runtime.executors.nursery import Nursery
from bayesnet_track.runtime.executors.packing import packed, repacked
from bayesnet_track.runtime.executors.questions import ADVANCE, Foreign
from bayesnet_track.runtime.executors.workers import Late, Limits, Worker, WorkerLost

IDLE_FRAMES = 30
"""After so many frames without a question an agent leaves its worker, and a worker without agents ends."""
REPACK_EVERY = 50
"""Frames after which it is looked whether agents should be packed anew."""
MEMORY_OF_COST = 0.9
"""Weight of the past in the running mean of what an agent costs a frame."""


class PlacingError(ValueError):
    """An agent cannot be where it was put; says why."""


@dataclass(frozen=True, eq=False)
class Employed:
    """How a worker makes an agent's cue, and what it is expected to cost, seconds a frame."""

    make: Callable[[Any], AnyCue]
    parameters: Any
    cost_s: float


class _Slot:
    """A place for a worker, which may be empty, or one that is being started for it."""

    def __init__(self) -> None:
        self.lock = Lock()
        self.worker: Worker | None = None
        self.coming: Future[Worker] | None = None
        self.agents: set[str] = set()


class Processes:
    """Agents in supervised worker processes.

    A worker starts when one of its agents is first asked and ends when none was for a while. One that dies,
    or does not answer in time, is replaced by a fresh one, which is asked the same again; after `retries`
    such attempts `AgentUnavailable` says why.

    Attributes:
        retries: further attempts; 0 where time does not wait for them.
        patience: for how long answers are waited for; a later one is dropped (`AgentUnavailable`), and its
            worker works on, for this agent alone. None for as long as they take.
    """

    def __init__(
        self, agents: Mapping[str, Employed], workers: int, limits: Limits, retries: int = 2
    ) -> None:
        for agent, employed in agents.items():
            check_sendable(agent, employed)
        self.retries, self.patience = retries, None
        self._agents, self._limits = agents, limits
        self._slots = [_Slot() for _ in range(max(1, min(workers, len(agents))))]
        self._store = FrameStore()
        self._nursery = Nursery(self._store.descriptor, limits.memory_mb)
        self._assigning = Lock()
        self._costs = {agent: employed.cost_s for agent, employed in agents.items()}
        self._spent = dict.fromkeys(agents, 0.0)
        self._asked_in = dict.fromkeys(agents, 0)
        self._slot_of: dict[str, _Slot] = {}
        self._frames = 0
        self._is_closed = False
        self._assign(packed(self._costs, len(self._slots)))

    patience: Patience | None

    def send_frame(self, frame: Frame) -> SharedFrame:
        """Where the frame lies in the shared memory; with a new one, agents are placed anew if need be."""
        shared = self._store.put(frame)
        if shared.number > self._frames:
            self._frames = shared.number
            self._look_after()
        return shared

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
        # Whole nets that nobody waited for would have to be advanced here.
        patience = None if method == ADVANCE else self.patience
        with self._held(agent) as slot:
            for _ in range(1 + self.retries):
                began = time.monotonic()
                try:
                    until = None if patience is None else patience.until(agent, began)
                    worker = self._working(slot, agent, until)
                    if until is not None and until <= time.monotonic():
                        raise Late("there was no time left to ask it")
                    answer = worker.ask(agent, method, frames, region, arguments, until)
                except Late:
                    self._spent[agent] += time.monotonic() - began
                    raise
                except WorkerLost as lost:
                    slot.worker = None
                    reasons.append(str(lost))
                    continue
                finally:
                    if patience is not None:
                        patience.waited(agent, time.monotonic() - began)
                self._spent[agent] += answer.seconds
                if answer.raised is not None:
                    raise again(*answer.raised)
                if isinstance(answer.value, Foreign):
                    return type(answer.value.type_name, (), {})()
                return answer.value
            self._start(slot)
        tries = f", {len(reasons)} times" if len(reasons) > 1 else ""
        raise AgentUnavailable(f"{reasons[-1]}{tries}")

    def workers(self) -> dict[int, tuple[str, ...]]:
        """Process id of every worker -> the agents that it has."""
        alive = (slot.worker for slot in self._slots)
        return {w.pid: tuple(sorted(w.agents)) for w in alive if w is not None and not w.is_dead}

    def close(self) -> None:
        """End all workers."""
        self._is_closed = True
        for slot in self._slots:
            if slot.worker is not None:
                slot.worker.let_go()
        self._nursery.close()
        for slot in self._slots:
            coming = slot.coming
            if coming is not None and coming.done() and coming.exception() is None:
                coming.result().let_go()
        self._store.close()

    @contextmanager
    def _held(self, agent: str) -> Iterator[_Slot]:
        """The agent's slot, for the one who asks, with a worker that does nothing for another agent."""
        while True:
            slot = self._slot(agent)
            with slot.lock:
                if self._slot_of.get(agent) is not slot:  # placed elsewhere while it was waited for
                    continue
                if slot.worker is not None and slot.worker.busy_with not in (None, agent):
                    self._set_apart(slot, slot.worker.busy_with)
                yield slot
                return

    def _set_apart(self, slot: _Slot, late: str) -> None:
        """Leave the slot's worker to the agent that it still works for: the others are not to wait for it."""
        with self._assigning:
            empty = (one for one in self._slots if not one.agents)
            own = next((one for one in empty if one.worker is None and one.coming is None), None)
            if own is None:
                own = _Slot()
                self._slots.append(own)
            own.worker, slot.worker = slot.worker, None
            slot.agents.discard(late)
            own.agents.add(late)
            self._slot_of[late] = own

    def _slot(self, agent: str) -> _Slot:
        with self._assigning:
            self._asked_in[agent] = self._frames
            slot = self._slot_of.get(agent)
            if slot is None:
                slot = min(self._slots, key=self._load)
                slot.agents.add(agent)
                self._slot_of[agent] = slot
            return slot

    def _load(self, slot: _Slot) -> float:
        return sum(self._costs[agent] for agent in slot.agents)

    def _working(self, slot: _Slot, agent: str, until: float | None) -> Worker:
        """The slot's worker, with the agent in it; raises Late when it is not there by `until`."""
        if slot.worker is not None and slot.worker.is_dead:
            slot.worker.close()
            slot.worker = None
        if slot.worker is None:
            coming = self._start(slot)
            if not wait([coming], None if until is None else max(until - time.monotonic(), 0.0)).done:
                raise Late("its worker was not there by the deadline")
            slot.coming = None
            slot.worker = coming.result()
        if agent not in slot.worker.agents:
            employed = self._agents[agent]
            slot.worker.employ(agent, employed.make, employed.parameters)
        return slot.worker

    def _start(self, slot: _Slot) -> Future[Worker]:
        """Have a worker started for the slot, unless one comes already; nobody need wait for it."""
        if self._is_closed:
            raise AgentUnavailable("the run is over")
        if slot.coming is None:
            coming: Future[Worker] = Future()
            slot.coming = coming

            def start() -> None:
                try:
                    coming.set_result(Worker(self._nursery, self._limits))
                except BaseException as error:
                    coming.set_exception(error)

            Thread(target=start, name="worker starts", daemon=True).start()
        return slot.coming

    def _look_after(self) -> None:
        """Once a frame: costs, workers with nothing to do, and now and then another packing."""
        with self._assigning:
            for agent, spent in self._spent.items():
                if self._frames > 1:
                    self._costs[agent] += (1 - MEMORY_OF_COST) * (spent - self._costs[agent])
                self._spent[agent] = 0.0
            for agent in list(self._slot_of):
                if self._frames - self._asked_in[agent] > IDLE_FRAMES:
                    self._slot_of.pop(agent).agents.discard(agent)
            if self._frames % REPACK_EVERY == 0:
                costs = {agent: self._costs[agent] for agent in self._slot_of}
                better = repacked(costs, [slot.agents for slot in self._slots])
                if better is not None:
                    self._assign(better)
            for slot in self._slots:
                self._release(slot)

    def _assign(self, packing: list[set[str]]) -> None:
        for slot, agents in zip(self._slots, packing, strict=True):
            slot.agents = set(agents)
            self._slot_of.update(dict.fromkeys(agents, slot))

    def _release(self, slot: _Slot) -> None:
        worker = slot.worker
        if worker is None or not slot.lock.acquire(blocking=False):
            return
        try:
            if not slot.agents:
                worker.close()
                slot.worker = None
                return
            for agent in worker.agents - slot.agents:
                worker.dismiss(agent)
        except WorkerLost:
            slot.worker = None
        finally:
            slot.lock.release()


def again(name: str, text: str) -> Exception:
    """An exception with the type's name and the text of one that a worker told of."""
    kind: type[Exception] = type(name, (Exception,), {})
    return kind(text)


def check_sendable(agent: str, employed: Employed) -> None:
    """Refuse an agent whose cue cannot be made elsewhere; raises PlacingError."""
    try:
        pickle.dumps((employed.make, employed.parameters), protocol=5)
    except Exception as error:
        raise PlacingError(
            f"agent {agent} cannot be in a process: how its cue is made cannot be sent there ({error}); "
            "its declaration's `make` must be a function of a module"
        ) from None
