"""What agents say of boxes on another target: together, to the same bytes as one by one."""

import pytest

import bayesnet_track.engine.rows.on_others as on_others
from bayesnet_track.engine.filtering import filter_target
from bayesnet_track.engine.frame_work import FrameWork
from bayesnet_track.observation.planes import FramePair, PlaneCache
from tests.engine.test_particle_rows import frame, started

NEIGHBOURS = {"1": ["2", "3"], "2": ["1"], "3": ["1"]}


@pytest.fixture
def work_and_targets():
    engine, state = started()
    work = FrameWork(engine, state.net, PlaneCache(FramePair(frame(1), None)))
    return work, {target: filter_target(work, target, one) for target, one in state.targets.items()}


def test_they_are_asked_together_with_the_answers_of_each_alone(work_and_targets, monkeypatch):
    work, targets = work_and_targets
    monkeypatch.setattr(on_others, "_ask", None)
    together = on_others.logs_on(work, NEIGHBOURS, targets)
    assert {name: list(found) for name, found in together.items()} == NEIGHBOURS
    assert all(log < 0 for found in together.values() for log in found.values())
    monkeypatch.undo()
    monkeypatch.setattr(on_others, "ask_together", lambda *asked: None)  # as where an agent fails
    assert on_others.logs_on(work, NEIGHBOURS, targets) == together
    monkeypatch.setattr(on_others, "asks_together", lambda *asked: False)
    assert on_others.logs_on(work, NEIGHBOURS, targets) == together
