"""Targets in space seen by several cameras, as boxes and as points, with a clock to learn."""

from __future__ import annotations

import csv
import json
from contextlib import closing
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from bayesnet_track import DetectionsTracker, track
from bayesnet_track.cli.main import main
from bayesnet_track.engine.starts import StartError
from bayesnet_track.runtime.checkpoints.resume import resume
from tests.engine.street import camera_at, detections_of, write_camera

CAMERAS = {
    "south": camera_at(0.0, -20.0, 0.0, degrees=5.0),
    "west": camera_at(-25.0, 0.0, -70.0, degrees=3.0),
}
FPS, SIZE = 20.0, 0.5
ANYWHERE = {"x": {"mean": 0, "sd": 15}, "y": {"mean": 0, "sd": 15}, "z": {"mean": 4, "sd": 5}}
POINTS = {"points": True, "sd_place_px": 1.5}


def write_graph(folder, detection, clock=None, **space):
    for name, camera in CAMERAS.items():
        write_camera(folder, camera, name)
    cameras = {name: {"calibration": f"{name}.json"} for name in CAMERAS}
    if clock is not None:
        cameras["west"]["clock"] = {"offset_s": {"sd": clock}}
    graph = {
        "bayesnet": 1,
        "name": "drone",
        "cameras": cameras,
        "targets": {
            "drone": {
                "state": {"space": {"size": {"mean": SIZE, "sd": 0.05}, **space}},
                "associate": "marginal",
                "existence": {"detection": 0.9, "clutter": 0.01, "births": 0.05},
                "birth": {"detector": "detections"},
                "nodes": {
                    "drone": {
                        "belief": {
                            "gaussian": {"filter": "extended", "likelihood": "sigma_points", "gate": 1}
                        },
                        "motion": {"constant_velocity": {"sd_velocity": 3, "start_velocity_sd": 6}},
                        "fuse": "product",
                        "estimate": "mean",
                    },
                    "view": {"parent": "drone", "camera": list(CAMERAS)},
                    "seen": {"parent": "view", "agent": {"detection": detection}},
                },
            }
        },
    }
    path = folder / "drone.yaml"
    path.write_text(json.dumps(graph))
    return path


def place(time):
    return np.array([4 * np.sin(time), 3 * np.cos(1.3 * time), SIZE, SIZE, 5 + 1.5 * np.sin(0.8 * time)])


def fly(graph, noise, late=0.0, seconds=4.0, seed=0):
    """Errors (n, 3) in m, the same in sds, and the last target, with the west camera `late` by so many s."""
    tracker, rng, errors, sds = DetectionsTracker(graph, fps=FPS), np.random.default_rng(seed), [], []
    for frame in range(int(seconds * FPS)):
        time, given = frame / FPS, {}
        for name, camera in CAMERAS.items():
            box = camera.boxes(place(time - late * (name == "west"))[None])[0]
            given[name] = detections_of(box + noise(box) * rng.standard_normal(4))
        tracker.update(given)
        for target in tracker.targets:
            state = target.state
            errors.append([state[f"{axis}_m"] for axis in "xyz"] - place(time)[[0, 1, 4]])
            sds.append([state[f"{axis}_m_sd"] for axis in "xyz"])
    assert len(tracker.targets) == 1
    return np.array(errors), np.array(errors) / np.array(sds), tracker.targets[0].state


@pytest.mark.parametrize("points", [False, True])
def test_a_target_is_followed_in_space_as_surely_as_it_says(tmp_path, points):
    detection = POINTS if points else {"sd_place": 0.05, "sd_size": 0.05}
    graph = write_graph(tmp_path, detection, **(ANYWHERE if points else {}))
    errors, scaled, state = fly(graph, lambda box: 1.5 if points else 0.05 * box[[2, 3, 2, 3]])
    assert len(errors) > 70
    assert np.median(np.linalg.norm(errors[10:], axis=1)) < 0.15
    assert 0.3 < (scaled[10:] ** 2).mean() < 2.0
    assert {"z_m", "vz", "z_m_sd", "vz_sd"} <= state.keys()


@pytest.mark.parametrize("late", [0.15, -0.1])
def test_a_clock_is_learnt_from_a_target_in_space(tmp_path, late):
    state = fly(write_graph(tmp_path, POINTS, clock=0.3, **ANYWHERE), lambda box: 1.5, late)[2]
    assert state["view.west.clock_s"] == pytest.approx(late, abs=0.02)
    assert abs(state["view.west.clock_s"] - late) < 3 * state["view.west.clock_s_sd"]


def test_a_run_writes_where_each_camera_sees_a_target_in_space(tmp_path):
    files, steps = {}, 20
    for name, camera in CAMERAS.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "seqinfo.ini").write_text(
            f"[Sequence]\nimWidth=640\nimHeight=480\nframeRate={FPS:g}\nseqLength={steps}\n"
        )
        boxes = camera.boxes(np.array([place(frame / FPS) for frame in range(steps)]))
        lines = [
            f"{frame},-1,{x - (w - 1) / 2},{y - (h - 1) / 2},{w},{h},0.9,-1,-1,-1"
            for frame, (x, y, w, h) in enumerate(boxes, 1)
        ]
        files[name] = tmp_path / name / "boxes.txt"
        files[name].write_text("\n".join(lines) + "\n")
    graph, out = write_graph(tmp_path, {"sd_place": 0.05, "sd_size": 0.05}), tmp_path / "run"
    assert len(list(track(graph, None, detections=files, out=out))) == steps
    rows = list(csv.DictReader((out / "cameras.csv").open()))
    for name, camera in CAMERAS.items():
        row = [row for row in rows if row["camera"] == name][-1]
        x, y, w, h = (float(row[side]) for side in "xywh")
        expected = camera.boxes(place(int(row["camera_frame"]) / FPS)[None])[0]
        np.testing.assert_allclose([x + (w - 1) / 2, y + (h - 1) / 2, w, h], expected, atol=2.0)


@pytest.mark.parametrize(("points", "seed"), [(True, 0), (True, 2), (False, 1)])
def test_what_flies_past_a_camera_has_a_belief_in_numbers(tmp_path, points, seed):
    """It comes near the south camera, then is behind it; the west clock is hardly known."""
    detection = POINTS if points else {"sd_place": 0.05, "sd_size": 0.05}
    graph, rng = (
        write_graph(tmp_path, detection, 1.5, **(ANYWHERE if points else {})),
        np.random.default_rng(seed),
    )
    tracker, started = DetectionsTracker(graph, fps=FPS), 0
    begin, end = np.array([rng.uniform(-9, 9), 15, 5]), np.array([rng.uniform(-2, 2), -28, rng.uniform(2, 6)])
    for share in np.linspace(0.0, 1.0, 50):
        x, y, z = begin + share * (end - begin)
        boxes = {name: camera.boxes(np.array([[x, y, SIZE, SIZE, z]])) for name, camera in CAMERAS.items()}
        shown = {name: (box[:, 0] > 0) & (box[:, 0] < 640) & (box[:, 1] > 0) for name, box in boxes.items()}
        tracker.update({name: detections_of(box[shown[name]]) for name, box in boxes.items()})
        for target in tracker.targets:
            started += 1
            assert np.isfinite([value for value in target.state.values() if isinstance(value, float)]).all()
    assert started > 20
    assert not shown["south"].any()


def test_a_point_starts_a_target_at_the_mode_of_the_place_that_it_may_have(tmp_path):
    """The Gaussian prior of the place given one pixel, by Newton's method in exact arithmetic of its own."""
    tracker = DetectionsTracker(write_graph(tmp_path, POINTS, **ANYWHERE), fps=FPS)
    pixel = np.array([350.0, 200.0])
    first = SimpleNamespace(xyxy=[[*pixel - 0.5, *pixel + 1.5]], confidence=[0.9])
    for _ in range(6):
        tracker.update({"south": first})
        if tracker.targets:
            break
    state, camera = tracker.targets[0].state, CAMERAS["south"]
    mean, sd = np.array([0.0, 0.0, 4.0]), np.array([15.0, 15.0, 5.0])
    point = mean.copy()
    for _ in range(50):
        slopes = camera.jacobian(np.array([[*point[:2], SIZE, SIZE, point[2]]]))[0][:2][:, [0, 1, 4]]
        seen = camera.boxes(np.array([[*point[:2], SIZE, SIZE, point[2]]]))[0, :2]
        information = slopes.T @ slopes / 1.5**2 + np.diag(sd**-2.0)
        pull = slopes.T @ (pixel - seen) / 1.5**2 + (mean - point) / sd**2
        point = point + np.linalg.solve(information, pull)
    found = [state[f"{axis}_m"] for axis in "xyz"]
    assert found == pytest.approx(point, abs=0.4)  # further frames moved it by less than its motion may
    assert state["y_m_sd"] > 5.0


def test_what_a_state_in_space_has_no_place_for_is_refused(tmp_path):
    path = write_graph(tmp_path, POINTS, **ANYWHERE)
    for change, message in (
        ({"motion": {"expressions": {"sd": {"x": 1}}}}, "a motion by expressions of a state in space"),
        ({"belief": {"grid": {}}}, "a grid, whose cells are pixels"),
    ):
        graph = json.loads(path.read_text())
        graph["targets"]["drone"]["nodes"]["drone"] |= change
        (tmp_path / "wrong.yaml").write_text(json.dumps(graph))
        with pytest.raises(ValueError, match=message):
            DetectionsTracker(tmp_path / "wrong.yaml", fps=FPS)


@pytest.mark.parametrize(
    ("state", "message"),
    [
        ("box", "points of a target whose state is in pixels"),
        ({"space": {"size": {"mean": SIZE, "sd": 0.05}}}, "targets without a prior of x, y, z"),
        ({"ground": {"width": {"mean": 0.5, "sd": 0.1}}}, "targets without a prior of height"),
    ],
)
def test_points_are_of_targets_that_they_can_start(tmp_path, state, message):
    path = write_graph(tmp_path, POINTS, **ANYWHERE)
    graph = json.loads(path.read_text())
    drone = graph["targets"]["drone"]
    drone["state"] = state
    if state == "box":
        del graph["cameras"], drone["nodes"]["view"]
        drone["nodes"]["seen"]["parent"] = "drone"
        drone["nodes"]["drone"]["motion"] = {"constant_velocity": {"sd_velocity_px": 3}}
    path.write_text(json.dumps(graph))
    with pytest.raises(ValueError, match=message):
        DetectionsTracker(path, fps=FPS)


@pytest.mark.parametrize(
    ("detection", "message"),
    [
        ({"points": True}, "points without sd_place_px"),
        ({"points": True, "sd_place_px": 2, "sd_size": 0.1}, "points beside sd_size"),
    ],
)
def test_points_have_an_error_in_px_and_no_size(tmp_path, detection, message):
    with pytest.raises(ValueError, match=message):
        DetectionsTracker(write_graph(tmp_path, detection, **ANYWHERE), fps=FPS)


def image_of(name, spot, patch, background):
    """The background with a patch in the middle of which the camera shows the place."""
    image = background[name].copy()
    x, y = np.rint(CAMERAS[name].project(spot[None])[0]).astype(int)
    image[y - 12 : y + 13, x - 12 : x + 13] = patch
    return image


@pytest.fixture
def shown_room(tmp_path):
    """A graph without detections, images of two cameras of a patch that moves, and its places."""
    path = write_graph(tmp_path, {})
    graph = json.loads(path.read_text())
    target = graph["targets"]["drone"]
    for key in ("associate", "existence", "birth"):
        del target[key]
    del target["nodes"]["seen"]
    target["nodes"]["look"] = {"parent": "view", "agent": {"template": {"reach_box": 1.5}}}
    path.write_text(json.dumps(graph))
    rng = np.random.default_rng(3)
    patch = rng.integers(0, 256, (25, 25, 3), np.uint8)
    background = {name: np.full((480, 640, 3), 120, np.uint8) for name in CAMERAS}
    places = np.array([[0.04 * k, -0.03 * k, 4.0 + 0.05 * k] for k in range(6)])
    for name in CAMERAS:
        (tmp_path / name).mkdir()
        for frame, spot in enumerate(places):
            cv2.imwrite(str(tmp_path / name / f"{frame:03}.png"), image_of(name, spot, patch, background))
    return path, {name: str(tmp_path / name) for name in CAMERAS}, places


def shown_at(spot):
    boxes = {
        name: camera.boxes(np.array([[*spot[:2], SIZE, SIZE, spot[2]]])) for name, camera in CAMERAS.items()
    }
    return {name: tuple(box[0, :2].tolist()) for name, box in boxes.items()}


def test_a_point_that_cameras_show_is_followed_by_image_agents(shown_room):
    path, sources, places = shown_room
    states = [
        [result.targets[0].state[field] for field in ("x_m", "y_m", "z_m")]
        for result in track(path, sources, shown_at(places[0]))
    ]
    assert states[0] == pytest.approx(places[0], abs=1e-6)  # where the rays of the points meet
    assert np.linalg.norm(states - places, axis=1).max() < 0.05  # two pixels at 20 m


def test_points_of_the_command_line_start_the_run_and_its_resumption(shown_room, tmp_path):
    path, sources, places = shown_room
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    shown = shown_at(places[0])
    points = " ".join(f"{name}={x},{y}" for name, (x, y) in shown.items())
    given = [part for name, source in sources.items() for part in ("--source", f"{name}={source}")]
    assert (
        main(["run", str(path), *given, "--init", points, "--out", str(whole), "--tracks-csv", "--quiet"])
        == 0
    )
    with closing(track(path, sources, shown, out=broken, tracks_csv=True)) as results:
        for _ in zip(range(3), results, strict=False):
            pass
    list(resume(broken))
    for name in ("journal.jsonl", "cameras.csv", "run.json"):
        assert (broken / name).read_bytes() == (whole / name).read_bytes()


@pytest.mark.parametrize(
    ("shown", "fault"),
    {
        "box": ((1, 2, 30, 40), "a box is of one image"),
        "camera": ({"north": (1, 2)}, "camera 'north', which drone has no view of; allowed: south, west"),
        "outside": ({"south": (700, 2)}, "outside of its 640x480 image"),
        "one": ({"south": (300, 200)}, "points in two cameras or more"),
    }.values(),
)
def test_starts_that_are_nowhere_are_refused(shown_room, shown, fault):
    path, sources, _ = shown_room
    with pytest.raises(StartError, match=fault):
        track(path, sources, shown)


def test_it_is_said_by_how_much_cameras_disagree(shown_room):
    path, sources, places = shown_room
    shown = shown_at(places[0])
    shown["west"] = (shown["west"][0], shown["west"][1] + 60.0)
    with pytest.warns(match=r"off in south by [23]\d\.\d px, west by [23]\d\.\d px"):
        track(path, sources, shown)
