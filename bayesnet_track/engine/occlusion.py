"""Targets that others hide: when that is reported, and the likelihood that stands for pixels out of sight."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from bayesnet_track.adapt.joins import LEVEL_HIDDEN, JoinMemory, Level
from bayesnet_track.engine.filtering import Filtered
from bayesnet_track.inference.factors import log_seen
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.joint_beliefs import OcclusionChanged
from bayesnet_track.journal.metrics import JoinMetrics

HIDDEN, SEEN = 0.5, 0.3
"""Hidden share above which a target is reported as hidden, and at or below which to be seen again."""

DEEPEST = 20.0
"""Nats below the best hypothesis at which the worst one counts at most."""


def level_of(known: Level | None, one: Filtered) -> Level:
    """The level with the agents that are active: as measured, else that of this very frame."""
    if known is not None and known.active == one.plan.active:
        return known
    return Level(one.plan.active, *_half_way(one), 0)


def _half_way(one: Filtered) -> tuple[float, float]:
    """Log-likelihood half way between the best and the worst hypothesis, and that of the best."""
    log = log_seen(one.plan.factors, one.step.evidence)
    best = float(log.max())
    return (best + max(float(log.min()) - best, -DEEPEST) / 2, best) if np.isfinite(best) else (0.0, 0.0)


def levels_after(
    before: Mapping[str, Level],
    levels: Mapping[str, Level],
    metrics: Mapping[str, JoinMetrics],
    of: Mapping[str, Filtered],
) -> dict[str, Level]:
    """The levels of all targets, those measured in this frame that were seen."""
    after = dict(before)
    for name, one in of.items():
        hidden = metrics[name].hidden if name in metrics else 0.0
        if hidden <= LEVEL_HIDDEN and one.step.degenerate is None:
            after[name] = levels[name].then(one.plan.active, *_half_way(one))
    return after


def report_hidden(
    frame: int, metrics: Mapping[str, JoinMetrics], memory: JoinMemory, events: list[Event]
) -> JoinMemory:
    """Add to `events` which targets are hidden now, and which no longer are."""
    hidden = dict(memory.hidden)
    for name, one in metrics.items():
        if name not in hidden and one.hidden > HIDDEN:
            hidden[name] = (one.behind, frame)
            front = 1.0 - one.in_front[one.behind]
            events.append(OcclusionChanged(frame, name, one.behind, True, one.hidden, HIDDEN, front, 0))
        elif name in hidden and one.hidden <= SEEN:
            other, since = hidden.pop(name)
            front = 1.0 - one.in_front.get(other, 1.0)
            events.append(OcclusionChanged(frame, name, other, False, one.hidden, SEEN, front, frame - since))
    return replace(memory, hidden=hidden)
