"""Places of agents: in the engine's process, or at work in another, asked as any cue is."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.engine.step import Engine
from bayesnet_track.numerics.arrays import Array, Floats
from bayesnet_track.observation.cue import AnyCue, CueDeclaration, Hypotheses, Measurement, Reference
from bayesnet_track.observation.planes import Frame, FramePair, Plane, Planes, Region
from bayesnet_track.observation.settings import to_caller
from bayesnet_track.runtime.executors.messages import LEARN_AND_BLEND, Call
from bayesnet_track.runtime.executors.processes import PlacingError
from bayesnet_track.runtime.executors.worker_pool import AgentSpec


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
        where: NDArray[np.object_] = np.empty(2, dtype=object)
        # The older one first: it lies there already, and must not be overwritten by the newer.
        where[1] = None if frames.previous is None else self.transport.send_frame(frames.previous)
        where[0] = self.transport.send_frame(frames.current)
        return where


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
        asked = self._blending(*arguments) if method == "blend" else (method, *arguments)
        return self.transport.begin(self._call(asked[0], asked[1], asked[2:]))

    def learn(self, planes: Planes, box: Floats) -> Reference:
        """Learn like a `Cue`."""
        return Learnt(self, "learn", planes, (box,))

    def blend(self, old: Reference, new: Reference, rate: float) -> Reference:
        """Blend like a `Cue`; a reference that was learnt just now is learnt and blended at once."""
        blended: Reference = self.ask(*self._blending(old, new, rate))
        return blended

    def _call(self, method: str, planes: Planes | None, arguments: tuple[Any, ...]) -> Call:
        # Before the transport is busy with this question: what was learnt may have to be asked for.
        known = tuple([dict(part) if type(part) is Learnt else part for part in arguments])
        if planes is None:
            return Call(self.agent, method, None, None, known)
        current, previous = planes[self.sent]
        return Call(self.agent, method, (current, previous), planes.region, known)

    def _blending(self, old: Reference, new: Reference, rate: float) -> tuple[Any, ...]:
        if isinstance(new, Learnt) and new.of is self and new.planes is not None:
            return LEARN_AND_BLEND, new.planes, new.method, old, rate, *new.arguments
        return "blend", None, old, new, rate


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
    own = {name: method for name, method in FURTHER.items() if hasattr(cue, name)}
    if hasattr(cue, "rule"):
        own["rule"] = cue.rule
    from bayesnet_track.observation.cue import context_of

    kind = type("Placed" + type(cue).__name__, (Placed,), own)
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
        agent, _, where = text.partition("=")
        found = next((place for place in PLACES if place == where), None)
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
    found: dict[tuple[str, str], Place] = {}
    unused = set(wanted)
    for plate, compiled in engine.plates.items():
        for agent in compiled.cues:
            node = compiled.plate.agent(agent)
            own = next((name for name in (f"{plate}.{agent}", agent) if name in wanted), None)
            unused -= {f"{plate}.{agent}", agent}
            place = node.on if own is None else wanted[own]
            if declarations[node.agent.cue].opaque:
                if place == "process":
                    raise PlacingError(
                        f"agent {agent} cannot be in a process: {node.agent.cue} keeps what cannot be sent"
                    )
                place = "engine"
            found[plate, agent] = place or default
    if unused:
        agents = dict.fromkeys(agent for _, agent in found)
        raise PlacingError(f"no agent {sorted(unused)[0]!r}; the graph has {', '.join(agents)}")
    return found


def agent_specs(
    engine: Engine,
    places: Mapping[tuple[str, str], Place],
    cues: Mapping[str, CueDeclaration] | None = None,
) -> dict[str, AgentSpec]:
    """Name of every agent that works in a process -> how its cue is made there."""
    declarations = _declarations(engine, cues)
    found = {}
    for (plate, agent), place in places.items():
        if place == "process":
            compiled = engine.plates[plate]
            make = declarations[compiled.plate.agent(agent).agent.cue].make
            parameters = compiled.plate.parameters[agent]
            found[_name(plate, agent)] = AgentSpec(make, parameters, compiled.costs_ms[agent] * 1e-3)
    return found


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
    return {one.name: one for compiled in engine.plates.values() for one in compiled.declared.values()}
