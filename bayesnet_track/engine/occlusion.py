"""Targets that others hide: when that is reported."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from bayesnet_track.adapt.joins import JoinMemory
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.joint_beliefs import OcclusionChanged
from bayesnet_track.journal.metrics import JoinMetrics

HIDDEN, SEEN = 0.5, 0.3
"""Hidden share above which a target is reported as hidden, and at or below which to be seen again."""


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
