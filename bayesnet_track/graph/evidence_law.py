"""The law that evidence reaches a node by one path only: no pixels are counted twice."""

from __future__ import annotations

from collections.abc import Iterator

from pydantic import ValidationError

from bayesnet_track.graph.cue_laws import cue_parameters
from bayesnet_track.graph.messages import GraphMessage
from bayesnet_track.graph.plate import Plate

Evidence = tuple[str, str]
"""A cue and its parameters: what an agent reads of the pixels."""


def evidence_counts_once(plate: Plate) -> Iterator[GraphMessage]:
    """Two agents that compute the same do not meet in a product; in a pool their weights share it.

    For a sound tree. Thesis 2.6: colour is counted once by a node of its own.
    """
    reached: dict[str, dict[Evidence, str]] = {name: {} for name in plate.order}
    for name in reversed(plate.order):
        if name in plate.agents:
            evidence = _evidence(plate, name)
            if evidence is not None:
                reached[name] = {evidence: name}
            continue
        fuse = plate.inference[name].fuse
        here = reached[name]
        for child in plate.children[name]:
            for evidence, agent in reached.pop(child).items():
                first = here.setdefault(evidence, agent)
                if first != agent and (fuse is None or fuse.pool is None):
                    found = f"the same evidence as {first!r}: {evidence[0]} counts twice in {name!r}"
                    advice = "both under one node with fuse: pool, or different parameters"
                    yield plate.message(agent, found, advice, key=("agent",))


def _evidence(plate: Plate, agent: str) -> Evidence | None:
    choice = plate.agents[agent].agent
    if choice.cue not in plate.cues:
        return None
    try:
        return choice.cue, cue_parameters(choice, plate.cues[choice.cue]).model_dump_json()
    except ValidationError:
        return None
