"""Reference updates: references move toward the estimate while UD is low (thesis eqs. 2.15-2.16)."""

from __future__ import annotations

import math
from collections.abc import Mapping

from bayesnet_track.adapt.rules import read_level
from bayesnet_track.cue import Cue, Floats, Reference
from bayesnet_track.graph.spec import Learn
from bayesnet_track.planes import PlaneCache, region_of_boxes

CONTEXT = 1.0
"""A reference may look this many box sizes beyond each side of the box."""


def learning_rate(rule: Learn | None, ud_px2: float, area_px2: float, quiet_px2: float | None) -> float:
    """Share of the largest rate at this UD: (1 - tanh(2 (UD - theta) / theta)) / 2, 0 from theta upward.

    Thesis eq. 2.16. As printed it applies to every target whose UD is below theta and replaces more than half
    of the reference there, so `learn_references` multiplies it by a largest rate (corrected).

    >>> from bayesnet_track.graph.spec import Learn, Level
    >>> rule = Learn(below=Level(ud_px2=100.0))
    >>> round(learning_rate(rule, 50.0, 1.0, None), 4), learning_rate(rule, 100.0, 1.0, None)
    (0.8808, 0.0)
    """
    reading = None if rule is None else read_level(rule.below, ud_px2, area_px2, quiet_px2)
    if reading is None or reading.value >= reading.level:
        return 0.0
    return 0.5 * (1.0 - math.tanh(2.0 * (reading.value - reading.level) / reading.level))


def learn_first(cues: Mapping[str, Cue], cache: PlaneCache, box: Floats) -> dict[str, Reference]:
    """Every agent's first reference, from the centre box (4,)."""
    region = region_of_boxes(box[None, :], grow=CONTEXT)
    return {agent: cue.learn(cache.planes(cue.needs, region), box) for agent, cue in cues.items()}


def learn_references(
    references: Mapping[str, Reference],
    cues: Mapping[str, Cue],
    rates: Mapping[str, float],
    cache: PlaneCache,
    box: Floats,
) -> dict[str, Reference]:
    """The references of all agents, active or not, each moved by its rate toward what the box holds now.

    Planes of inactive agents are computed here only, on the estimate's surroundings.
    """
    region = region_of_boxes(box[None, :], grow=CONTEXT)
    moved = dict(references)
    for agent, rate in rates.items():
        if rate > 0.0:
            cue = cues[agent]
            seen = cue.learn(cache.planes(cue.needs, region), box)
            moved[agent] = cue.blend(references[agent], seen, rate)
    return moved
