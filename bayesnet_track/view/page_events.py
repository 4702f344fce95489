"""The journal's events as the run page shows them: what happened, why, and what would have prevented it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

from bayesnet_track.journal.codec import event_name
from bayesnet_track.journal.events.births import TargetStarted
from bayesnet_track.journal.events.by_hand import Released, Toggled
from bayesnet_track.journal.events.endings import DuplicateEnded, TargetDied
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.joins import Joined, Parted
from bayesnet_track.journal.events.reidentification import Reacquired, Returned
from bayesnet_track.journal.events.runs import RunEnded, RunStarted
from bayesnet_track.journal.events.statuses import SceneCut, StatusChanged
from bayesnet_track.journal.net.net import Switch
from bayesnet_track.journal.switches import turns_on
from bayesnet_track.journal.text.folding import CallsFolded, fold
from bayesnet_track.journal.text.naming import kinds_of, name_targets
from bayesnet_track.journal.text.sentences import explain

LIVES = (TargetStarted, Returned, Reacquired, TargetDied, DuplicateEnded, Joined, Parted)
ARROW = " → "
_PREVENTED = re.compile(r"; (?=would (?:not )?have |not at )")
_FRAME = re.compile(r"^frame \d+(?:, target [^:]*)?: ")


def event_rows(events: Iterable[Event]) -> list[dict[str, Any]]:
    """`event_row` of every event that happened in a frame, in order."""
    every = list(events)
    kinds = kinds_of(every)
    return [
        _calls_row(one, kinds) if isinstance(one, CallsFolded) else event_row(one, kinds)
        for one in fold(every)
        if not isinstance(one, RunStarted | RunEnded)
    ]


def _calls_row(calls: CallsFolded, kinds: Mapping[str, str]) -> dict[str, Any]:
    """Runs of agents on call as one row."""
    told = name_targets(calls.describe(), kinds)
    return {
        "frame": calls.frame,
        "kind": "scheduled",
        "sort": "note",
        "what": told,
        "why": "",
        "unless": "",
        "target": calls.target,
    }


def event_row(event: Event, kinds: Mapping[str, str] = MappingProxyType({})) -> dict[str, Any]:
    """One event of a frame as plain data; `kinds` names targets by their type.

    Keys: `frame`; `target`, `other` and `node` where it has them; `kind`, its name in the journal; `sort`:
    switch (an agent on or off), life (of a target, or of a pair), status, or note (everything else); `on`:
    whether a switch turned the agent on; `status`: the new one; `what` happened, `why`, and what would have
    prevented it (`unless`), the pieces of its sentence, of which the last two may be empty.
    """
    sentence = name_targets(_FRAME.sub("", explain(event)), kinds)
    described, *prevented = _PREVENTED.split(sentence, maxsplit=1)
    why, arrow, what = described.partition(ARROW)
    row: dict[str, Any] = {
        "frame": getattr(event, "frame", 0),
        "kind": event_name(type(event)),
        "sort": _sort(event),
        "what": what if arrow else described,
        "why": why if arrow else "",
        "unless": prevented[0] if prevented else "",
    }
    if isinstance(event, TargetStarted):
        # Nothing caused it: the piece before the arrow is what happened.
        row |= {"what": f"{why} → {what}", "why": ""}
    if isinstance(event, Toggled):
        on = "on" if event.on else "off"
        row |= {
            "what": f"{event.node} {on} by hand",
            "why": "switched by hand; no rule switches it until it is released",
        }
    if isinstance(event, Released):
        row |= {"what": f"{event.node} given back to the rules", "why": ""}
    row |= {key: getattr(event, key) for key in ("target", "other", "node") if hasattr(event, key)}
    if isinstance(event, Switch):
        row["on"] = turns_on(event)
    if isinstance(event, StatusChanged):
        row["status"] = event.status
    if isinstance(event, SceneCut):
        row["status"] = "lost"
    return row


def _sort(event: Event) -> str:
    if isinstance(event, Switch):
        return "switch"
    if isinstance(event, (*LIVES, Released)):
        return "life"
    if isinstance(event, StatusChanged | SceneCut):
        return "status"
    return "note"
