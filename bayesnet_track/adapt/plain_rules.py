"""The rules of a net in which only the target's status can change: those of `rules.decide`, in short."""

from __future__ import annotations

from functools import lru_cache

from bayesnet_track.adapt.conditions import scale_of
from bayesnet_track.adapt.measures import Measures
from bayesnet_track.adapt.memory import NO_STREAK, Memory, Quiet
from bayesnet_track.adapt.situation import active_below, quiet_level
from bayesnet_track.adapt.status import USUAL
from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.journal.net.target_net import TargetNet
from bayesnet_track.numerics.records import changed


@lru_cache(maxsize=64)
def has_plain_rules(plate: CheckedTarget) -> bool:
    """Whether all that a plate's rules decide, while its agents work, is its status by UD and fit."""
    root = plate.inference(plate.root)
    return (
        root.score is None
        and (root.lost or USUAL).existence_below is None
        and len(plate.children) == 1
        and root.adapt is None
        and all(plate.agent(agent).self_check is None for agent in plate.agents)
    )


def remember_plainly(
    plate: CheckedTarget, net: TargetNet, measures: Measures, memory: Memory, hidden: float
) -> Memory | None:
    """What the rules of such a plate remember after a frame; None where something may be decided.

    `hidden` is the share of the target that another one hides.
    """
    if not net.active or net.quarantined or memory.missed or memory.self_check or memory.worth:
        return None
    root, rule, ud = plate.root, plate.inference(plate.root).lost or USUAL, measures.ud_px2[plate.root]
    quiet = memory.quiet
    if net.status == "tracking":
        active = active_below(plate, net, root)
        quiet = {**quiet, root: quiet.get(root, Quiet()).seen(active, ud)} if active else quiet
    after = changed(memory, quiet=quiet, helpful=memory.counting(measures.contribution))
    baseline = quiet_level(plate, net, after, root) if rule.above.kind == "ud_baseline" else None
    scale = scale_of(rule.above, measures.area_px2, baseline)
    value = 0.0 if scale is None else ud / scale
    looks_lost = value > rule.above.settings or not (measures.fit >= rule.fit_below or hidden >= 0.5)
    if looks_lost or net.status == "lost":
        return None
    fields = {"lost": NO_STREAK, "unfit": NO_STREAK, "found": memory.found.then(True, value, rule.frames)}
    after.__dict__.update(fields)
    return after
