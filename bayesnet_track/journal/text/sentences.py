"""An event as a sentence: what changed, the numbers that caused it, at which threshold it would not have."""

from __future__ import annotations

from typing import assert_never

from bayesnet_track.journal.events import (
    beliefs,
    births,
    by_hand,
    distractors,
    endings,
    faults,
    flaws,
    guarantees,
    joins,
    joint_beliefs,
    jumps,
    load,
    modes,
    references,
    reidentification,
    runs,
    sample_sizes,
    self_checks,
    sources,
    statuses,
    switches,
)
from bayesnet_track.journal.events.event import Event


def explain(event: Event, name_target: bool = False) -> str:
    """One sentence for an event.

    UD stands in the unit of its threshold, with px² beside it where that is another unit. "Would have" names
    the threshold, rounded away from the one that was set, at which the rule would not have fired.
    `name_target` says whose net it was, for runs of several targets.

    >>> from bayesnet_track.journal.net.causes import Cause
    >>> cause = Cause("ud_px2", 200.0, 212.4, 3, 212.4, 212.4, 1.0)
    >>> explain(switches.Activated(29, "1", "motion", "square", cause))
    'frame 29: UD 212 px² > 200 for 3 frames → motion on; would have stayed off at activate ≥ 213'
    """
    sentence = describe(event)
    if isinstance(event, runs.RunStarted | runs.RunEnded):
        return sentence
    target = getattr(event, "target", None)
    whose = f", target {target}" if name_target and target and f"target {target}" not in sentence else ""
    return f"frame {event.frame}{whose}: {sentence}"


def describe(event: Event) -> str:
    """The sentence without the frame it happened in."""
    if isinstance(event, switches.Events):
        return switches.describe(event)
    if isinstance(event, statuses.Events):
        return statuses.describe(event)
    if isinstance(event, births.Events):
        return births.describe(event)
    if isinstance(event, endings.Events):
        return endings.describe(event)
    if isinstance(event, reidentification.Events):
        return reidentification.describe(event)
    if isinstance(event, self_checks.Events):
        return self_checks.describe(event)
    if isinstance(event, faults.Events):
        return faults.describe(event)
    if isinstance(event, by_hand.Events):
        return by_hand.describe(event)
    if isinstance(event, load.Events):
        return load.describe(event)
    if isinstance(event, joins.Events):
        return joins.describe(event)
    if isinstance(event, flaws.Events):
        return flaws.describe(event)
    if isinstance(event, joint_beliefs.Events):
        return joint_beliefs.describe(event)
    if isinstance(event, beliefs.Events):
        return beliefs.describe(event)
    if isinstance(event, sample_sizes.Events):
        return sample_sizes.describe(event)
    if isinstance(event, references.Events):
        return references.describe(event)
    if isinstance(event, distractors.Events):
        return distractors.describe(event)
    if isinstance(event, guarantees.Events):
        return guarantees.describe(event)
    if isinstance(event, jumps.Events):
        return jumps.describe(event)
    if isinstance(event, modes.Events):
        return modes.describe(event)
    if isinstance(event, sources.Events):
        return sources.describe(event)
    if isinstance(event, runs.Events):
        return runs.describe(event)
    assert_never(event)
