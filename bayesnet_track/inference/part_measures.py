"""Measure the parts of a target: estimates, whether they are seen, how fast their agents may learn."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from bayesnet_track.adapt.rule_inputs import PartMeasure, PartStatus
from bayesnet_track.belief.contract import Evidence
from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.graph.spec import Learn
from bayesnet_track.inference.learn import learning_rate
from bayesnet_track.inference.parts import PartBelief, part_of_agents
from bayesnet_track.numerics.arrays import Floats


def measure_parts(
    target: CheckedTarget,
    evidence: Evidence,
    beliefs: Mapping[str, PartBelief],
    ud_px2: Mapping[str, float],
) -> dict[str, PartMeasure]:
    """Part -> its measures; `ud_px2` holds the UD of every inference node."""
    part_of = part_of_agents(target) if beliefs else {}
    found: dict[str, PartMeasure] = {}
    for part, belief in beliefs.items():
        own = [agent for agent in target.agents if part_of.get(agent) == part and agent in evidence.messages]
        status = _status(target, evidence, own, belief.weights.weights)
        found[part] = PartMeasure(belief.mean, belief.sd, ud_px2[part], status)
    return found


def _status(target: CheckedTarget, evidence: Evidence, agents: list[str], weights: Floats) -> PartStatus:
    """Seen when the likelihood of the belief, its geometric mean over draws and agents, is high enough."""
    seeing = [agent for agent in agents if evidence.measured.get(agent, evidence) is not None]
    if not seeing:
        return "hidden" if agents else "unwatched"
    kept = weights > 0
    fits = [float(weights[kept] @ evidence.messages[agent][kept]) for agent in seeing]
    lost = target.lost
    return "seen" if np.exp(np.mean(fits)) >= lost.fit_below else "hidden"


def part_rates(
    rule: Learn | None, parts: Mapping[str, PartMeasure], quiet_of: Callable[[str], float | None]
) -> dict[str, float]:
    """Part -> share of the largest learning rate: the root's rule at the part's own UD, 0 unless it is seen.

    `quiet_of` gives the measured baseline of a node's UD, px^2.
    """
    return {
        name: learning_rate(rule, part.ud_px2, part.area_px2, quiet_of(name))
        if part.status == "seen"
        else 0.0
        for name, part in parts.items()
    }
