"""Every event of the journal. The docstrings of their classes are the documentation of the file format.

A line of ``journal.jsonl`` is ``{"event": <snake_case class name>, <field>: <value>, ...}``, keys in the
order of the class. Each module of this folder has the events of one subject. An event has its sentence, as
`describe`; a decision has what it does to the net of its target, as `change`; a switch has its word for a
summary, as `shorten`. mypy names a class of the union that lacks one.
"""

from __future__ import annotations

from bayesnet_track.journal.events import (
    beliefs,
    births,
    by_hand,
    distractors,
    faults,
    flaws,
    guarantees,
    joint_beliefs,
    jumps,
    modes,
    references,
    runs,
    sample_sizes,
    sources,
    statuses,
)
from bayesnet_track.journal.net.net import Decision

Event = (
    runs.RunStarted
    | sources.FramesMissing
    | sources.FrameSizeChanged
    | sources.SourceDamaged
    | runs.MachineChanged
    | sources.Events
    | beliefs.Events
    | sample_sizes.Events
    | jumps.Events
    | modes.Events
    | references.Events
    | distractors.Events
    | guarantees.Events
    | statuses.FoundAgain
    | births.Events
    | faults.Events
    | by_hand.Events
    | flaws.Events
    | joint_beliefs.Events
    | runs.Events
    | Decision
)
