"""Targets that others hide: when that is reported, and the likelihood that stands for pixels out of sight."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from bayesnet_track.adapt.joins import LEVEL_HIDDEN, JoinMemory, Level
from bayesnet_track.engine.filtering import Filtered
from bayesnet_track.engine.rows.filtered_rows import FilteredTargets
from bayesnet_track.inference.factors import log_seen
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.joins import OcclusionChanged
from bayesnet_track.journal.metrics import JoinMetrics

HIDDEN, SEEN = 0.5, 0.3
"""Hidden share above which a target is reported as hidden, and at or below which to be seen again."""

DEEPEST = 20.0
"""Nats below the best hypothesis at which the worst one counts at most."""


def levels_of(
    remembered: Mapping[str, Level], filtered: FilteredTargets
) -> tuple[dict[str, Level], dict[str, Level]]:
    """Target -> its level with the agents that are active: as measured, else that of this very frame.

    Then those after this frame, were all targets seen in it.
    """
    levels: dict[str, Level] = {}
    updated: dict[str, Level] = {}
    for name in filtered:
        place = filtered.row(name)
        if place is None:
            active, middle, top = filtered[name].plan.active, *_half_way(*_extremes(filtered[name]))
        else:
            active, (middle, top) = place[0].plan.active, _half_way(*place[0].extremes[place[1]])
        level = remembered.get(name)
        if level is None or level.active != active:
            level = Level(active, middle, top, 0)
        levels[name], updated[name] = level, level.then(active, middle, top)
    return levels, updated


def _extremes(target: Filtered) -> tuple[float, float]:
    """Log-likelihood of the best hypothesis and of the worst."""
    log = log_seen(target.plan.factors, target.step.evidence)
    return float(log.max()), float(log.min())


def _half_way(top: float, worst: float) -> tuple[float, float]:
    """Log-likelihood half way between the best and the worst hypothesis, and that of the best."""
    return (top + max(worst - top, -DEEPEST) / 2, top) if math.isfinite(top) else (0.0, 0.0)


def levels_after(
    previous: Mapping[str, Level],
    measured: Mapping[str, Level],
    metrics: Mapping[str, JoinMetrics],
    filtered: FilteredTargets,
) -> dict[str, Level]:
    """The levels of all targets, those measured in this frame, in `measured`, that were seen."""
    levels = dict(previous)
    for name, level in measured.items():
        hidden = metrics[name].hidden if name in metrics else 0.0
        if hidden <= LEVEL_HIDDEN and not is_degenerate(filtered, name):
            levels[name] = level
    return levels


def is_degenerate(filtered: FilteredTargets, name: str) -> bool:
    """True if a target's own evidence could not be used; never of one in a group."""
    return filtered.row(name) is None and filtered[name].step.degenerate is not None


def report_hidden(
    frame: int, metrics: Mapping[str, JoinMetrics], memory: JoinMemory, events: list[Event]
) -> JoinMemory:
    """Add to `events` which targets are hidden now, and which no longer are."""
    hidden = dict(memory.hidden)
    for name, target in metrics.items():
        if name not in hidden and target.hidden > HIDDEN:
            hidden[name] = (target.behind, frame)
            front = 1.0 - target.in_front[target.behind]
            events.append(OcclusionChanged(frame, name, target.behind, True, target.hidden, HIDDEN, front, 0))
        elif name in hidden and target.hidden <= SEEN:
            front_target, first_frame = hidden.pop(name)
            front = 1.0 - target.in_front.get(front_target, 1.0)
            events.append(
                OcclusionChanged(
                    frame, name, front_target, False, target.hidden, SEEN, front, frame - first_frame
                )
            )
    return replace(memory, hidden=hidden)
