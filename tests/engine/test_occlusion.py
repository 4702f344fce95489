"""When it is told that a target is hidden: above one half, and no longer from 0.3 downward."""

from __future__ import annotations

from bayesnet_track.adapt.joins import JoinMemory
from bayesnet_track.engine.joining import report_hidden
from bayesnet_track.journal.metrics import JoinMetrics


def test_a_target_is_told_to_be_hidden_once_and_to_be_seen_once():
    memory, events = JoinMemory(), []
    for frame, hidden in enumerate([0.4, 0.6, 0.4, 0.7, 0.3, 0.4]):
        metrics = {"1": JoinMetrics(("2",), hidden, "2", {"2": 0.25}, None, 10.0)}
        memory = report_hidden(frame, metrics, memory, events)
    assert [(one.frame, one.other, one.hidden, one.share) for one in events] == [
        (1, "2", True, 0.6),
        (4, "2", False, 0.3),
    ]
    assert memory.hidden == {}
