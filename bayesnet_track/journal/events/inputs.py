"""What came from outside while a run went on: the lines of ``inputs.jsonl``.

A run is a function of graph, source, starts, seed and these. Each has the frame with which the engine is
given it, so that the same lines give the same run again.
"""

from __future__ import annotations

from bayesnet_track.journal.events.by_hand import Released, Toggled
from bayesnet_track.journal.events.faults import AgentMissed
from bayesnet_track.journal.events.load import LateFrame, SpareTime

Input = Toggled | Released | AgentMissed | LateFrame | SpareTime
"""A line of ``inputs.jsonl``."""
