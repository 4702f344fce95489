"""Where each agent of a graph works: in the engine's process or in a worker's."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Literal

from bayesnet_track.engine.step import Engine
from bayesnet_track.observation.cue import CueDeclaration
from bayesnet_track.observation.settings import to_caller
from bayesnet_track.runtime.executors.placing import SentFrames, Transport, make_proxy
from bayesnet_track.runtime.executors.processes import PlacingError
from bayesnet_track.runtime.executors.worker_pool import AgentSpec

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
