"""What agents say of boxes on another target: together, to the same bytes as one by one."""

import numpy as np
import pytest

import bayesnet_track.engine.rows.on_others as on_others
from bayesnet_track.engine.filtering import filter_target
from bayesnet_track.engine.frame_context import FrameContext
from bayesnet_track.engine.rows.filtered_rows import FilteredTargets
from bayesnet_track.engine.rows.particle_rows import filter_rows
from bayesnet_track.observation.planes import FramePair, PlaneCache
from tests.engine.test_particle_rows import frame, started

NEIGHBOURS = {"1": ["2", "3"], "2": ["1"], "3": ["1"]}


@pytest.fixture
def work_and_targets():
    engine, state = started()
    work = FrameContext(engine, state.net, PlaneCache(FramePair(frame(1), None)), state.history.births)
    alone = {target: filter_target(work, target, one) for target, one in state.targets.items()}
    return (
        work,
        FilteredTargets(filter_rows(work, state.targets), {}, [*alone]),
        FilteredTargets([], alone, [*alone]),
    )


def _fail(work, group, hypotheses, starts):
    return {"color": np.zeros(len(hypotheses))}, {row: {} for row in range(len(starts) - 1)}


def test_they_are_asked_together_with_the_answers_of_each_alone(work_and_targets, monkeypatch):
    work, targets, alone = work_and_targets
    monkeypatch.setattr(on_others, "_ask", None)
    together = on_others.logs_on(work, NEIGHBOURS, targets)
    assert {name: list(found) for name, found in together.items()} == NEIGHBOURS
    assert all(log < 0 for found in together.values() for log in found.values())
    monkeypatch.undo()
    monkeypatch.setattr(on_others, "ask_together", _fail)
    assert on_others.logs_on(work, NEIGHBOURS, targets) == together
    monkeypatch.setattr(on_others, "_ask_together", None)
    assert on_others.logs_on(work, NEIGHBOURS, alone) == together
