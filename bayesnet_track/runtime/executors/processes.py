"""Agents in worker processes, and proxies: all asked before the first is heard, again if a worker dies."""

from __future__ import annotations

import pickle
import select
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from threading import RLock
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.inference.asking import AgentUnavailable
from bayesnet_track.numerics.arrays import Array, Floats
from bayesnet_track.observation.cue import Making, Reference
from bayesnet_track.observation.planes import Frame, FramePair, Plane, Planes, Region
from bayesnet_track.runtime.executors.frames import FrameRing
from bayesnet_track.runtime.executors.messages import LEARN_AND_BLEND, CallOutcome, CueCall, Foreign
from bayesnet_track.runtime.executors.worker_pool import AgentSpec, RayHosts, Slot, WorkerPool
from bayesnet_track.runtime.executors.workers import (
    Late,
    Limits,
    NoWorkerError,
    PlacingError,
    Worker,
    WorkerGone,
    WorkerLost,
)
from bayesnet_track.runtime.pace import WaitBudget


class Transport(Protocol):
    """The place where questions for agents that work elsewhere are handed in."""

    def send_frame(self, frame: Frame) -> Any:
        """Bring a frame to where the agents are; what says there which one it is, and can be pickled."""

    def ask(self, call: CueCall) -> Any:
        """Return what the agent's cue returns.

        Raises:
            AgentUnavailable: it gives no answer.
            Exception: of the type name and the text of what the cue raised.
        """

    def begin(self, call: CueCall) -> Callable[[], Any]:
        """`ask`, whose answer what is returned waits for."""


@dataclass(frozen=True, eq=False)
class SentFrames:
    """The plane that a proxy needs: "computing" it brings the frames to where the agents are, once a frame.

    Its value is an array of two objects: what `Transport.send_frame` said of the current frame and of the one
    before, or None.
    """

    transport: Transport
    margin: None = None
    inputs: tuple[Plane, ...] = ()
    is_points: bool = True

    def compute(self, frames: FramePair, inputs: tuple[Array, ...], region: Region) -> Array:
        """The places of the two frames."""
        places: NDArray[np.object_] = np.empty(2, dtype=object)
        # The older one first: it lies there already, and must not be overwritten by the newer.
        places[1] = None if frames.previous is None else self.transport.send_frame(frames.previous)
        places[0] = self.transport.send_frame(frames.current)
        return places


@dataclass(frozen=True, eq=False)
class AgentProxy:
    """Common part of all proxies: a name to ask by, and the plane that sends frames."""

    agent: str
    transport: Transport
    sent: SentFrames
    context: float

    @property
    def needs(self) -> tuple[Plane, ...]:
        """The real planes are computed where the agent is."""
        return (self.sent,)

    def ask(self, method: str, planes: Planes | None, *arguments: Any) -> Any:
        """A question, about a frame unless `planes` is None."""
        return self.transport.ask(self._call(method, planes, arguments))

    def ask_ahead(self, method: str, *arguments: Any) -> Callable[[], Any]:
        """Ask what the method of that name returns, which what is returned waits for."""
        question = self._blending(*arguments) if method == "blend" else (method, *arguments)
        return self.transport.begin(self._call(question[0], question[1], question[2:]))

    def learn(self, planes: Planes, box: Floats) -> Reference:
        """Learn like a `Cue`."""
        return Learnt(self, "learn", planes, (box,))

    def blend(self, learned: Reference, recent: Reference, rate: float) -> Reference:
        """Blend like a `Cue`; a reference that was learnt just now is learnt and blended at once."""
        blended: Reference = self.ask(*self._blending(learned, recent, rate))
        return blended

    def _call(self, method: str, planes: Planes | None, arguments: tuple[Any, ...]) -> CueCall:
        # Before the transport is busy with this question: what was learnt may have to be asked for.
        encodable = tuple([dict(part) if type(part) is Learnt else part for part in arguments])
        if planes is None:
            return CueCall(self.agent, method, None, None, encodable)
        current, previous = planes[self.sent]
        return CueCall(self.agent, method, (current, previous), planes.region, encodable)

    def _blending(self, learned: Reference, recent: Reference, rate: float) -> tuple[Any, ...]:
        if isinstance(recent, Learnt) and recent.of is self and recent.planes is not None:
            return LEARN_AND_BLEND, recent.planes, recent.method, learned, rate, *recent.arguments
        return "blend", None, learned, recent, rate


class Learnt(Mapping[str, NDArray[Any]]):
    """A reference that is asked for when it is looked into; one that is only blended never crosses."""

    def __init__(self, placed: AgentProxy, method: str, planes: Planes, arguments: tuple[Any, ...]) -> None:
        self.of, self.method, self.arguments = placed, method, arguments
        self.planes: Planes | None = planes
        self._arrays: Reference = {}

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self._asked()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._asked())

    def __len__(self) -> int:
        return len(self._asked())

    def _asked(self) -> Reference:
        if self.planes is not None:
            self._arrays, self.planes = self.of.ask(self.method, self.planes, *self.arguments), None
        return self._arrays


class Pending:
    """A question on its way.

    Attributes:
        asked: of whom, and what.
        patience: for how long its answer is waited for; None for as long as it takes.
        is_sent: whether a worker has it.
        until: the moment by which the answer is needed, since it was sent.
        outcome: the answer, or why there is none.
        lost: why workers that had it gave none.
    """

    __slots__ = ("agent", "asked", "is_sent", "lost", "outcome", "patience", "sent_at", "until")

    def __init__(self, call: CueCall, patience: WaitBudget | None) -> None:
        self.agent = call.agent
        self.asked, self.patience = call, patience
        self.is_sent, self.sent_at = False, 0.0
        self.until: float | None = None
        self.outcome: CallOutcome | Exception | None = None
        self.lost: list[str] = []

    def until_from(self, asked_at: float) -> float | None:
        """The moment by which the answer is needed, when it is asked for `asked_at`."""
        return None if self.patience is None else self.patience.until(self.agent, asked_at)


COMING_S = 0.002
"""Seconds after which it is looked whether a worker that is being started is there."""


class AgentProcesses:
    """Agents in supervised worker processes.

    A worker starts when one of its agents is first asked and ends when none was for a while. One that dies,
    or does not answer in time, is replaced by a fresh one, which is asked the same again; after `retries`
    such attempts `AgentUnavailable` says why.

    Attributes:
        retries: further attempts; 0 where time does not wait for them.
        patience: for how long answers are waited for; a later one is dropped (`AgentUnavailable`), and its
            worker works on, for this agent alone. None for as long as they take.
        hosts: start hosts of cameras elsewhere; None for processes here.
    """

    def __init__(self, workers: int, limits: Limits, retries: int, hosts: RayHosts | None) -> None:
        self.retries, self.patience, self.hosts = retries, None, hosts
        with _starting():
            self._store = FrameRing()
        self._pool = WorkerPool(workers, limits, self._store.descriptor, hosts)
        self._unsent: list[Pending] = []
        self._frames = 0
        self._asking = RLock()

    patience: WaitBudget | None

    def add(self, agents: Mapping[str, AgentSpec]) -> None:
        """Take in agents, those that may be anywhere all at once; raises PlacingError."""
        for agent, spec in agents.items():
            _check_sendable(agent, spec)
        with _starting():
            self._pool.add(agents)

    def send_frame(self, frame: Frame) -> Any:
        """Place the frame in the shared memory; with a new one, agents are placed anew if need be.

        One whose pixels are elsewhere stays there.
        """
        if frame.place is not None:
            return frame.place
        with self._asking:
            shared = self._store.put(frame)
            if shared.number > self._frames:
                self._frames = shared.number
                self._unsent.clear()
                self._pool.look_after(self._frames)
            return shared

    def ask(self, call: CueCall) -> Any:
        """Return what the agent's cue returns; raises what it raised, by type name and text, or
        AgentUnavailable.
        """
        return self.begin(call)()

    def begin(self, call: CueCall) -> Callable[[], Any]:
        """`ask`, in two halves: what waits for the answer is returned, while the agent is at work."""
        pending = Pending(call, self.patience)
        with self._asking:
            if not self._forward(pending):
                self._unsent.append(pending)
        return partial(self._collect, pending)

    def workers(self) -> dict[int, tuple[str, ...]]:
        """Process id of every worker -> the agents that it has."""
        alive = (slot.worker for slot in self._pool.slots)
        return {w.pid: tuple(sorted(w.agents)) for w in alive if w is not None and not w.is_dead}

    def close(self) -> None:
        """End all workers."""
        self._pool.close()
        self._store.close()

    def _collect(self, pending: Pending) -> Any:
        """The answer's value, waited for; the question is asked again of a fresh worker if need be."""
        agent = pending.agent
        with self._asking:
            while len(pending.lost) <= self.retries:
                began = time.monotonic()
                try:
                    answer = self._take_answer(pending)
                except Late:
                    self._pool.spent(agent, time.monotonic() - (pending.sent_at or began))
                    raise
                except WorkerLost as lost:
                    pending.lost.append(str(lost))
                    pending.is_sent, pending.outcome = False, None
                    continue
                finally:
                    if pending.patience is not None:
                        pending.patience.waited(agent, time.monotonic() - began)
                self._pool.spent(agent, answer.seconds)
                if answer.raised is not None:
                    raise _again(*answer.raised)
                if isinstance(answer.value, Foreign):
                    return type(answer.value.type_name, (), {})()
                return answer.value
            self._pool.start(self._pool.slot(agent))
        tries = f", {len(pending.lost)} times" if len(pending.lost) > 1 else ""
        raise AgentUnavailable(f"{pending.lost[-1]}{tries}")

    def _take_answer(self, pending: Pending) -> CallOutcome:
        """The answer to one attempt; raises WorkerLost, Late or AgentUnavailable."""
        if not pending.is_sent and pending.outcome is None:
            if pending in self._unsent:
                self._unsent.remove(pending)
            self._send(pending)
        self._drive(pending)
        if isinstance(pending.outcome, Exception):
            raise pending.outcome
        assert pending.outcome is not None
        return pending.outcome

    def _send(self, pending: Pending) -> None:
        """Send a question, when its worker is there and free for it."""
        while (slot := self._pool.slot(pending.agent)).asked is not None:
            self._drive(slot.asked)
        due = pending.until_from(time.monotonic())
        busy_with = None if slot.worker is None else slot.worker.busy_with
        if slot.worker is not None and busy_with == pending.agent:  # nobody waited for that answer
            self._drop_answer(slot, slot.worker, due)
        elif busy_with is not None:
            self._pool.set_apart(slot, busy_with)
        while not pending.is_sent:
            worker = self._pool.await_answer(slot, due)
            if due is not None and due <= time.monotonic():
                raise Late("there was no time left to ask it")
            with suppress(WorkerGone):  # a fresh one is never that
                self._hand_over(pending, slot, worker, due)

    def _forward(self, pending: Pending) -> bool:
        """Send the question if that takes no waiting; true if it was sent."""
        slot = self._pool.slot(pending.agent)
        if slot.asked is not None or (slot.worker is not None and slot.worker.busy_with is not None):
            return False
        now_s = time.monotonic()
        due = pending.until_from(now_s)
        if due is not None and due <= now_s:
            return False
        try:
            worker = self._pool.come(slot)
        except AgentUnavailable:  # as it will be when it is waited for
            return False
        if worker is None:
            return False
        try:
            self._hand_over(pending, slot, worker, due)
        except WorkerGone:
            self._pool.start(slot)
            return False
        except WorkerLost as lost:
            pending.outcome = lost
        return True

    def _hand_over(self, pending: Pending, slot: Slot, worker: Worker, due: float | None) -> None:
        try:
            self._pool.assign(worker, pending.agent)
            worker.ask(pending.asked)
        except WorkerLost:
            slot.worker = None
            raise
        slot.asked, pending.is_sent = pending, True
        pending.until, pending.sent_at = due, time.monotonic()

    def _drive(self, pending: Pending) -> None:
        """Receive answers, and send what waits for their workers, until the outcome of `pending` is known."""
        while pending.outcome is None:
            working = [slot for slot in self._pool.slots if slot.asked is not None]
            end = min(_end(slot) for slot in working)
            is_coming = self._unsent and any(
                self._pool.slot(waiting.agent).worker is None for waiting in self._unsent
            )
            remaining_s = max(end - time.monotonic(), 0.0)
            ready = _readable(working, min(remaining_s, COMING_S) if is_coming else remaining_s)
            for slot in ready:
                self._receive(slot)
            if not ready and remaining_s < COMING_S:
                self._give_up(working)
            if self._unsent:
                self._unsent = [waiting for waiting in self._unsent if not self._forward(waiting)]

    def _receive(self, slot: Slot) -> None:
        """Take the answer that is there."""
        assert slot.worker is not None
        pending, slot.asked = slot.asked, None
        try:
            pending.outcome = slot.worker.answer()
        except WorkerLost as lost:
            slot.worker, pending.outcome = None, lost

    def _give_up(self, working: list[Slot]) -> None:
        """Leave what takes too long: the worker its work, or its life."""
        now_s = time.monotonic()
        for slot in working:
            pending, worker = slot.asked, slot.worker
            assert worker is not None
            if worker.until <= now_s:
                slot.worker, slot.asked, pending.outcome = None, None, worker.overdue()
            elif pending.until is not None and pending.until <= now_s:
                slot.asked, pending.outcome = None, Late("gave no answer by the deadline")

    def _drop_answer(self, slot: Slot, worker: Worker, due: float | None) -> None:
        """Wait for an answer that is too late for its question, but due before the next."""
        slot.asked = late = Pending(CueCall(str(worker.busy_with), "", None, None, ()), None)
        late.until = due
        self._drive(late)
        if isinstance(late.outcome, Exception):
            raise late.outcome


@contextmanager
def _starting() -> Iterator[None]:
    """Make an OSError while it is entered a PlacingError."""
    try:
        yield
    except OSError as error:
        raise PlacingError(str(NoWorkerError(error.strerror or str(error)))) from error


def _end(slot: Slot) -> float:
    """The moment at which the slot's question is given up."""
    assert slot.worker is not None
    due = slot.asked.until
    return slot.worker.until if due is None else min(slot.worker.until, due)


def _readable(slots: list[Slot], seconds: float) -> list[Slot]:
    """The slots whose worker has answered, or ended, at the latest after so long."""
    poll = select.poll()
    by_number = {}
    for slot in slots:
        assert slot.worker is not None
        number = slot.worker.channel.fileno()
        by_number[number] = slot
        poll.register(number, select.POLLIN)
    return [by_number[number] for number, _ in poll.poll(1e3 * seconds)]


def _again(name: str, text: str) -> Exception:
    """An exception with the type's name and the text of one that a worker told of."""
    kind: type[Exception] = type(name, (Exception,), {})
    return kind(text)


def _check_sendable(agent: str, spec: AgentSpec) -> None:
    """Refuse an agent whose cue cannot be made elsewhere; raises PlacingError."""
    try:
        pickle.dumps((spec.make, spec.parameters), protocol=5)
    except Exception as error:
        raise PlacingError(
            f"agent {agent} cannot be in a process: how its cue is made cannot be sent there ({error}); "
            "its declaration's `make` must be a function of a module"
        ) from None
    make = spec.make.make if isinstance(spec.make, Making) else spec.make
    if "__main__" in (getattr(make, "__module__", ""), type(spec.parameters).__module__):
        raise PlacingError(
            f"agent {agent} cannot be in a process: its cue is defined in the program that runs, which "
            "workers do not import; put it into a file of its own, and give its path: cues=['my_cue.py']"
        )
