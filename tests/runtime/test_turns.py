"""One tracker in several threads: refused, with both named, and nothing is lost by it."""

from __future__ import annotations

import copy
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from bayesnet_track import DetectionsTracker, Tracker
from bayesnet_track.runtime.frame_clock import Standing
from bayesnet_track.runtime.storing import Turns

BOXES = SimpleNamespace(xyxy=[[20, 100, 60, 200]])
IMAGE = np.random.default_rng(0).integers(0, 255, (240, 320, 3), np.uint8)


def meet(tracker, monkeypatch, module, call):
    """What a second thread gets while the first one is in the engine."""
    inside, go_on, raised = threading.Event(), threading.Event(), []
    usual = module.step

    def step(*given):
        inside.set()
        assert go_on.wait(30)
        return usual(*given)

    monkeypatch.setattr(module, "step", step)

    def second():
        try:
            call()
        except RuntimeError as error:
            raised.append(str(error))

    def first():
        tracker.update(BOXES) if isinstance(tracker, DetectionsTracker) else tracker.update(IMAGE)

    one = threading.Thread(target=first, name="camera 1")
    one.start()
    assert inside.wait(30)
    two = threading.Thread(target=second, name="camera 2")
    two.start(), two.join(30)
    go_on.set(), one.join(30)
    monkeypatch.setattr(module, "step", usual)
    return raised


@pytest.mark.parametrize("call", ["update", "reset"])
def test_a_second_thread_is_refused_by_a_detections_tracker(monkeypatch, call):
    from bayesnet_track.runtime import detections_tracker as module

    tracker, alone = DetectionsTracker(size=(320, 240)), DetectionsTracker(size=(320, 240))
    for one in (tracker, tracker, alone, alone, alone):
        one.update(BOXES)
    given = [BOXES] if call == "update" else []
    raised = meet(tracker, monkeypatch, module, lambda: getattr(tracker, call)(*given))
    assert raised and raised[0].startswith(
        f"{call} in thread 'camera 2' while thread 'camera 1' is in update of the same DetectionsTracker"
    )
    assert tracker.update(BOXES).tracker_id.tolist() == alone.update(BOXES).tracker_id.tolist() == [1]
    assert repr(tracker) == repr(alone)  # the frame of the first thread counts, that of the second does not


@pytest.mark.parametrize("call", ["update", "init"])
def test_a_second_thread_is_refused_by_a_tracker(monkeypatch, call):
    from bayesnet_track.runtime import tracker as module

    tracker, read = Tracker("two_squares"), []
    tracker.init(IMAGE, (100, 100, 30, 30))
    given = [IMAGE] if call == "update" else [IMAGE, (10, 10, 30, 30)]

    def call_it():
        assert isinstance(tracker._now, Standing)  # who only reads sees one whole frame, the last
        read.extend((tracker.metrics.frame, int(tracker.detections().data["frame"][0]), tracker.predict()))
        getattr(tracker, call)(*given)

    raised = meet(tracker, monkeypatch, module, call_it)
    assert read[:2] == [0, 0] and len(read[2]) == 1
    assert raised and raised[0].startswith(
        f"{call} in thread 'camera 2' while thread 'camera 1' is in update"
    )
    assert tracker.metrics.frame == 1
    tracker.update(IMAGE)
    assert tracker.metrics.frame == 2


def test_threads_may_take_turns_and_a_copy_has_its_own():
    trackers = [DetectionsTracker(size=(320, 240), seed=1)]
    trackers.append(copy.copy(trackers[0]))
    threads = [
        threading.Thread(target=lambda one=one: [one.update(BOXES) for _ in range(20)]) for one in trackers
    ]
    [thread.start() for thread in threads], [thread.join(60) for thread in threads]
    assert [one.update(BOXES).tracker_id.tolist() for one in trackers] == [[1], [1]]
    for _ in range(3):
        thread = threading.Thread(target=trackers[0].update, args=(BOXES,))
        thread.start(), thread.join(60)
    assert ", 24 frames," in repr(trackers[0])


def test_an_error_ends_a_turn_and_a_call_within_a_call_is_refused():
    turns = Turns("Tracker")
    with pytest.raises(KeyError), turns.take("update"):
        raise KeyError
    refused = pytest.raises(RuntimeError, match="while thread 'MainThread' is in update")
    with turns.take("update"), refused, turns.take("init"):
        pass
