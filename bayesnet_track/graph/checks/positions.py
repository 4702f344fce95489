"""The check of where agents work."""

from __future__ import annotations

from collections.abc import Iterator

from bayesnet_track.graph.checks.plates import Check, Plate
from bayesnet_track.graph.text.messages import GraphMessage


def what_cannot_be_sent_stays(plate: Plate) -> Iterator[GraphMessage]:
    """A cue whose state cannot be stored cannot be sent to a worker process, either."""
    for name, node in plate.agents.items():
        declaration = plate.cues.get(node.agent.cue)
        if node.on == "process" and declaration is not None and declaration.opaque:
            found = f"{node.agent.cue} keeps what cannot be sent to another process"
            yield plate.message(name, found, "on: engine, or no such key", key=("on",))


PLACE_CHECKS: tuple[Check, ...] = (what_cannot_be_sent_stays,)
