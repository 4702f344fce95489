"""Places of agents in processes, and an executor by its name."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, Self

from bayesnet_track.engine.step import Engine
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.cue import AnyCue, CueDeclaration, Hypotheses, Measurement, Reference
from bayesnet_track.observation.planes import Planes
from bayesnet_track.observation.settings import to_caller
from bayesnet_track.runtime.executors.frames import (
    CameraStream,
    HostedSource,
    StreamSettings,
    stream_name,
)
from bayesnet_track.runtime.executors.processes import (
    AgentProcesses,
    AgentProxy,
    Learnt,
    SentFrames,
    Transport,
)
from bayesnet_track.runtime.executors.worker import one_thread_inside
from bayesnet_track.runtime.executors.worker_pool import AgentSpec, RayHosts
from bayesnet_track.runtime.executors.workers import Limits, NoWorkerError, PlacingError
from bayesnet_track.runtime.stop import has_workers, no_workers
from bayesnet_track.sources.frames import Source
from bayesnet_track.sources.origin import Origin
from bayesnet_track.sources.several import reopen
from bayesnet_track.sources.sources import DETECTION_SUFFIXES


def _log_likelihood(self: AgentProxy, planes: Planes, hypotheses: Hypotheses, reference: Reference) -> Floats:
    answer: Floats = self.ask("log_likelihood", planes, hypotheses, reference)
    return answer


def _measure(
    self: AgentProxy, planes: Planes, hypotheses: Hypotheses, weights: Floats, reference: Reference
) -> Measurement | None:
    answer: Measurement | None = self.ask("measure", planes, hypotheses, weights, reference)
    return answer


def _learn_turned(self: AgentProxy, planes: Planes, box: Floats, angle: float) -> Reference:
    return Learnt(self, "learn_turned", planes, (box, angle))


def _adapt(self: AgentProxy, reference: Reference, attempt: int) -> Reference | None:
    tuned: Reference | None = self.ask("adapt", None, reference, attempt)
    return tuned


FURTHER: Mapping[str, Any] = {
    "log_likelihood": _log_likelihood,
    "measure": _measure,
    "learn_turned": _learn_turned,
    "adapt": _adapt,
}
"""Methods that a proxy has where its cue has them, so that it fulfils the same protocols."""


def make_proxy(agent: str, cue: AnyCue, transport: Transport, sent: SentFrames) -> AnyCue:
    """A proxy of `cue`, which fulfils the runtime protocols that `cue` does."""
    methods = {name: method for name, method in FURTHER.items() if hasattr(cue, name)}
    if hasattr(cue, "rule"):
        methods["rule"] = cue.rule
    from bayesnet_track.observation.cue import context_of

    kind = type("Placed" + type(cue).__name__, (AgentProxy,), methods)
    proxy: AnyCue = kind(agent, transport, sent, context_of(cue))
    return proxy


Hosts = Literal["engine", "process", "ray"]
Place = Literal["engine", "process"]
PLACES: tuple[Place, ...] = ("engine", "process")


def parse_places(texts: Iterable[str]) -> dict[str, Place]:
    """Places from texts AGENT=WHERE.

    Raises:
        PlacingError: one is something else.

    >>> parse_places(["flow=process"])
    {'flow': 'process'}
    """
    places: dict[str, Place] = {}
    for text in texts:
        agent, _, text_of_place = text.partition("=")
        chosen_place = next((place for place in PLACES if place == text_of_place), None)
        if chosen_place is None or not agent:
            name = to_caller("--place", "place")
            raise PlacingError(f"{name} {text!r}: AGENT=WHERE is needed, WHERE one of {', '.join(PLACES)}")
        places[agent] = chosen_place
    return places


def places_of(
    engine: Engine,
    default: Place,
    by_agent: Mapping[str, Place],
    cues: Mapping[str, CueDeclaration] | None = None,
) -> dict[tuple[str, str], Place]:
    """(plate, agent) -> where it works: as `by_agent`, else as the graph says, else by `default`.

    `by_agent` has AGENT, in every plate, or PLATE.AGENT as keys. Agents that keep what cannot be sent
    (`opaque`) are in the engine's process unless they are put elsewhere, which is refused.

    Raises:
        PlacingError: `by_agent` names no agent, or an opaque agent is put into a process.
    """
    declarations = _declarations(engine, cues)
    places: dict[tuple[str, str], Place] = {}
    unused = set(by_agent)
    for plate, compiled in engine.plates.items():
        for agent in compiled.cues:
            node = compiled.plate.agent(agent)
            wanted_name = next((name for name in (f"{plate}.{agent}", agent) if name in by_agent), None)
            unused -= {f"{plate}.{agent}", agent}
            place = node.on if wanted_name is None else by_agent[wanted_name]
            if declarations[node.agent.cue].opaque:
                if place == "process":
                    raise PlacingError(
                        f"agent {agent} cannot be in a process: {node.agent.cue} keeps what cannot be sent"
                    )
                place = "engine"
            places[plate, agent] = place or default
    if unused:
        agents = dict.fromkeys(agent for _, agent in places)
        raise PlacingError(f"no agent {sorted(unused)[0]!r}; the graph has {', '.join(agents)}")
    return places


def agent_specs(
    engine: Engine,
    places: Mapping[tuple[str, str], Place],
    cues: Mapping[str, CueDeclaration] | None = None,
    streams: Mapping[str, str] = MappingProxyType({}),
) -> dict[str, AgentSpec]:
    """Name of every agent that works in a process -> how its cue is made there.

    `streams`: camera -> the stream beside which its agents work.
    """
    declarations = _declarations(engine, cues)
    specs = {}
    for (plate, agent), place in places.items():
        if place == "process":
            compiled = engine.plates[plate]
            make = declarations[compiled.plate.agent(agent).agent.cue].make
            parameters, cost_s = compiled.plate.parameters[agent], compiled.costs_ms[agent] * 1e-3
            stream = streams.get(compiled.looking.get(agent, ""), "")
            specs[_name(plate, agent)] = AgentSpec(make, parameters, cost_s, stream)
    return specs


def with_proxies(engine: Engine, places: Mapping[tuple[str, str], Place], transport: Transport) -> Engine:
    """The engine with a proxy in place of the cue of every agent that works in a process."""
    sent = SentFrames(transport)
    plates = {}
    for plate, compiled in engine.plates.items():
        cues = {
            agent: make_proxy(_name(plate, agent), cue, transport, sent)
            if places[plate, agent] == "process"
            else cue
            for agent, cue in compiled.cues.items()
        }
        plates[plate] = replace(compiled, cues=cues)
    return replace(engine, plates=plates)


def _name(plate: str, agent: str) -> str:
    return f"{plate}.{agent}"


def _declarations(engine: Engine, cues: Mapping[str, CueDeclaration] | None) -> Mapping[str, CueDeclaration]:
    if cues is not None:
        return cues
    return {
        declaration.name: declaration
        for compiled in engine.plates.values()
        for declaration in compiled.declared.values()
    }


NO_PLACES: Mapping[str, Place] = MappingProxyType({})
RETRIES = 2
"""How often an agent whose worker was lost is asked again, where frames wait for it."""


class Executing:
    """An executor for a run: entered it is ready, left it has nothing running any more.

    Attributes:
        kind: its name.
        hosts: where the frames of cameras are decoded, and the agents that look at them work.
        workers: processes at work at a time.
        processes: the worker processes, when the engine has agents in some.
    """

    def __init__(
        self,
        kind: str,
        workers: int,
        default: Place,
        places: Mapping[str, Place],
        limits: Limits,
        retries: int | None,
        cues: Mapping[str, CueDeclaration] | None,
        hosts: Hosts = "engine",
    ) -> None:
        self.hosts = hosts
        self.kind, self.workers = kind, workers
        self.processes: AgentProcesses | None = None
        self._default, self._places, self._limits = default, places, limits
        self._retries, self._cues = retries, cues
        self._open = ExitStack()
        self._streams: dict[str, str] = {}

    def __enter__(self) -> Self:
        self._open.enter_context(one_thread_inside(opencv=not self._is_serial))
        return self

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        """Raises PlacingError where no worker could be started while it was entered."""
        self._open.close()
        if isinstance(error, NoWorkerError):
            raise PlacingError(str(error)) from error

    @property
    def _is_serial(self) -> bool:
        return self.kind == "serial" and self.hosts == "engine"

    def open_camera(self, camera: str, origin: Origin) -> Source | HostedSource:
        """The source of one of several cameras, opened where it is decoded.

        A file of detections that stands for the frames is read here.

        Raises:
            SourceError: nothing can be read there.
            PlacingError: it can be read only once, or there is no host.
        """
        if self.hosts == "engine" or Path(origin.text).suffix.lower() in DETECTION_SUFFIXES:
            opened = reopen(origin)
            assert isinstance(opened, Source)
            return opened
        if origin.only_once is not None:
            raise PlacingError(f"the source of camera {camera} cannot be opened again at a host")
        transport = self._transport(RETRIES)
        name = self._streams[camera] = stream_name(camera)
        settings = StreamSettings(name, replace(origin, lazy=False), bool(to_caller("command", "")))
        transport.add({name: AgentSpec(CameraStream, settings, 0.0, name)})
        try:
            return HostedSource(camera, origin, transport.ask, transport.close)
        except NoWorkerError as error:
            transport.close()
            raise PlacingError(str(error)) from error
        except BaseException:
            transport.close()
            raise

    def _transport(self, retries: int) -> AgentProcesses:
        """The processes, with none at work yet where there were none; raises PlacingError."""
        if self.processes is None:
            if not has_workers():
                raise PlacingError(no_workers())
            attempts = retries if self._retries is None else self._retries
            hosts = RayHosts(self._limits) if self.hosts == "ray" else None
            self.processes = AgentProcesses(self.workers, self._limits, attempts, hosts)
        return self.processes

    def engine(self, engine: Engine, retries: int = RETRIES) -> Engine:
        """`engine` with its agents placed, to be run while this is entered; once.

        `retries` holds where the executor was made without a number of its own.

        Raises:
            PlacingError: an agent cannot be where it was put.
        """
        looking = {camera for compiled in engine.plates.values() for camera in compiled.looking.values()}
        if self.hosts != "engine" and not looking & self._streams.keys():
            raise PlacingError(
                "hosts are for agents that look at the images of several cameras, and none does"
            )
        at_hosts: dict[str, Place] = {
            f"{plate}.{agent}": "process"
            for plate, compiled in engine.plates.items()
            for agent, camera in compiled.looking.items()
            if camera in self._streams
        }
        places = places_of(engine, self._default, {**self._places, **at_hosts}, self._cues)
        specs = agent_specs(engine, places, self._cues, self._streams)
        if specs:
            transport = self._transport(retries)
            self._open.callback(transport.close)
            transport.add(specs)
            engine = with_proxies(engine, places, transport)
        return engine


EXECUTORS: Mapping[str, Place] = MappingProxyType({"serial": "engine", "processes": "process"})
"""Name of an executor -> where agents work that are put nowhere."""


def make_executor(
    kind: str = "serial",
    *,
    workers: int | None = None,
    places: Mapping[str, Place] = NO_PLACES,
    limits: Limits = Limits(),  # noqa: B008  (immutable)
    retries: int | None = None,
    cues: Mapping[str, CueDeclaration] | None = None,
    hosts: Hosts = "engine",
) -> Executing:
    """An executor by name, a context manager::

        with make_executor("processes", workers=2) as executor:
            engine = executor.engine(make_engine(graph))

    Args:
        kind: serial or processes.
        workers: processes at work at a time; as many as the machine has processors when None.
        places: AGENT or PLATE.AGENT -> "engine" or "process", before what the graph says with `on`.
        limits: what a worker process may take.
        retries: how often an agent whose worker was lost is asked again. None for 2, or 0 where frames do
            not wait for it: those of a camera, or with a budget.
        cues: declarations by name, where not the installed ones.
        hosts: of several cameras, where the frames of each are decoded, and its agents work that look at
            them: in the engine's process, in one of its own, or on the node of a Ray cluster that has a
            resource with the camera's name.

    Raises:
        ValueError: there is no such executor, or `workers` is less than 1.
    """
    if kind not in EXECUTORS:
        raise ValueError(f"executor {kind!r}; there are {', '.join(EXECUTORS)}")
    number = os.cpu_count() or 1 if workers is None else workers
    if number < 1:
        raise ValueError(f"{number} workers: at least 1 is needed")
    return Executing(kind, number, EXECUTORS[kind], places, limits, retries, cues, hosts)
