"""Which way a decision switches an agent."""

from __future__ import annotations

from bayesnet_track.journal.events.by_hand import Toggled
from bayesnet_track.journal.events.faults import Readmitted
from bayesnet_track.journal.events.load import TakenBack
from bayesnet_track.journal.events.switches import Activated
from bayesnet_track.journal.net.net import Switch


def turns_on(event: Switch) -> bool:
    """Whether the agent is on after it.

    >>> turns_on(Toggled(3, "1", "motion", False))
    False
    """
    if isinstance(event, Toggled | Readmitted):
        return event.on
    return isinstance(event, Activated | TakenBack)
