"""An event as a sentence: what changed, the numbers that caused it, at which threshold it would not have."""

from __future__ import annotations

from bayesnet_track.journal.events import runs
from bayesnet_track.journal.events.event import Event


def explain(event: Event, name_target: bool = False) -> str:
    """One sentence for an event.

    UD stands in the unit of its threshold, with px² beside it where that is another unit. "Would have" names
    the threshold, rounded away from the one that was set, at which the rule would not have fired.
    `name_target` says whose net it was, for runs of several targets.

    >>> from bayesnet_track.journal.net.causes import Cause
    >>> from bayesnet_track.journal.events.switches import Activated
    >>> cause = Cause("ud_px2", 200.0, 212.4, 3, 212.4, 212.4, 1.0)
    >>> explain(Activated(29, "1", "motion", "square", cause))
    'frame 29: UD 212 px² > 200 for 3 frames → motion on; would have stayed off at activate ≥ 213'
    """
    sentence = event.describe()
    if isinstance(event, runs.RunStarted | runs.RunEnded):
        return sentence
    target = getattr(event, "target", None)
    whose = f", target {target}" if name_target and target and f"target {target}" not in sentence else ""
    return f"frame {event.frame}{whose}: {sentence}"
