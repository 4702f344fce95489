"""Cameras that are switched step by step: what one is expected to give, and what it gives."""

from __future__ import annotations

import copy
import json

import numpy as np
import pytest

from bayesnet_track import DetectionsTracker
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.journal.events.cameras import CamerasSwitched
from tests.engine.street import FPS, detections_of, noisy
from tests.engine.test_several_cameras import CAMERAS, write_graph

NAMES = ["south", "east", "north", "west"]
PLACES = np.array([[-4.0, 8.0], [0.5, 12.5], [4.0, 9.0]])
SPEEDS = np.array([[0.3, 0.2], [0.3, -0.1], [-0.2, 0.3]])
SURE = {"detection": 0.99, "covered": 0.99, "missed_frames": 1.0}


def graph_with(folder, adapt, cameras=NAMES, costs=(), **existence):
    folder.mkdir(exist_ok=True)
    path = write_graph(folder, cameras, **{**SURE, **existence})
    graph = json.loads(path.read_text())
    graph["targets"]["person"]["state"]["ground"]["area"] = [[-8, 2], [8, 2], [8, 18], [-8, 18]]
    for camera, cost in dict(costs).items():
        graph["cameras"][camera]["cost"] = cost
    if adapt:
        graph["adapt"] = adapt
    path.write_text(json.dumps(graph))
    return path


def frames(count, rng, cameras=NAMES):
    for frame in range(count):
        places = PLACES + SPEEDS * frame / FPS
        full = np.column_stack([places, np.tile([0.55, 1.75], (len(places), 1))])
        seen = {name: detections_of(noisy(CAMERAS[name].boxes(full), rng)) for name in cameras}
        yield frame / FPS, seen


def mean_ud(tracker):
    return np.mean([target.state["x_m_sd"] ** 2 + target.state["y_m_sd"] ** 2 for target in tracker.targets])


def switched(tracker):
    return [event for event in tracker.events if isinstance(event, CamerasSwitched)]


def test_the_uds_of_the_sentence_are_those_of_replays(tmp_path):
    """A tracker that is given the same detections has the same beliefs; with the next camera, its UD."""
    choosing = DetectionsTracker(graph_with(tmp_path / "some", {"cost_per_step": 1}), fps=FPS)
    looking = DetectionsTracker(graph_with(tmp_path / "all", None), fps=FPS)
    ratios = []
    for number, (time_s, seen) in enumerate(frames(40, np.random.default_rng(5))):
        cameras = choosing.choose_cameras(time_s)
        assert len(cameras) == (1 if number else len(NAMES))
        replay = copy.deepcopy(looking)
        nothing = copy.deepcopy(looking)
        choosing.update(seen, time_s=time_s)
        looking.update({name: seen[name] for name in cameras}, time_s=time_s)
        assert [target.state for target in choosing.targets] == [target.state for target in looking.targets]
        for event in switched(choosing):
            assert event.cameras == cameras
            if number < 8:  # people become targets
                continue
            assert event.runner_up not in cameras
            assert event.ud_m2 < event.without_m2
            replay.update({event.runner_up: seen[event.runner_up]}, time_s=time_s)
            nothing.update(None, time_s=time_s)
            uds = mean_ud(looking), mean_ud(replay), mean_ud(nothing)
            ratios.append(np.divide(uds, (event.ud_m2, event.runner_up_m2, event.without_m2)))
    assert len(ratios) > 10
    assert np.abs(np.array(ratios) - 1.0).max() < 0.15
    assert np.mean(ratios, axis=0) == pytest.approx([1.0, 1.0, 1.0], abs=0.05)


def test_the_next_camera_is_on_at_the_cost_of_the_sentence(tmp_path):
    """Below that cost it is on, above it is not."""

    def first_switch(folder, costs=()):
        graph = graph_with(tmp_path / folder, {"cost_per_step": 1}, costs=costs)
        tracker = DetectionsTracker(graph, fps=FPS)
        for time_s, seen in frames(2, np.random.default_rng(6)):
            tracker.update(seen, time_s=time_s)
        (event,) = switched(tracker)
        return event

    event = first_switch("equal")
    assert event.runner_up_cost < 1.0
    assert first_switch("less", {event.runner_up: event.runner_up_cost * 0.999}).cameras == (event.runner_up,)
    assert first_switch("more", {event.runner_up: event.runner_up_cost * 1.001}).cameras == event.cameras


def test_cameras_take_turns_in_an_empty_room(tmp_path):
    """Undetected targets are expected where no camera looks, the more the longer."""
    graph = graph_with(tmp_path, {"cost_per_step": 1}, births=0.5)
    tracker = DetectionsTracker(graph, fps=FPS)
    nothing = dict.fromkeys(NAMES, detections_of(np.empty((0, 4))))
    chosen = []
    for frame in range(16):
        chosen += tracker.choose_cameras(frame / FPS) if frame else ()
        tracker.update(nothing, time_s=frame / FPS)
    assert len({*chosen}) > 1
    assert len(chosen) == 15
    assert not tracker.targets


def test_expensive_cameras_are_saved_for(tmp_path):
    """With .5 a step, at most what the steps added is spent, and the camera of cost 2 is on, too."""
    cameras = ["south", "east"]
    graph = graph_with(tmp_path, {"cost_per_step": 0.5}, cameras, {"east": 2.0})
    tracker, spent, chosen = DetectionsTracker(graph, fps=FPS), 0.0, []
    for number, (time_s, seen) in enumerate(frames(41, np.random.default_rng(6), cameras)):
        on = tracker.choose_cameras(time_s)
        tracker.update({name: seen[name] for name in on} or None, time_s=time_s)
        if number:
            spent += sum(2.0 if name == "east" else 1.0 for name in on)
            chosen += on
    assert {*chosen} == {*cameras}
    assert 20.0 - 4.0 <= spent <= 20.0


def test_a_better_camera_is_waited_for_until_its_frame_comes(tmp_path):
    """Cameras that take turns by themselves are not chosen by the rhythm of the budget."""
    cameras = ["south", "east"]
    tracker = DetectionsTracker(graph_with(tmp_path, {"cost_per_step": 0.5}, cameras), fps=FPS)
    chosen = []
    for number, (time_s, seen) in enumerate(frames(60, np.random.default_rng(7), cameras)):
        present = cameras if number == 0 else [cameras[number % 2]]
        on = tracker.choose_cameras(time_s, present)
        tracker.update({name: seen[name] for name in present}, time_s=time_s)
        chosen += on if number else ()
    assert {*chosen} == {*cameras}
    assert len(chosen) in (28, 29)


def test_what_is_chosen_is_stored_with_the_state(tmp_path):
    tracker = DetectionsTracker(graph_with(tmp_path, {"cost_per_step": 1}), fps=FPS)
    every = list(frames(24, np.random.default_rng(8)))
    for time_s, seen in every[:12]:
        tracker.update(seen, time_s=time_s)
    tracker.save(tmp_path / "state.bin")
    loaded = DetectionsTracker.load(tmp_path / "state.bin")
    for time_s, seen in every[12:]:
        assert tracker.choose_cameras(time_s) == loaded.choose_cameras(time_s)
        for each in (tracker, loaded):
            each.update(seen, time_s=time_s)
        assert [target.state for target in tracker.targets] == [target.state for target in loaded.targets]


def test_names_of_no_camera_are_refused(tmp_path):
    tracker = DetectionsTracker(graph_with(tmp_path, {"cost_per_step": 1}), fps=FPS)
    with pytest.raises(ValueError, match=r"'noth', which is no camera of the graph.*nearest: north"):
        tracker.choose_cameras(0.0, ["noth"])
    with pytest.raises(ValueError, match="has not several cameras to choose from"):
        DetectionsTracker("kalman_detections").choose_cameras()


@pytest.mark.parametrize(
    ("adapt", "cameras", "costs", "words"),
    [
        ({}, NAMES, {"east": 2}, "cost of camera 'east', and all cameras are on; allowed: adapt: "),
        ({"cost_per_step": 1}, ["south"], (), "views by south; allowed: views by two cameras or more"),
        ({"cost_per_step": 0}, NAMES, (), "cost_per_step.* 0; allowed: a number above 0"),
        ({"undetected_m": 1}, NAMES, (), "cost_per_step.*missing"),
        ({"cost": 1}, NAMES, (), "unknown key 'cost'"),
        ({"cost_per_step": 1}, NAMES, {"east": -1}, "-1; allowed: a number above 0"),
    ],
)
def test_settings_that_say_nothing_are_refused(tmp_path, adapt, cameras, costs, words):
    with pytest.raises(GraphError, match=words):
        load_graph(graph_with(tmp_path, adapt, cameras, costs))


def test_targets_without_existence_are_refused(tmp_path):
    path = graph_with(tmp_path, {"cost_per_step": 1})
    graph = json.loads(path.read_text())
    del graph["targets"]["person"]["existence"]
    path.write_text(json.dumps(graph))
    with pytest.raises(GraphError, match="no probability that a target of person exists; allowed: existence"):
        load_graph(path)
