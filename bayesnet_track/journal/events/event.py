"""Every event of the journal, and every input from outside.

A line of ``journal.jsonl`` is ``{"event": <snake_case class name>, <field>: <value>, ...}``, keys in the
order of the class. Each module of this folder has the events of one subject. An event has its sentence, as
`describe`; a decision has what it does to the net of its target, as `change`; a switch has its word for a
summary, as `shorten`. A test names a class with a sentence that is not listed here; mypy names a listed class
without one.

A run is a function of graph, source, starts, seed and the lines of ``inputs.jsonl``. Each has the frame with
which the engine is given it, so that the same lines give the same run again.
"""

from __future__ import annotations

from bayesnet_track.journal.events import (
    beliefs,
    cameras,
    faults,
    joins,
    lives,
    load,
    runs,
    statuses,
    switches,
)
from bayesnet_track.journal.events.faults import AgentMissed
from bayesnet_track.journal.events.load import LateFrame, Released, SpareTime, Toggled
from bayesnet_track.journal.net import Decision

Input = Toggled | Released | AgentMissed | LateFrame | SpareTime
"""A line of ``inputs.jsonl``."""

Event = (
    runs.RunStarted
    | runs.FramesMissing
    | runs.FrameSizeChanged
    | runs.SourceDamaged
    | runs.MachineChanged
    | runs.FramesDropped
    | runs.SourceStalled
    | beliefs.DegenerateBelief
    | beliefs.BeliefReset
    | beliefs.MeasurementGated
    | beliefs.ParticlesResized
    | beliefs.SecondPass
    | beliefs.Reappeared
    | beliefs.ModeChanged
    | beliefs.QueryPassed
    | cameras.ClockLearnt
    | cameras.CameraKnocked
    | cameras.CamerasSwitched
    | switches.ReferenceGuarded
    | statuses.IdentityDoubtful
    | statuses.DistractorSeen
    | statuses.DoubtEnded
    | statuses.AssuranceChanged
    | statuses.AlarmRaised
    | statuses.AlarmEnded
    | statuses.FoundAgain
    | statuses.Regained
    | lives.CandidateConfirmed
    | lives.BirthsRefused
    | joins.DetectionRefused
    | lives.DetectorFailed
    | lives.DetectionsCut
    | faults.AgentMissed
    | faults.VerifierFailed
    | load.InputRefused
    | faults.FactorFlawed
    | faults.MotionFlawed
    | faults.FlawEnded
    | faults.PairFactorChanged
    | joins.OcclusionChanged
    | joins.AttachmentChanged
    | joins.RingChanged
    | runs.RunEnded
    | Decision
)
