"""Targets on the ground seen by several cameras: by the front door, against filters written out in NumPy."""

from __future__ import annotations

import json

import numpy as np
import pytest

from bayesnet_track import DetectionsTracker
from tests.engine import street
from tests.engine.street import (
    FPS,
    HEIGHT,
    NOISE,
    SIZE_SD,
    SPEED_SD,
    START_SD,
    WIDTH,
    camera_at,
    detections_of,
    moved,
    noisy,
    write_camera,
)

CAMERAS = {
    "south": camera_at(0.0, 0.0, 0.0),
    "east": camera_at(10.0, 10.0, 90.0, (800, 480)),
    "west": camera_at(-10.0, 10.0, -90.0),
    "north": camera_at(0.0, 20.0, 180.0),
}


def write_graph(folder, cameras=("south", "east"), order=None, **existence):
    for name in cameras:
        write_camera(folder, CAMERAS[name], name)
    graph = {
        "bayesnet": 1,
        "name": "room",
        "cameras": {name: {"calibration": f"{name}.json"} for name in cameras},
        "targets": {
            "person": {
                "state": {
                    "ground": {
                        "width": {"mean": WIDTH[0], "sd": WIDTH[1]},
                        "height": {"mean": HEIGHT[0], "sd": HEIGHT[1]},
                    }
                },
                "associate": "assignment",
                "existence": {"detection": 0.95, "clutter": 0.01, "births": 0.05, **existence},
                "birth": {"detector": "detections"},
                "nodes": {
                    "person": {
                        "belief": {
                            "gaussian": {"filter": "extended", "likelihood": "sigma_points", "gate": 1}
                        },
                        "motion": {
                            "constant_velocity": {
                                "sd_velocity": SPEED_SD,
                                "start_velocity_sd": START_SD,
                                "sd": {"w": SIZE_SD, "h": SIZE_SD},
                            }
                        },
                        "fuse": "product",
                        "estimate": "mean",
                    },
                    "view": {"parent": "person", "camera": list(order or cameras)},
                    "seen": {
                        "parent": "view",
                        "agent": {"detection": {"sd_place": NOISE, "sd_size": NOISE}},
                    },
                },
            }
        },
    }
    path = folder / "room.yaml"
    path.write_text(json.dumps(graph))
    return path


def walk(count=30, start=(-2.0, 9.0), velocity=(1.4, 0.4)):
    return np.array(start) + np.arange(count)[:, None] / FPS * np.array(velocity)


def boxes_of(camera, places):
    return street.boxes_of(places, CAMERAS[camera])


FIELDS = ("x_m", "y_m", "w_m", "h_m", "vx", "vy")


# ---------------------------------------------------------------- the filter written out


def corrected(camera, mean, covariance, box):
    slopes = np.hstack([CAMERAS[camera].jacobian(mean[None, :4])[0], np.zeros((4, 2))])
    expected = CAMERAS[camera].boxes(mean[None, :4])[0]
    spread = slopes @ covariance @ slopes.T + np.diag((NOISE * expected[[2, 3, 2, 3]]) ** 2)
    gain = covariance @ slopes.T @ np.linalg.inv(spread)
    away = box - expected
    return mean + gain @ away, covariance - gain @ slopes @ covariance


def test_nobody_looks_in_a_frame_of_no_camera(tmp_path):
    """All targets are predicted there, as where a program says that no detector looked."""
    tracker = DetectionsTracker(write_graph(tmp_path), fps=FPS)
    for frame in range(12):
        boxes = {camera: boxes_of(camera, walk()[0]) for camera in ("south", "east")}
        tracker.update({camera: detections_of(box) for camera, box in boxes.items()}, time_s=frame / FPS)
    (target,) = tracker.targets
    mean = np.array([target.state[name] for name in FIELDS])
    covariance = tracker._now.state.targets[target.target].belief.covariance
    for frame in (12, 13):
        assert tracker.update(None, time_s=frame / FPS) is None
        mean, covariance = moved(mean, covariance, 1 / FPS)
    (target,) = tracker.targets
    assert target.state["x_m_sd"] == pytest.approx(covariance[0, 0] ** 0.5, rel=1e-6)
    assert [target.state[name] for name in FIELDS] == pytest.approx(mean, abs=1e-9)


@pytest.mark.parametrize("order", [("south", "east"), ("east", "south")])
def test_each_camera_is_an_update_in_the_order_of_the_graph(tmp_path, order):
    tracker = DetectionsTracker(write_graph(tmp_path, order=order), fps=FPS)
    rng, places = np.random.default_rng(3), walk()
    mean = covariance = None
    compared = 0
    for frame, place in enumerate(places):
        # each camera at its own rate: east has a frame at every second step, at some there is only south
        cameras = ["south", "east"] if frame % 2 == 0 else ["south"]
        boxes = {camera: noisy(boxes_of(camera, place), rng)[0] for camera in cameras}
        given = {camera: detections_of(boxes[camera]) for camera in reversed(cameras)}
        tracker.update(given, time_s=frame / FPS)
        if mean is not None:
            mean, covariance = moved(mean, covariance, 1 / FPS)
            for camera in cameras:
                mean, covariance = corrected(camera, mean, covariance, boxes[camera])
        for target in tracker.targets:
            numbers = [target.state[name] for name in FIELDS]
            sds = [target.state[f"{name}_sd"] for name in FIELDS]
            if mean is None:  # it starts here, with what its candidate knew
                mean = np.array(numbers)
                covariance = np.diag(sds) @ _correlations(tracker) @ np.diag(sds)
                continue
            np.testing.assert_allclose(numbers, mean, atol=1e-5)
            np.testing.assert_allclose(sds, np.sqrt(np.diag(covariance)), rtol=1e-4)
            compared += 1
    assert compared > 25


def _correlations(tracker):
    (state,) = tracker._now.state.targets.values()
    spread = state.belief.covariance
    sds = np.sqrt(np.diag(spread))
    return spread / np.outer(sds, sds)


def test_a_start_from_one_camera_is_fed_by_the_others(tmp_path):
    places, rng = walk(6), np.random.default_rng(4)
    born = {}
    for cameras in (["south"], ["south", "east"]):
        tracker = DetectionsTracker(write_graph(tmp_path, births=1e-3, clutter=0.5), fps=FPS)
        for frame, place in enumerate(places):
            given = {camera: detections_of(noisy(boxes_of(camera, place), rng)) for camera in cameras}
            tracker.update(given, time_s=frame / FPS)
            if tracker.targets:
                born[len(cameras)] = frame
                break
    assert born[2] < born.get(1, len(places))


@pytest.mark.slow
def test_the_place_is_surer_with_the_camera_that_looks_across(tmp_path):
    sds = {}
    for cameras in (["south"], ["south", "east"]):
        tracker, rng = DetectionsTracker(write_graph(tmp_path), fps=FPS), np.random.default_rng(5)
        for frame, place in enumerate(walk()):
            given = {camera: detections_of(noisy(boxes_of(camera, place), rng)) for camera in cameras}
            marked = tracker.update(given, time_s=frame / FPS)
        (target,) = tracker.targets
        assert np.hypot(target.state["x_m"] - place[0], target.state["y_m"] - place[1]) < 0.3
        sds[len(cameras)] = target.state["y_m_sd"]
        assert all(marked[camera].tracker_id.tolist() == [1] for camera in cameras)
    assert sds[2] < 0.6 * sds[1]


def test_targets_that_the_first_camera_does_not_see_start_and_keep_their_identities(tmp_path):
    path, rng = write_graph(tmp_path, ("west", "east")), np.random.default_rng(6)
    tracker = DetectionsTracker(path, fps=FPS)
    ways = [walk(16, (x, y), (0.3, 0.0)) for x, y in [(-3.0, 9.0), (1.0, 12.0)]]
    behind = [
        walk(16, (-13.0, y), (0.0, 0.2)) for y in (9.0, 11.0)
    ]  # of the first camera: it has no box there
    assert not np.isfinite(boxes_of("west", behind[0])).any()
    ids = []
    for frame in range(16):
        east = [boxes_of("east", way[frame])[0] for way in [*ways, *behind]]
        west = [boxes_of("west", way[frame])[0] for way in ways]
        given = {
            camera: detections_of(noisy(np.array(seen), rng))
            for camera, seen in zip(("east", "west"), (east, west), strict=True)
        }
        ids.append(tracker.update(given, time_s=frame / FPS)["east"].tracker_id.tolist())
    assert sorted(ids[-1]) == [1, 2, 3, 4]
    assert all(numbers == ids[-1] for numbers in ids[8:])


def test_a_camera_without_a_frame_says_nothing_and_one_that_saw_nothing_does(tmp_path):
    existence = {}
    for case in ("without a frame", "saw nothing"):
        tracker = DetectionsTracker(write_graph(tmp_path, detection=0.8), fps=FPS)
        for frame, place in enumerate(walk(12)):
            given = {camera: detections_of(boxes_of(camera, place)) for camera in ("south", "east")}
            if frame >= 10:
                given["south"] = detections_of(np.empty((0, 4)))
                if case == "saw nothing":
                    given["east"] = detections_of(np.empty((0, 4)))
                else:
                    del given["east"]
            tracker.update(given, time_s=frame / FPS)
        (target,) = tracker.targets
        existence[case] = target.existence
    assert existence["saw nothing"] < existence["without a frame"]


WRONG = {
    "no_mapping": (
        lambda boxes: boxes,
        TypeError,
        "the graph room has the cameras south, east: detections are given",
    ),
    "no_camera": (lambda boxes: {}, ValueError, "detections of no camera"),
    "unknown": (
        lambda boxes: {"soth": boxes},
        ValueError,
        "'soth', which is no camera of the graph; there are",
    ),
    "no_boxes": (lambda boxes: {"south": [1]}, TypeError, "south: detections have xyxy"),
}


@pytest.mark.parametrize(("given", "kind", "said"), WRONG.values(), ids=[*WRONG])
def test_wrong_detections_are_refused_and_nothing_is_lost(tmp_path, given, kind, said):
    tracker, place = DetectionsTracker(write_graph(tmp_path), fps=FPS), np.array([0.0, 9.0])
    for frame in range(5):
        boxes = {camera: detections_of(boxes_of(camera, place)) for camera in ("south", "east")}
        tracker.update(boxes, time_s=frame / FPS)
    before = tracker.targets
    assert before
    with pytest.raises(kind, match=said):
        tracker.update(given(detections_of(boxes_of("south", place))), time_s=1.0)
    assert tracker.targets == before


def test_a_late_frame_is_refused(tmp_path):
    tracker = DetectionsTracker(write_graph(tmp_path), fps=FPS)
    boxes = {"south": detections_of(boxes_of("south", np.array([0.0, 9.0])))}
    tracker.update(boxes, time_s=1.0)
    with pytest.raises(ValueError, match="is not later than the frame before it"):
        tracker.update({"east": boxes["south"]}, time_s=0.9)


def test_a_time_at_which_no_camera_looked_is_no_miss(tmp_path):
    """Nobody exists less surely for it, but for its survival; with empty detections it is a miss."""
    place, existence = np.array([0.0, 9.0]), {}
    for given in (None, {camera: detections_of(np.empty((0, 4))) for camera in ("south", "east")}):
        tracker = DetectionsTracker(write_graph(tmp_path), fps=FPS)
        for _ in range(6):
            boxes = {camera: detections_of(boxes_of(camera, place)) for camera in ("south", "east")}
            tracker.update(boxes)
        (before,) = tracker.targets
        answer = tracker.update(given)
        existence[given is None] = before.existence, tracker.targets[0].existence
        assert (answer is None) == (given is None)
    assert existence[True][1] > 0.98 * existence[True][0]
    assert existence[False][1] < 0.9 * existence[False][0]


def test_who_is_beside_the_image_of_the_only_camera_that_looks_is_not_missed(tmp_path):
    """Who stands in it is: an image without detections says that nobody is there."""
    ratios = {}
    for x in (-6.0, 0.0):
        tracker, place = DetectionsTracker(write_graph(tmp_path), fps=FPS), np.array([x, 5.0])
        for frame in range(20):
            tracker.update({"east": detections_of(boxes_of("east", place))}, time_s=frame / FPS)
        (before,) = tracker.targets
        for frame in (20, 21):
            tracker.update({"south": detections_of(np.empty((0, 4)))}, time_s=frame / FPS)
        ratios[x] = tracker.targets[0].existence / before.existence
    assert ratios[-6.0] == pytest.approx(0.995 ** (2 / FPS), abs=1e-3)
    assert ratios[0.0] < 0.9


def test_nobody_starts_where_a_live_target_stands_though_it_has_just_been_lost(tmp_path):
    """Half a person's width aside, farther than motion explains, is no second person."""
    tracker, identities = DetectionsTracker(write_graph(tmp_path), fps=FPS), set()
    for frame in range(60):
        place = np.array([0.3 if frame >= 30 else 0.0, 9.0])
        given = {camera: detections_of(boxes_of(camera, place)) for camera in ("south", "east")}
        tracker.update(given, time_s=frame / FPS)
        identities |= {target.target for target in tracker.targets}
    assert identities == {"1"}


def test_sizes_are_those_of_the_calibrations(tmp_path):
    path = write_graph(tmp_path)
    with pytest.raises(ValueError, match=r"east.json: of 800x480 px, and the frames have 640x480 px"):
        DetectionsTracker(path, size=(640, 480))
    assert DetectionsTracker(path, size={"south": (640, 480), "east": (800, 480)})


@pytest.mark.slow
def test_a_standing_target_is_as_uncertain_as_the_biases_of_its_cameras(tmp_path):
    """At best it is where both cameras, each off by its own bias, agree; one camera alone knows less.

    The sides of boxes have no bias, and say a little of distances.
    """
    place, bias_px, rng, frames = np.array([0.5, 10.0]), 4.0, np.random.default_rng(0), 80
    state, sds = np.array([[*place, WIDTH[0], HEIGHT[0]]]), {}
    information = np.diag([0.0, 0.0, WIDTH[1] ** -2, HEIGHT[1] ** -2, *[bias_px**-2] * 4])
    for cameras in (("south",), ("south", "east")):
        path = write_graph(tmp_path, cameras)
        graph = json.loads(path.read_text())
        for source in graph["cameras"].values():
            source["bias_px"] = {"sd": bias_px}
        path.write_text(json.dumps(graph))
        tracker = DetectionsTracker(path, fps=FPS)
        for step in range(frames):
            given = {name: detections_of(noisy(boxes_of(name, place), rng)) for name in cameras}
            tracker.update(given if len(cameras) > 1 else given["south"], time_s=step / FPS)
        (target,) = tracker.targets
        sds[len(cameras)] = np.array([target.state["x_m_sd"], target.state["y_m_sd"]])
    for first, name in ((4, "south"), (6, "east")):
        slopes = np.zeros((4, 8))
        slopes[:, :4] = CAMERAS[name].jacobian(state)[0]
        slopes[:2, first : first + 2] = np.eye(2)
        noise = NOISE * boxes_of(name, place)[0][[2, 3, 2, 3]]
        information += frames * slopes.T @ np.diag(noise**-2) @ slopes
    least = np.sqrt(np.diag(np.linalg.inv(information))[:2])
    assert (sds[2] > 0.98 * least).all()
    assert (sds[2] < sds[1]).all()
