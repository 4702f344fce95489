"""Detections that come late, by `DetectionsTracker.update`: no order of arrival changes final steps."""

from __future__ import annotations

import copy
import json
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track import DetectionsTracker
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.runtime.storing import StoredError
from tests.engine.street import FPS, detections_of, noisy
from tests.engine.test_several_cameras import boxes_of, walk, write_graph

LAG = 0.2


def written(steps):
    """All that steps tell, as text with every digit."""
    lines = []
    for step in steps:
        ids = {
            str(name): getattr(part, "tracker_id", part).tolist()
            for name, part in (
                step.detections.items()
                if isinstance(step.detections, dict)
                else {"": step.detections}.items()
            )
            if part is not None
        }
        targets = [repr(vars_of(line)) for line in step.targets]
        lines.append(
            json.dumps([step.time_s, ids, targets, [repr(event) for event in step.events]], sort_keys=True)
        )
    return lines


def vars_of(line: FrameMetrics):
    return {
        name: np.asarray(value).tolist() if isinstance(value, np.ndarray) else value
        for name, value in ((name, getattr(line, name)) for name in line.__dataclass_fields__)
    }


def final_steps(tracker, arrivals):
    steps = []
    for time_s, detections in arrivals:
        tracker.update(detections, time_s=time_s)
        steps += tracker.settled()
    return written([*steps, *tracker.settled(end=True)])


def late(arrivals, rng, lag=LAG):
    """The arrivals in the order in which they come, each by up to the lag too late."""
    times = [time_s + rng.uniform(0.0, lag) for time_s, _ in arrivals]
    return [arrivals[k] for k in np.argsort(times, kind="stable")]


def crowd(count=14, seed=2):
    """Four people who cross, with misses, false detections and jitter, at uneven times."""
    rng = np.random.default_rng(seed)
    speeds = np.array([[60.0, 5], [-70, 0], [30, 40], [0, -45]])
    places = np.array([[40.0, 100], [500, 110], [200, 60], [330, 400]])
    arrivals = []
    for frame in range(count):
        time_s = 10.0 + frame / 25 + rng.uniform(0.0, 0.01)
        centres = places + (time_s - 10.0) * speeds + rng.normal(0.0, 1.5, (4, 2))
        centres = np.vstack([centres[rng.random(4) < 0.9], rng.uniform(20, 450, (rng.poisson(0.5), 2))])
        boxes = SimpleNamespace(
            xyxy=np.hstack([centres - (15, 30), centres + (15, 30)]), confidence=np.full(len(centres), 0.9)
        )
        arrivals.append((time_s, boxes))
    return arrivals


@cache
def crowd_in_order():
    return final_steps(DetectionsTracker(size=(640, 480), lag_s=LAG), crowd())


def room(count=14):
    """Two people before two cameras; each camera's detections come by themselves."""
    rng = np.random.default_rng(5)
    tracks = walk(count), walk(count, (2.0, 11.0), (-1.0, -0.5))
    arrivals = []
    for frame in range(count):
        for camera in ("south", "east") if frame % 2 == 0 else ("south",):
            boxes = np.vstack([noisy(boxes_of(camera, track[frame]), rng)[0] for track in tracks])
            arrivals.append((frame / FPS, {camera: detections_of(boxes)}))
    return arrivals


@given(st.integers(0, 2**31))
def test_a_crowd_is_the_same_in_any_order_of_arrival(seed):
    shuffled = late(crowd(), np.random.default_rng(seed))
    assert final_steps(DetectionsTracker(size=(640, 480), lag_s=LAG), shuffled) == crowd_in_order()
    assert len(crowd_in_order()) == len(shuffled)


@pytest.mark.parametrize("cost", [None, 0.7])
@pytest.mark.parametrize("learnt", [{}, {"bias_px": {"sd": 5}, "clock": {"offset_s": {"sd": 0.5}}}])
def test_cameras_that_come_apart_are_one_step(tmp_path, learnt, cost):
    path, arrivals = write_graph(tmp_path), room()
    graph = json.loads(path.read_text())
    graph["cameras"]["east"] |= learnt
    if cost is not None:  # the choice is made anew with what comes late
        graph["adapt"] = {"cost_per_step": cost}
    path.write_text(json.dumps(graph))
    together: dict[float, dict] = {}
    for time_s, detections in arrivals:
        together.setdefault(time_s, {}).update(detections)
    in_order = final_steps(DetectionsTracker(path, fps=FPS, lag_s=LAG), together.items())
    for seed in range(2):
        shuffled = late(arrivals, np.random.default_rng(seed))
        assert shuffled != arrivals
        assert final_steps(DetectionsTracker(path, fps=FPS, lag_s=LAG), shuffled) == in_order
    assert len(in_order) == len(together)


def test_a_tracker_without_lag_finds_the_same_in_order():
    arrivals = crowd()
    plain, lagged = DetectionsTracker(size=(640, 480)), DetectionsTracker(size=(640, 480), lag_s=LAG)
    steps = []
    for time_s, boxes in arrivals:
        marked = plain.update(boxes, time_s=time_s)
        assert (lagged.update(boxes, time_s=time_s).tracker_id == marked.tracker_id).all()
        assert list(map(vars_of, lagged.targets)) == list(map(vars_of, plain.targets))
        assert lagged.events == plain.events
        steps += lagged.settled()
        assert steps == [] or steps[-1].time_s < time_s - LAG
    assert plain.settled() == plain.settled(end=True) == []


def test_late_detections_are_given_their_own_targets():
    """What `update` gives of late boxes are the targets of their own time."""
    arrivals = crowd()
    tracker = DetectionsTracker(size=(640, 480), lag_s=LAG)
    for time_s, boxes in (*arrivals[:-3], arrivals[-1]):
        tracker.update(boxes, time_s=time_s)
    time_s, boxes = arrivals[-2]
    ids = tracker.update(boxes, time_s=time_s).tracker_id
    steps = {step.time_s: step for step in tracker.settled(end=True)}
    assert (ids == steps[time_s].detections.tracker_id).all()
    assert len(ids) == len(boxes.xyxy)
    assert (ids >= 0).any()


def test_what_is_final_or_twice_is_refused_and_changes_nothing(tmp_path):
    arrivals = crowd()
    tracker = DetectionsTracker(size=(640, 480), lag_s=0.1)
    for time_s, boxes in arrivals[:10]:
        tracker.update(boxes, time_s=time_s)
    before = list(map(vars_of, tracker.targets))
    with pytest.raises(ValueError, match=r"s before the latest time, .*final, since lag_s=0\.1: .*reset\(\)"):
        tracker.update(arrivals[2][1], time_s=arrivals[2][0])
    with pytest.raises(
        ValueError, match=r"a frame would count twice; allowed .*: detections of other cameras"
    ):
        tracker.update(arrivals[9][1], time_s=arrivals[9][0])
    with pytest.raises(ValueError, match=r"no time_s, which the lag of 0\.1 s needs"):
        tracker.update(arrivals[9][1])
    assert list(map(vars_of, tracker.targets)) == before
    of_cameras = DetectionsTracker(write_graph(tmp_path), fps=FPS, lag_s=LAG)
    (time_s, south), (_, east) = room()[:2]
    of_cameras.update(south, time_s=time_s)
    assert list(of_cameras.update(east, time_s=time_s)) == ["east"]
    with pytest.raises(ValueError, match="the detections of south would count twice"):
        of_cameras.update(south, time_s=time_s)
    for lag_s in (-1, "soon", float("nan")):
        with pytest.raises(ValueError, match=r"lag_s=.*: how late detections may come"):
            DetectionsTracker(lag_s=lag_s)


def test_copies_go_on_by_themselves_and_stored_ones_are_final(tmp_path):
    arrivals = late(crowd(), np.random.default_rng(8))
    tracker = DetectionsTracker(size=(640, 480), lag_s=LAG)
    first = []
    for time_s, boxes in arrivals[:8]:
        tracker.update(boxes, time_s=time_s)
        first += tracker.settled()
    twin = copy.copy(tracker)
    assert final_steps(twin, arrivals[8:]) == final_steps(tracker, arrivals[8:])
    other = DetectionsTracker(size=(640, 480), lag_s=LAG)
    for time_s, boxes in crowd()[:8]:
        other.update(boxes, time_s=time_s)
    with pytest.raises(StoredError, match=r"while 5 steps within its lag of 0\.2 s can change; call settled"):
        other.save(tmp_path / "tracker.bin")
    other.settled(end=True)
    other.save(tmp_path / "tracker.bin")
    loaded = DetectionsTracker.load(tmp_path / "tracker.bin")
    assert final_steps(loaded, crowd()[8:]) == final_steps(other, crowd()[8:])


def test_reset_forgets_the_steps_within_the_lag():
    tracker, arrivals = DetectionsTracker(size=(640, 480), lag_s=LAG), crowd()
    in_order = final_steps(tracker, arrivals)
    tracker.reset()
    for time_s, boxes in arrivals[:5]:
        tracker.update(boxes, time_s=time_s)
    tracker.reset()
    assert final_steps(tracker, arrivals) == in_order
