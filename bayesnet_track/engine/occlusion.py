"""Targets that others hide: when that is reported, and the likelihood that stands for pixels out of sight."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from bayesnet_track.adapt.joins import LEVEL_HIDDEN, JoinMemory, Level
from bayesnet_track.engine.filtering import Filtered
from bayesnet_track.engine.rows.filtered_rows import Together
from bayesnet_track.inference.factors import log_seen
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.joins import OcclusionChanged
from bayesnet_track.journal.metrics import JoinMetrics

HIDDEN, SEEN = 0.5, 0.3
"""Hidden share above which a target is reported as hidden, and at or below which to be seen again."""

DEEPEST = 20.0
"""Nats below the best hypothesis at which the worst one counts at most."""


def levels_of(known: Mapping[str, Level], of: Together) -> tuple[dict[str, Level], dict[str, Level]]:
    """Target -> its level with the agents that are active: as measured, else that of this very frame.

    Then those after this frame, were all targets seen in it.
    """
    before: dict[str, Level] = {}
    after: dict[str, Level] = {}
    for name in of:
        at = of.row(name)
        if at is None:
            active, middle, best = of[name].plan.active, *_half_way(*_extremes(of[name]))
        else:
            active, (middle, best) = at[0].plan.active, _half_way(*at[0].extremes[at[1]])
        level = known.get(name)
        if level is None or level.active != active:
            level = Level(active, middle, best, 0)
        before[name], after[name] = level, level.then(active, middle, best)
    return before, after


def _extremes(one: Filtered) -> tuple[float, float]:
    """Log-likelihood of the best hypothesis and of the worst."""
    log = log_seen(one.plan.factors, one.step.evidence)
    return float(log.max()), float(log.min())


def _half_way(best: float, worst: float) -> tuple[float, float]:
    """Log-likelihood half way between the best and the worst hypothesis, and that of the best."""
    return (best + max(worst - best, -DEEPEST) / 2, best) if math.isfinite(best) else (0.0, 0.0)


def levels_after(
    before: Mapping[str, Level],
    seen: Mapping[str, Level],
    metrics: Mapping[str, JoinMetrics],
    of: Together,
) -> dict[str, Level]:
    """The levels of all targets, those measured in this frame, in `seen`, that were seen."""
    after = dict(before)
    for name, level in seen.items():
        hidden = metrics[name].hidden if name in metrics else 0.0
        if hidden <= LEVEL_HIDDEN and not is_degenerate(of, name):
            after[name] = level
    return after


def is_degenerate(of: Together, name: str) -> bool:
    """True if a target's own evidence could not be used; never of one in a group."""
    return of.row(name) is None and of[name].step.degenerate is not None


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
