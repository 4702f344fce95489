"""Places of agents in processes, and an executor by its name."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.engine.step import Engine
from bayesnet_track.numerics.arrays import Array, Floats
from bayesnet_track.observation.cue import AnyCue, CueDeclaration, Hypotheses, Measurement, Reference
from bayesnet_track.observation.planes import Frame, FramePair, Plane, Planes, Region
from bayesnet_track.observation.settings import to_caller
from bayesnet_track.runtime.executors.messages import LEARN_AND_BLEND, Call
from bayesnet_track.runtime.executors.processes import PlacingError, Processes
from bayesnet_track.runtime.executors.worker_pool import AgentSpec
from bayesnet_track.runtime.executors.workers import Limits, NoWorkerError
from bayesnet_track.runtime.stop import has_workers, no_workers


class Transport(Protocol):
    """The place where questions for agents that work elsewhere are handed in."""

    def send_frame(self, frame: Frame) -> Any:
        """Bring a frame to where the agents are; what says there which one it is, and can be pickled."""

    def ask(self, call: Call) -> Any:
        """Return what the agent's cue returns.

        Raises:
            AgentUnavailable: it gives no answer.
            Exception: of the type name and the text of what the cue raised.
        """

    def begin(self, call: Call) -> Callable[[], Any]:
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
class Placed:
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

    def _call(self, method: str, planes: Planes | None, arguments: tuple[Any, ...]) -> Call:
        # Before the transport is busy with this question: what was learnt may have to be asked for.
        encodable = tuple([dict(part) if type(part) is Learnt else part for part in arguments])
        if planes is None:
            return Call(self.agent, method, None, None, encodable)
        current, previous = planes[self.sent]
        return Call(self.agent, method, (current, previous), planes.region, encodable)

    def _blending(self, learned: Reference, recent: Reference, rate: float) -> tuple[Any, ...]:
        if isinstance(recent, Learnt) and recent.of is self and recent.planes is not None:
            return LEARN_AND_BLEND, recent.planes, recent.method, learned, rate, *recent.arguments
        return "blend", None, learned, recent, rate


class Learnt(Mapping[str, NDArray[Any]]):
    """A reference that is asked for when it is looked into; one that is only blended never crosses."""

    def __init__(self, of: Placed, method: str, planes: Planes, arguments: tuple[Any, ...]) -> None:
        self.of, self.method, self.arguments = of, method, arguments
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


def _log_likelihood(self: Placed, planes: Planes, hypotheses: Hypotheses, reference: Reference) -> Floats:
    answer: Floats = self.ask("log_likelihood", planes, hypotheses, reference)
    return answer


def _measure(
    self: Placed, planes: Planes, hypotheses: Hypotheses, weights: Floats, reference: Reference
) -> Measurement | None:
    answer: Measurement | None = self.ask("measure", planes, hypotheses, weights, reference)
    return answer


def _learn_turned(self: Placed, planes: Planes, box: Floats, angle: float) -> Reference:
    return Learnt(self, "learn_turned", planes, (box, angle))


def _adapt(self: Placed, reference: Reference, attempt: int) -> Reference | None:
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

    kind = type("Placed" + type(cue).__name__, (Placed,), methods)
    proxy: AnyCue = kind(agent, transport, sent, context_of(cue))
    return proxy


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
        found = next((place for place in PLACES if place == text_of_place), None)
        if found is None or not agent:
            name = to_caller("--place", "place")
            raise PlacingError(f"{name} {text!r}: AGENT=WHERE is needed, WHERE one of {', '.join(PLACES)}")
        places[agent] = found
    return places


def places_of(
    engine: Engine,
    default: Place,
    wanted: Mapping[str, Place],
    cues: Mapping[str, CueDeclaration] | None = None,
) -> dict[tuple[str, str], Place]:
    """(plate, agent) -> where it works: as `wanted`, else as the graph says, else by `default`.

    `wanted` names an agent as AGENT, in every plate, or as PLATE.AGENT. Agents that keep what cannot be sent
    (`opaque`) are in the engine's process unless they are put elsewhere, which is refused.

    Raises:
        PlacingError: `wanted` names no agent, or an opaque agent is put into a process.
    """
    declarations = _declarations(engine, cues)
    places: dict[tuple[str, str], Place] = {}
    unused = set(wanted)
    for plate, compiled in engine.plates.items():
        for agent in compiled.cues:
            node = compiled.plate.agent(agent)
            wanted_name = next((name for name in (f"{plate}.{agent}", agent) if name in wanted), None)
            unused -= {f"{plate}.{agent}", agent}
            place = node.on if wanted_name is None else wanted[wanted_name]
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
) -> dict[str, AgentSpec]:
    """Name of every agent that works in a process -> how its cue is made there."""
    declarations = _declarations(engine, cues)
    specs = {}
    for (plate, agent), place in places.items():
        if place == "process":
            compiled = engine.plates[plate]
            make = declarations[compiled.plate.agent(agent).agent.cue].make
            parameters = compiled.plate.parameters[agent]
            specs[_name(plate, agent)] = AgentSpec(make, parameters, compiled.costs_ms[agent] * 1e-3)
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


NAMES = ("scipy_openblas_{}64_", "scipy_openblas_{}", "openblas_{}64_", "openblas_{}")


@contextmanager
def one_thread_inside(opencv: bool) -> Iterator[None]:
    """While entered, NumPy's matrix products use one thread each, and so do, with `opencv`, its functions.

    The last bits of a matrix product depend on the number of its threads. Workers have one, and so the engine
    must, for the same bytes; none of OpenCV's functions that are used here depends on it.
    """
    import cv2

    blas = _blas()
    thread_counts = cv2.getNumThreads(), [get() for get, _ in blas]
    if opencv:
        cv2.setNumThreads(1)
    for _, set_threads in blas:
        set_threads(1)
    try:
        yield
    finally:
        if opencv:
            cv2.setNumThreads(thread_counts[0])
        for (_, set_threads), threads in zip(blas, thread_counts[1], strict=True):
            set_threads(threads)


@cache
def _blas() -> list[tuple[Any, Any]]:
    """Functions that get and set the number of threads of each OpenBLAS in the wheels of NumPy and SciPy."""
    site = Path(np.__file__).parent.parent
    functions = []
    for package in ("numpy", "scipy"):
        if package not in sys.modules:
            continue
        for file in sorted((site / f"{package}.libs").glob("*openblas*")):
            try:
                library = ctypes.CDLL(str(file))
            except OSError:
                continue
            for name in NAMES:
                get = getattr(library, name.format("get_num_threads"), None)
                set_threads = getattr(library, name.format("set_num_threads"), None)
                if get is not None and set_threads is not None:
                    functions.append((get, set_threads))
                    break
    return functions


NO_PLACES: Mapping[str, Place] = MappingProxyType({})
RETRIES = 2
"""How often an agent whose worker was lost is asked again, where frames wait for it."""


class Executing:
    """An executor for a run: entered it is ready, left it has nothing running any more.

    Attributes:
        kind: its name.
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
    ) -> None:
        self.kind, self.workers = kind, workers
        self.processes: Processes | None = None
        self._default, self._places, self._limits = default, places, limits
        self._retries, self._cues = retries, cues
        self._open = ExitStack()

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
        return self.kind == "serial"

    def engine(self, engine: Engine, retries: int = RETRIES) -> Engine:
        """`engine` with its agents placed, to be run while this is entered; once.

        `retries` holds where the executor was made without a number of its own.

        Raises:
            PlacingError: an agent cannot be where it was put.
        """
        places = places_of(engine, self._default, self._places, self._cues)
        specs = agent_specs(engine, places, self._cues)
        if specs:
            if not has_workers():
                raise PlacingError(no_workers())
            attempts = retries if self._retries is None else self._retries
            transport = self.processes = Processes(specs, self.workers, self._limits, attempts)
            self._open.callback(transport.close)
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

    Raises:
        ValueError: there is no such executor, or `workers` is less than 1.
    """
    if kind not in EXECUTORS:
        raise ValueError(f"executor {kind!r}; there are {', '.join(EXECUTORS)}")
    number = os.cpu_count() or 1 if workers is None else workers
    if number < 1:
        raise ValueError(f"{number} workers: at least 1 is needed")
    return Executing(kind, number, EXECUTORS[kind], places, limits, retries, cues)
