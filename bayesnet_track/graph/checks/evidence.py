"""The check that evidence reaches a node by one path only: no pixels are counted twice."""

from __future__ import annotations

from collections.abc import Iterator

from pydantic import ValidationError

from bayesnet_track.graph.checks.cues import cue_parameters
from bayesnet_track.graph.checks.plates import Plate
from bayesnet_track.graph.text.messages import GraphMessage

Evidence = tuple[str, str]
"""A cue and its parameters: what an agent reads of the pixels."""

Box = tuple[float, float, float, float]
ELSEWHERE = 1e6
WHOLE: Box = (0.0, 0.0, 1.0, 1.0)
"""The target's own box: centre, width and height in its own."""

SHARED = 0.5
"""Share of the smaller of two boxes from which on they hold the same pixels."""


def evidence_counts_once(plate: Plate) -> Iterator[GraphMessage]:
    """Two agents that compute the same are not multiplied, which would count it twice; a pool may hold them.

    For a sound tree. Thesis 2.6: colour is counted once by a node of its own. Agents that look at parts of
    the target compute the same where half of one part lies in the other.
    """
    boxes = _boxes(plate)
    reached: dict[str, dict[Evidence, list[str]]] = {name: {} for name in plate.order}
    for name in reversed(plate.order):
        if name in plate.agents:
            evidence = _evidence(plate, name)
            if evidence is not None:
                reached[name] = {evidence: [name]}
            continue
        fuse = plate.inference[name].fuse
        here = reached[name]
        for child in plate.children[name]:
            pairs = [(evidence, agent) for evidence, below in reached.pop(child).items() for agent in below]
            for evidence, agent in pairs:
                others = here.setdefault(evidence, [])
                first = next((one for one in others if _share_pixels(boxes[one], boxes[agent])), None)
                if first is None:
                    others.append(agent)
                elif fuse is None or fuse.pool is None:
                    found = f"the same evidence as {first!r}: {evidence[0]} counts twice in {name!r}"
                    advice = "both under one node with fuse: pool, or different parameters"
                    yield plate.message(agent, found, advice, key=("agent",))


def _boxes(plate: Plate) -> dict[str | None, Box]:
    """Node -> the box that it is about, in the target's own."""
    boxes: dict[str | None, Box] = {None: WHOLE}
    for name in plate.order:
        x, y, w, h = boxes[plate.spec.nodes[name].parent]
        fuse = plate.inference[name].fuse if name in plate.inference else None
        if fuse is not None and fuse.latent is not None:
            at, size = fuse.latent.given.offset_box, fuse.latent.given.size_box
            if fuse.latent.given.written:  # where it is, is not known here: it shares no pixels with another
                x += ELSEWHERE * len(boxes)
            x, y = (x, y) if at is None else (x + at.x * w, y + at.y * h)
            w, h = (w, h) if size is None else (w * size.w, h * size.h)
        boxes[name] = (x, y, w, h)
    return boxes


def _share_pixels(one: Box, other: Box) -> bool:
    """At least the share `SHARED` of the smaller box lies in the other."""
    sides = [
        min(one[k] + one[k + 2] / 2, other[k] + other[k + 2] / 2)
        - max(one[k] - one[k + 2] / 2, other[k] - other[k + 2] / 2)
        for k in (0, 1)
    ]
    common = max(sides[0], 0.0) * max(sides[1], 0.0)
    return common >= SHARED * min(one[2] * one[3], other[2] * other[3])


def _evidence(plate: Plate, agent: str) -> Evidence | None:
    choice = plate.agents[agent].agent
    if choice.cue not in plate.cues:
        return None
    try:
        return choice.cue, cue_parameters(choice, plate.cues[choice.cue]).model_dump_json()
    except ValidationError:
        return None
