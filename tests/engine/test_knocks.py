"""Cameras that are knocked at half time, in drawn scenes: found, named, and kept from pulling targets."""

from __future__ import annotations

import json

import numpy as np
import pytest

from bayesnet_track import DetectionsTracker
from bayesnet_track.journal.events.cameras import CameraKnocked
from tests.engine.test_several_cameras import FPS, boxes_of, detections_of, noisy, write_graph

BIAS, FRAMES, AT = 4.0, 44, 30
PAIR = ["south", "north"]
STARTS = np.array([[-2.0, 9.0], [0.0, 11.0], [1.5, 8.5], [2.0, 10.5]])
SPEEDS = np.array([[0.5, 0.3], [0.6, -0.4], [-0.7, 0.5], [-0.4, -0.3]])


def biased(folder, cameras):
    path = write_graph(folder, cameras)
    graph = json.loads(path.read_text())
    for name in cameras:
        graph["cameras"][name]["bias_px"] = {"sd": BIAS}
    path.write_text(json.dumps(graph))
    return path


def places_at(frame, turned=False):
    later = max(frame - AT, 0) / FPS if turned else 0.0
    return STARTS + SPEEDS * (frame / FPS - 2.0 * later)


def scene(rng, cameras, shift=(0.0, 0.0), knocked="north", turned=False):
    """Frame by frame: camera -> boxes of four people; `knocked` sees them shifted from frame `AT` on."""
    bias = {name: rng.normal(0.0, BIAS / 2.0, 2) for name in cameras}
    for frame in range(FRAMES):
        seen = {}
        for name in cameras:
            boxes = noisy(boxes_of(name, places_at(frame, turned)), rng)
            boxes[:, :2] += bias[name]
            if name == knocked and frame >= AT:
                boxes[:, :2] += shift
            seen[name] = detections_of(boxes)
        yield frame, seen


def knocks_of(tracker, frames):
    found = []
    for frame, seen in frames:
        tracker.update(seen, time_s=frame / FPS)
        found += [event for event in tracker.events if isinstance(event, CameraKnocked)]
    return found


def inside(tracker, frame):
    """Whether the 90 % ellipse of each target holds who it is."""
    held = []
    for target in tracker.targets:
        state = target.state
        sds = np.array([state["x_m_sd"], state["y_m_sd"]])
        spread = np.outer(sds, sds) * np.array([[1.0, state["xy_corr"]], [state["xy_corr"], 1.0]])
        away = places_at(frame) - [state["x_m"], state["y_m"]]
        away = away[np.linalg.norm(away, axis=1).argmin()]
        held.append(away @ np.linalg.solve(spread, away) < 4.605)
    return held


@pytest.mark.slow
@pytest.mark.parametrize("shift", [(20.0, -6.0), (-90.0, 30.0)], ids=["in reach", "out of reach"])
def test_a_knock_is_found_named_and_contained(tmp_path, shift):
    """Also one so far that no detection is near where its target is expected."""
    tracker, rng = DetectionsTracker(biased(tmp_path, PAIR), fps=FPS), np.random.default_rng(11)
    found, held = [], []
    for frame, seen in scene(rng, PAIR, shift):
        tracker.update(seen, time_s=frame / FPS)
        found += [event for event in tracker.events if isinstance(event, CameraKnocked)]
        held += inside(tracker, frame) if frame >= AT else []
    (knock,) = found
    assert knock.camera == "north"
    assert AT <= knock.frame <= AT + 2
    assert abs(knock.first_frame - AT) <= 2
    assert knock.describe().startswith(f"camera north is {np.hypot(knock.x_px, knock.y_px):.0f} px off since")
    assert len(tracker.targets) == len(STARTS)
    for target in tracker.targets:
        for axis, true in zip("xy", shift, strict=True):
            name = f"view.north.{axis}"
            assert abs(target.state[name] - true) < 3.0 * np.hypot(target.state[f"{name}_sd"], BIAS)
    assert np.mean(held) > 0.8


@pytest.mark.slow
def test_nobody_is_knocked_where_people_turn_or_cameras_stand_still(tmp_path):
    """All who turn at once are elsewhere in every camera."""
    for turned in (False, True):
        tracker, rng = DetectionsTracker(biased(tmp_path, PAIR), fps=FPS), np.random.default_rng(12)
        assert not knocks_of(tracker, scene(rng, PAIR, turned=turned))


@pytest.mark.slow
def test_who_starts_after_a_knock_stands_where_the_others_do(tmp_path):
    """One who is seen by the knocked camera alone starts without its shift, and as unsure as that is."""
    tracker, rng = DetectionsTracker(biased(tmp_path, PAIR), fps=FPS), np.random.default_rng(11)
    knocks_of(tracker, scene(rng, PAIR, (40.0, 0.0)))
    before = {target.target for target in tracker.targets}
    place = np.array([-1.0, 15.5])
    for frame in range(FRAMES, FRAMES + 12):
        box = noisy(boxes_of("north", place), rng) + [40.0, 0.0, 0.0, 0.0]
        tracker.update({"north": detections_of(box)}, time_s=frame / FPS)
    (new,) = [target for target in tracker.targets if target.target not in before]
    away = np.array([new.state["x_m"], new.state["y_m"]]) - place
    assert abs(away[0]) < 3.0 * new.state["x_m_sd"]
    assert np.hypot(*away) < 0.6


@pytest.mark.slow
def test_what_is_known_of_cameras_is_stored_with_the_state(tmp_path):
    tracker, rng = DetectionsTracker(biased(tmp_path, PAIR), fps=FPS), np.random.default_rng(11)
    frames = list(scene(rng, PAIR, (20.0, 10.0)))
    knocks_of(tracker, frames[:AT])
    tracker.save(tmp_path / "state.bin")
    loaded = DetectionsTracker.load(tmp_path / "state.bin")
    assert [[one.camera for one in knocks_of(each, frames[AT:])] for each in (tracker, loaded)] == [
        ["north"]
    ] * 2
    for one, other in zip(tracker.targets, loaded.targets, strict=True):
        assert one.state == other.state
