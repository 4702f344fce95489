"""The rules of a net in which only the target's status can change: those of `rules.decide`, in short."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Protocol

from bayesnet_track.adapt.conditions import scale_of
from bayesnet_track.adapt.memory import NO_QUIET, NO_STREAK, Memory, find_medians
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


class Seen(Protocol):
    """What was measured of T targets: of each the root's UD and area, px^2, fit, and agent -> nats."""

    @property
    def uds(self) -> Sequence[float]: ...

    @property
    def areas(self) -> Sequence[float]: ...

    @property
    def fits(self) -> Sequence[float]: ...

    @property
    def contributions(self) -> Sequence[Mapping[str, float]]: ...


def remember_plainly(
    plate: CheckedTarget,
    nets: Sequence[TargetNet],
    seen: Seen,
    memories: Sequence[Memory],
    hidden: Sequence[float],
) -> list[Memory | None]:
    """What the rules of such a plate remember of targets after a frame; None where something may be decided.

    `hidden` are the shares of the targets that others hide.
    """
    root, rule = plate.root, plate.inference(plate.root).lost or USUAL
    found: list[Memory | None] = []
    for net, memory, ud, contribution in zip(nets, memories, seen.uds, seen.contributions, strict=True):
        if (
            net.status != "tracking"
            or not net.active
            or net.quarantined
            or memory.missed
            or memory.self_check
            or memory.worth
        ):
            found.append(None)
        else:
            active, quiet = active_below(plate, net, root), memory.quiet
            if active:
                quiet = {**quiet, root: quiet.get(root, NO_QUIET).seen(active, ud)}
            found.append(changed(memory, quiet=quiet, helpful=memory.counting(contribution)))
    find_medians(one.quiet[root] for one in found if one is not None and root in one.quiet)
    for k, (net, after, ud) in enumerate(zip(nets, found, seen.uds, strict=True)):
        if after is None:
            continue
        baseline = quiet_level(plate, net, after, root) if rule.above.kind == "ud_baseline" else None
        scale = scale_of(rule.above, seen.areas[k], baseline)
        value = 0.0 if scale is None else ud / scale
        if value > rule.above.settings or not (seen.fits[k] >= rule.fit_below or hidden[k] >= 0.5):
            found[k] = None
            continue
        streak = after.found.then(True, value, rule.frames)
        after.__dict__.update(lost=NO_STREAK, unfit=NO_STREAK, found=streak)
    return found
