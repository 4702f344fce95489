"""Targets by type and number: "ball 1" where a sentence of the journal says "target 1"."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from bayesnet_track.journal.events.births import TargetStarted
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.reidentification import Returned
from bayesnet_track.journal.text.sentences import explain

_STARTS = re.compile(r"\btarget (\d+) starts as \w+, ")
_TARGET = re.compile(r"\btarget (\d+)\b")


def kinds_of(events: Iterable[Event]) -> dict[str, str]:
    """Target id -> its type, the name of its class of targets in the graph."""
    return {event.target: event.template for event in events if isinstance(event, TargetStarted | Returned)}


def name_targets(text: str, kinds: Mapping[str, str]) -> str:
    """The text with the type of each target in place of the word target, where it is known.

    >>> name_targets("frame 9: target 1 lost", {"1": "ball"})
    'frame 9: ball 1 lost'
    """

    def name(number: str) -> str:
        return f"{kinds.get(number, 'target')} {number}"

    text = _STARTS.sub(lambda found: f"{name(found[1])} starts, ", text)
    return _TARGET.sub(lambda found: name(found[1]), text)


def narrate(event: Event, kinds: Mapping[str, str], name_target: bool = False) -> str:
    """The sentence of an event, its targets by type and number."""
    return name_targets(explain(event, name_target), kinds)
