"""Agents and their workers: workers started, here or on Ray, agents packed, set apart and let go."""

from __future__ import annotations

import hmac
import json
import secrets
import signal
import socket
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, wait
from contextlib import suppress
from dataclasses import dataclass
from threading import Thread
from typing import Any

from bayesnet_track.inference.asking import AgentUnavailable
from bayesnet_track.observation.cue_files import pack_cue_files as pack_cue_files
from bayesnet_track.observation.settings import setting
from bayesnet_track.runtime.checkpoints.origins import describe_machine, name_differences
from bayesnet_track.runtime.executors.frames import STREAM
from bayesnet_track.runtime.executors.messages import receive
from bayesnet_track.runtime.executors.worker import CameraHost
from bayesnet_track.runtime.executors.workers import (
    START_S,
    ForkServer,
    Late,
    Limits,
    NoHostError,
    NoWorkerError,
    PlacingError,
    Worker,
    WorkerLost,
)

WORTH_MOVING = 0.8
"""Agents are packed anew when the busiest worker would then have less than this share of its work."""
NOTEWORTHY_S = 0.0005
"""... and it spends more than this on a frame."""


def spread_agents(costs: Mapping[str, float], workers: int) -> list[set[str]]:
    """Agents for each worker: the most expensive first, each to the worker that has least to do.

    >>> [sorted(own) for own in spread_agents({"a": 3.0, "b": 2.0, "c": 2.0}, 2)]
    [['a'], ['b', 'c']]
    """
    loads, packing = [0.0] * workers, [set[str]() for _ in range(workers)]
    for agent in sorted(costs, key=lambda name: (-costs[name], name)):
        worker = loads.index(min(loads))
        packing[worker].add(agent)
        loads[worker] += costs[agent]
    return packing


def busiest(costs: Mapping[str, float], packing: Sequence[set[str]]) -> float:
    """The load of the worker that has most to do."""
    return max((sum(costs[agent] for agent in agents) for agents in packing), default=0.0)


def repack(costs: Mapping[str, float], packing: Sequence[set[str]]) -> list[set[str]] | None:
    """A better packing of the same agents, or None where moving them is not worth it."""
    load, better = busiest(costs, packing), spread_agents(costs, len(packing))
    if load < NOTEWORTHY_S or busiest(costs, better) >= WORTH_MOVING * load:
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


MISSING = "Ray is not installed: pip install 'bayesnet-track[ray]'"


def connect(address: str | None) -> bool:
    """Connect to the Ray cluster at `address`, or start one here; true if it has to be shut down again.

    Raises:
        PlacingError: Ray is not installed, or there is no cluster.
    """
    try:
        import ray
    except ImportError:
        raise PlacingError(MISSING) from None
    if ray.is_initialized():
        return False
    handler = signal.getsignal(signal.SIGTERM)  # Ray takes it, and ends the program
    try:
        if address is None:
            ray.init(log_to_driver=False, logging_level="error", include_dashboard=False)
        else:
            ray.init(address=address, log_to_driver=False, logging_level="error")
    except Exception as error:  # what Ray raises when it is not up in time has no class of its own
        failure = "Ray cannot be started here" if address is None else f"no Ray cluster at {address}"
        raise PlacingError(f"{failure}: {' '.join(str(error).split())}") from error
    finally:
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, handler)
    return True


TOKEN_BYTES = 32
SHARE = 0.001
"""Of a node's resource that a host takes: many runs may read one camera."""
LOOK_S = 0.25


class RayHosts:
    """Hosts of cameras as Ray actors, each on a node that has a resource with the name of its camera.

    An actor connects back to the engine, and is a worker like others from then on. For several threads.
    """

    def __init__(self, limits: Limits) -> None:
        """Connect to the cluster that `RAY_ADDRESS` names, or that runs here; raises PlacingError."""
        self._owns_ray = connect("auto")
        self._limits = limits
        self._hosted: set[str] = set()
        self.actors: dict[int, Any] = {}

    def worker(self, camera: str) -> tuple[socket.socket, int, int]:
        """A new host: the channel to it, no lifeline (-1), and its number.

        A node for one that was lost is waited for as long as for a first answer.

        Raises:
            NoHostError: there is no such node, the actor fails, or its machine would give other last digits.
        """
        import ray

        began_s = time.monotonic()
        while not any(node["Alive"] and camera in node["Resources"] for node in ray.nodes()):
            if camera not in self._hosted or time.monotonic() - began_s > self._limits.first_s:
                raise NoHostError(
                    camera,
                    f"no node of the Ray cluster has the resource {camera!r}; start one where its source is, "
                    f"with the resources {json.dumps({camera: 1})}",
                )
            time.sleep(LOOK_S)
        token = secrets.token_bytes(TOKEN_BYTES)
        with socket.create_server((ray.util.get_node_ip_address(), 0)) as listening:
            options = {"num_cpus": 0, "resources": {camera: SHARE}}
            actor = ray.remote(CameraHost).options(**options).remote()
            ending = actor.serve.remote(listening.getsockname(), token, pack_cue_files())
            try:
                channel = _accept(camera, listening, token, ending)
                differences = name_differences(describe_machine(), receive(channel))
            except (OSError, EOFError) as error:
                ray.kill(actor)
                raise NoHostError(camera, f"its actor was lost while it started ({error})") from error
            except NoHostError:
                ray.kill(actor)
                raise
        if differences and not self._limits.allow_other_machine:
            ray.kill(actor)
            raise NoHostError(
                camera,
                f"its machine or libraries are others than the engine's, which give other last digits: "
                f"{'; '.join(differences)}; {setting('--allow-other-machine')} goes on all the same",
            )
        channel.settimeout(None)  # as of a worker, whose patience is the kernel's
        self._hosted.add(camera)
        number = len(self.actors) + 1
        self.actors[number] = actor
        return channel, -1, number

    def ended(self, pid: int) -> None:
        """End the actor of that number."""
        import ray

        if ray.is_initialized():  # else it would start a cluster, and the actor is gone
            with suppress(ray.exceptions.RayError):
                ray.kill(self.actors[pid])

    def close(self) -> None:
        """End all actors."""
        import ray

        for number in self.actors:
            self.ended(number)
        if self._owns_ray:
            ray.shutdown()
            self._owns_ray = False


def _accept(camera: str, listening: socket.socket, token: bytes, ending: Any) -> socket.socket:
    """The connection of the actor that knows `token`; raises NoHostError where it ends or is late."""
    import ray

    listening.settimeout(LOOK_S)
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline:
        with suppress(TimeoutError):
            channel, _ = listening.accept()
            channel.settimeout(LOOK_S * 4)
            if hmac.compare_digest(channel.recv(TOKEN_BYTES, socket.MSG_WAITALL), token):
                channel.settimeout(START_S)
                channel.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                return channel
            channel.close()
        if ray.wait([ending], timeout=0)[0]:
            try:
                ray.get(ending)
            except ray.exceptions.RayError as error:
                raise NoHostError(camera, f"its actor failed: {' '.join(str(error).split())}") from error
            raise EOFError("it ended")
    raise NoHostError(camera, f"its actor was not there in {START_S:.3g} s")


class Slot:
    """A place for a worker, which may be empty, or one that is being started for it.

    Attributes:
        camera: whose host the worker is to be; "" of any other.
        asked: the question that its worker works on, and that is waited for; else None.
    """

    def __init__(self, camera: str = "") -> None:
        self.camera = camera
        self.worker: Worker | None = None
        self.coming: Future[Worker] | None = None
        self.agents: set[str] = set()
        self.asked: Any = None


class WorkerPool:
    """The slots of some agents. Not for several threads at a time.

    Args:
        frames: descriptor of the frames' memory.
        ray_hosts: start hosts of cameras elsewhere; None for processes here.
    """

    def __init__(self, workers: int, limits: Limits, frames: int, ray_hosts: RayHosts | None) -> None:
        self._hosts: dict[str, Slot] = {}
        self._free: list[Slot] = []
        self.slots: list[Slot] = []
        self._agents: dict[str, AgentSpec] = {}
        self._workers, self._limits = workers, limits
        self._frames_memory, self._ray_hosts = frames, ray_hosts
        self._fork_server: ForkServer | None = None
        self._costs: dict[str, float] = {}
        self._spent: dict[str, float] = {}
        self._asked_in: dict[str, int] = {}
        self._slot_of: dict[str, Slot] = {}
        self._frames = 0
        self._is_closed = False

    def add(self, agents: Mapping[str, AgentSpec]) -> None:
        """Take in agents: each beside its stream; those without one, which come all at once, packed.

        Raises OSError where processes are needed, and none can be forked.
        """
        free = {agent: spec.cost_s for agent, spec in agents.items() if not spec.stream}
        streams = dict.fromkeys(spec.stream for spec in agents.values() if spec.stream)
        self._hosts |= {
            stream: Slot(stream.removeprefix(STREAM)) for stream in streams if stream not in self._hosts
        }
        if self._fork_server is None and (free or self._ray_hosts is None):
            limits = self._limits
            self._fork_server = ForkServer(self._frames_memory, limits.memory_mb, limits.answer_s)
        self._agents |= agents
        self._costs |= {agent: spec.cost_s for agent, spec in agents.items()}
        self._spent |= dict.fromkeys(agents, 0.0)
        self._asked_in |= dict.fromkeys(agents, 0)
        if free:
            self._free = [Slot() for _ in range(min(self._workers, len(free)))]
            self._assign(spread_agents(free, len(self._free)))
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
        empty = (candidate for candidate in self.slots if not candidate.agents)
        spare = next(
            (candidate for candidate in empty if candidate.worker is None and candidate.coming is None), None
        )
        if spare is None:
            spare = Slot()
            self.slots.append(spare)
            self._free.append(spare)
        spare.worker, slot.worker = slot.worker, None
        slot.agents.discard(late)
        spare.agents.add(late)
        self._slot_of[late] = spare

    def come(self, slot: Slot) -> Worker | None:
        """The slot's worker, if it is there; else one is being started."""
        if slot.worker is None:
            coming = self.start(slot)
            if coming.done() and coming.exception() is None:
                slot.coming, slot.worker = None, coming.result()
        return slot.worker

    def await_answer(self, slot: Slot, deadline: float | None) -> Worker:
        """The slot's worker; raises Late if it is absent at `deadline`, AgentUnavailable, NoWorkerError."""
        worker = self.come(slot)
        if worker is not None:
            return worker
        coming = self.start(slot)
        if not wait([coming], None if deadline is None else max(deadline - time.monotonic(), 0.0)).done:
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
                    coming.set_result(self._launch(slot.camera))
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
        for launcher in (self._fork_server, self._ray_hosts):
            if launcher is not None:
                launcher.close()
        for slot in self.slots:
            coming = slot.coming
            if coming is not None and coming.done() and coming.exception() is None:
                coming.result().let_go()

    def _launch(self, camera: str) -> Worker:
        """A new worker; raises OSError, NoHostError or AgentUnavailable."""
        if camera and self._ray_hosts is not None:
            return Worker(self._ray_hosts, self._ray_hosts.worker(camera), self._limits)
        assert self._fork_server is not None
        return Worker(self._fork_server, self._fork_server.worker(), self._limits)

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
