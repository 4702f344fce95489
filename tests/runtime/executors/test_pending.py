"""A question that time does not wait for has a moment by which its answer is needed."""

from __future__ import annotations

from bayesnet_track.runtime.executors.messages import CueCall
from bayesnet_track.runtime.executors.processes import Pending
from bayesnet_track.runtime.pace import WaitBudget


def test_an_answer_is_needed_in_time_only_where_there_is_a_budget():
    asked = CueCall("hue", "log_likelihood", None, None, ())
    assert Pending(asked, None).until_from(5.0) is None
    assert Pending(asked, WaitBudget(10.8, 0.5)).until_from(10.0) == 10.5
