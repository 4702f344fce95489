"""Where each agent of a graph works: in the engine's process or in a worker's."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Literal

from bayesnet_track.cue import CueDeclaration, installed_cues
from bayesnet_track.engine import Engine
from bayesnet_track.runtime.executors.processes import Employed, PlacingError
from bayesnet_track.runtime.executors.proxy import Desk, SentFrames, placed

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
            raise PlacingError(f"--place {text!r}: AGENT=WHERE is needed, WHERE one of {', '.join(PLACES)}")
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
    for plate, machine in engine.machinery.items():
        for agent in machine.cues:
            node = machine.plate.agent(agent)
            own = next((name for name in (f"{plate}.{agent}", agent) if name in wanted), None)
            unused -= {f"{plate}.{agent}", agent}
            place = node.on if own is None else wanted[own]
            if declarations[node.agent.cue].opaque:
                if place == "process":
                    raise PlacingError(
                        f"agent {agent} cannot be in a process: {node.agent.cue} keeps what cannot be sent"
                    )
                place = "engine"
            found[plate, agent] = default if place is None else place
    if unused:
        agents = dict.fromkeys(agent for _, agent in found)
        raise PlacingError(f"no agent {sorted(unused)[0]!r}; the graph has {', '.join(agents)}")
    return found


def employed_of(
    engine: Engine,
    places: Mapping[tuple[str, str], Place],
    cues: Mapping[str, CueDeclaration] | None = None,
) -> dict[str, Employed]:
    """Name of every agent that works in a process -> how its cue is made there."""
    declarations = _declarations(engine, cues)
    found = {}
    for (plate, agent), place in places.items():
        if place == "process":
            machine = engine.machinery[plate]
            make = declarations[machine.plate.agent(agent).agent.cue].make
            parameters = machine.plate.parameters[agent]
            found[_name(plate, agent)] = Employed(make, parameters, machine.costs_ms[agent] * 1e-3)
    return found


def with_proxies(engine: Engine, places: Mapping[tuple[str, str], Place], desk: Desk) -> Engine:
    """The engine with a proxy in place of the cue of every agent that works in a process."""
    sent = SentFrames(desk)
    machinery = {}
    for plate, machine in engine.machinery.items():
        cues = {
            agent: placed(_name(plate, agent), cue, desk, sent) if places[plate, agent] == "process" else cue
            for agent, cue in machine.cues.items()
        }
        machinery[plate] = replace(machine, cues=cues)
    return replace(engine, machinery=machinery)


def _name(plate: str, agent: str) -> str:
    return f"{plate}.{agent}"


def _declarations(engine: Engine, cues: Mapping[str, CueDeclaration] | None) -> Mapping[str, CueDeclaration]:
    if cues is not None:
        return cues
    plates = [machine.plate for machine in engine.machinery.values()]
    return installed_cues(plate.agent(agent).agent.cue for plate in plates for agent in plate.agents)
