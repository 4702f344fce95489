"""Targets on the ground, seen by a camera: metres by the front door, against filters written out in NumPy."""

from __future__ import annotations

import csv
import json

import cv2
import numpy as np
import pytest

from bayesnet_track import DetectionsTracker, Tracker, track
from bayesnet_track.cli.main import main
from bayesnet_track.evaluate.world import read_world_truth
from bayesnet_track.runtime.recording.run_reader import open_run
from bayesnet_track.runtime.smoothing import smooth
from tests.engine.street import (
    CAMERA,
    FPS,
    HEIGHT,
    NOISE,
    SIZE_SD,
    SPEED_SD,
    START_SD,
    WIDTH,
    boxes_of,
    camera_at,
    detections_of,
    moved,
    noisy,
    write_camera,
)


def write_graph(folder, belief, seen, **target):
    write_camera(folder, CAMERA)
    graph = {
        "bayesnet": 1,
        "name": "street",
        "cameras": {"north": {"calibration": "north.json"}},
        "queries": {
            "speed": {"of": "person", "value": "hypot(vx, vy) * 3.6", "unit": "km/h"},
            "on_lane": {"of": "person", "probability": "x > 0"},
        },
        "targets": {
            "person": {
                "state": {
                    "ground": {
                        "width": {"mean": WIDTH[0], "sd": WIDTH[1]},
                        "height": {"mean": HEIGHT[0], "sd": HEIGHT[1]},
                    }
                },
                **target,
                "nodes": {
                    "person": {
                        "belief": belief,
                        "motion": {
                            "constant_velocity": {
                                "sd_velocity": SPEED_SD,
                                "start_velocity_sd": START_SD,
                                "sd": {"w": SIZE_SD, "h": SIZE_SD},
                            }
                        },
                        "estimate": "mean",
                    },
                    "view": {"parent": "person", "camera": "north"},
                    "seen": {"parent": "view", "agent": seen},
                },
            }
        },
    }
    path = folder / "street.yaml"
    path.write_text(json.dumps(graph))
    return path


def of_detections(folder, filter_="extended", associate="assignment", **existence):
    settings = {"detection": 0.95, "clutter": 0.01, "births": 0.05, **existence}
    return write_graph(
        folder,
        {"gaussian": {"filter": filter_, "likelihood": "sigma_points", "gate": 1}},
        {"detection": {"sd_place": NOISE, "sd_size": NOISE}},
        associate=associate,
        existence=settings,
        birth={"detector": "detections"},
    )


def walk(count=40, start=(-3.0, 9.0), velocity=(1.4, 0.4)):
    times = np.arange(count)[:, None] / FPS
    return np.array(start) + times * np.array(velocity)


def corner_of(box):
    return (*(box[:2] - box[2:] / 2 + 0.5), *box[2:])


# ---------------------------------------------------------------- references


def error_of(box):
    return np.diag((NOISE * box[[2, 3, 2, 3]]) ** 2)


def extended(mean, covariance, box):
    slopes = np.hstack([CAMERA.jacobian(mean[None, :4])[0], np.zeros((4, 2))])
    expected = CAMERA.boxes(mean[None, :4])[0]
    spread = slopes @ covariance @ slopes.T + error_of(expected)
    gain = covariance @ slopes.T @ np.linalg.inv(spread)
    return mean + gain @ (box - expected), covariance - gain @ slopes @ covariance


def unscented(mean, covariance, box):
    lower = np.linalg.cholesky(covariance) * np.sqrt(6.0)
    points = np.vstack([mean, mean + lower.T, mean - lower.T])
    weights = np.array([0.0, *[1 / 12.0] * 12])
    seen = CAMERA.boxes(points[:, :4])
    expected = weights @ seen
    away = (seen - expected) * weights[:, None]
    spread = away.T @ (seen - expected) + error_of(CAMERA.boxes(mean[None, :4])[0])
    gain = (points - mean).T @ away @ np.linalg.inv(spread)
    return mean + gain @ (box - expected), covariance - gain @ spread @ gain.T


def placed(box):
    """The most probable state of a target that starts with a box, by Newton's steps with many restarts."""
    prior = np.diag([0.0, 0.0, WIDTH[1] ** -2, HEIGHT[1] ** -2])
    usual = np.array([0.0, 0.0, WIDTH[0], HEIGHT[0]])
    foot = CAMERA.ground_points(np.array([[box[0], box[1] + box[3] / 2]]))[0]
    state = np.array([*foot, *usual[2:]])
    for _ in range(50):
        slopes = CAMERA.jacobian(state[None])[0]
        information = slopes.T @ np.linalg.inv(error_of(box)) @ slopes + prior
        pull = slopes.T @ np.linalg.inv(error_of(box)) @ (box - CAMERA.boxes(state[None])[0])
        state = state + np.linalg.solve(information, pull + prior @ (usual - state))
    covariance = np.diag([0.0, 0.0, 0.0, 0.0, START_SD**2, START_SD**2])
    covariance[:4, :4] = np.linalg.inv(information)
    return np.array([*state, 0.0, 0.0]), covariance


@pytest.mark.parametrize(("filter_", "correct"), [("extended", extended), ("unscented", unscented)])
def test_it_is_the_filter_written_out(tmp_path, filter_, correct):
    tracker = DetectionsTracker(of_detections(tmp_path, filter_), fps=FPS)
    boxes = noisy(boxes_of(walk()), np.random.default_rng(3))
    mean, covariance = placed(boxes[0])
    compared = 0
    for frame, box in enumerate(boxes):
        if frame:
            mean, covariance = correct(*moved(mean, covariance, 1 / FPS), box)
        tracker.update(detections_of(box[None]))
        for target in tracker.targets:
            numbers = [target.state[name] for name in ("x_m", "y_m", "w_m", "h_m", "vx", "vy")]
            sds = [target.state[f"{name}_sd"] for name in ("x_m", "y_m", "w_m", "h_m", "vx", "vy")]
            np.testing.assert_allclose(numbers, mean, atol=1e-5)
            np.testing.assert_allclose(sds, np.sqrt(np.diag(covariance)), rtol=1e-4)
            expected = covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])
            assert target.state["xy_corr"] == pytest.approx(expected, abs=1e-4)
            compared += 1
    assert compared > 30


def test_boxes_of_results_are_those_of_the_image(tmp_path):
    tracker = DetectionsTracker(of_detections(tmp_path), fps=FPS)
    places = walk()
    for box in boxes_of(places):
        found = tracker.update(detections_of(box[None]))
    assert found.tracker_id.tolist() == [1]
    (target,) = tracker.targets
    np.testing.assert_allclose(target.centre_box, box, atol=2.0)
    np.testing.assert_allclose([target.state["x_m"], target.state["y_m"]], places[-1], atol=0.1)
    np.testing.assert_allclose([target.state["vx"], target.state["vy"]], [1.4, 0.4], atol=0.15)


def test_speed_is_in_kilometres_an_hour_at_any_rate_of_frames(tmp_path):
    path = of_detections(tmp_path)
    for every in (1, 5):
        tracker = DetectionsTracker(path, fps=FPS / every)
        for box in boxes_of(walk(45))[::every]:
            tracker.update(detections_of(box[None]))
        (target,) = tracker.targets
        speed = np.hypot(1.4, 0.4) * 3.6
        assert target.queries["speed"] == pytest.approx(speed, abs=1.0)
        assert target.queries["speed_low"] < speed < target.queries["speed_high"]
        assert target.queries["on_lane"] > 0.9


def test_two_people_that_pass_keep_their_identities(tmp_path):
    tracker = DetectionsTracker(of_detections(tmp_path, associate="marginal"), fps=FPS)
    ways = [walk(40, (-3.0, 9.0), (1.4, 0.0)), walk(40, (3.0, 12.0), (-1.4, 0.0))]
    rng = np.random.default_rng(5)
    ids = []
    for near, far in zip(*map(boxes_of, ways), strict=True):
        found = tracker.update(detections_of(noisy(np.array([near, far]), rng)))
        ids.append(found.tracker_id.tolist())
    assert ids[-1] == ids[8]
    assert sorted(ids[-1]) == [1, 2]


def test_a_box_above_the_horizon_starts_nothing(tmp_path):
    path = of_detections(tmp_path)
    write_camera(tmp_path, camera_at(0.0, 0.0, 0.0, degrees=5.0))
    tracker = DetectionsTracker(path, fps=FPS)
    for _ in range(8):
        tracker.update(detections_of(np.array([[300.0, 60.0, 30.0, 80.0]])))
    assert not tracker.targets


def scene(places):
    rng = np.random.default_rng(0)
    back = rng.integers(60, 120, (480, 640, 3)).astype(np.uint8)
    for box in boxes_of(places):
        image = back.copy()
        left, top = np.rint(box[:2] - box[2:] / 2).astype(int)
        right, bottom = np.rint(box[:2] + box[2:] / 2).astype(int)
        image[top:bottom, left:right] = (30, 30, 220)
        yield image, box


@pytest.mark.parametrize(
    "belief",
    [{"particles": {"size": 800}}, {"gaussian": {"filter": "extended"}}],
    ids=["particles", "gaussian"],
)
def test_image_cues_follow_a_target_on_the_ground(tmp_path, belief):
    tracker = Tracker(write_graph(tmp_path, belief, "color_histogram"), seed=1, fps=FPS)
    places = walk(25)
    errors = []
    for number, ((image, box), place) in enumerate(zip(scene(places), places, strict=True)):
        if number == 0:
            tracker.init(image, corner_of(box))
            continue
        tracker.update(image)
        (target,) = tracker.targets
        assert target.status == "tracking"
        away = np.array([target.state["x_m"], target.state["y_m"]]) - place
        sds = np.array([target.state["x_m_sd"], target.state["y_m_sd"]])
        assert (np.abs(away) < 4.0 * sds).all()
        errors.append(np.hypot(*away))
    assert np.median(errors) < 0.35
    np.testing.assert_allclose(target.centre_box, box, atol=8.0)


def test_a_start_box_in_the_sky_is_refused(tmp_path):
    path = write_graph(tmp_path, {"particles": {"size": 100}}, "color_histogram")
    write_camera(tmp_path, camera_at(0.0, 0.0, 0.0, degrees=5.0))
    tracker = Tracker(path, fps=FPS)
    with pytest.raises(ValueError, match="stands nowhere on the ground"):
        tracker.init(np.zeros((480, 640, 3), np.uint8), (300.0, 20.0, 40.0, 100.0))


def test_frames_of_another_size_are_refused(tmp_path):
    tracker = Tracker(write_graph(tmp_path, {"particles": {"size": 100}}, "color_histogram"), fps=FPS)
    with pytest.raises(ValueError, match=r"calibration north.json: of 640x480 px, .* 320x240 px"):
        tracker.init(np.zeros((240, 320, 3), np.uint8), (100.0, 100.0, 40.0, 80.0))


def test_metres_are_columns_of_a_run(tmp_path):
    path = write_graph(tmp_path, {"particles": {"size": 300}}, "color_histogram")
    images = tmp_path / "images"
    images.mkdir()
    frames = list(scene(walk(6)))
    for number, (image, _) in enumerate(frames):
        cv2.imwrite(str(images / f"{number:03}.png"), image)
    for _ in track(path, str(images), corner_of(frames[0][1]), out=tmp_path / "run"):
        pass
    with (tmp_path / "run" / "tracks.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {"x_m", "y_m_sd", "xy_corr", "vx", "speed", "speed_low"} <= rows[0].keys()
    np.testing.assert_allclose([float(rows[-1]["x_m"]), float(rows[-1]["y_m"])], walk(6)[-1], atol=0.6)
    np.testing.assert_allclose(float(rows[-1]["h_m"]), 1.7, atol=0.3)
    boxes = np.loadtxt(tmp_path / "run" / "tracks.txt", delimiter=",")[:, 2:6]
    np.testing.assert_allclose(boxes[-1], corner_of(frames[-1][1]), atol=12.0)
    assert (
        main(["export", str(tmp_path / "run"), "--format", "world", "-o", str(tmp_path / "world.csv")]) == 0
    )
    places = read_world_truth(tmp_path / "world.csv")
    assert len(places.times) == len(rows)
    np.testing.assert_allclose(
        places.points, [[float(row["x_m"]), float(row["y_m"])] for row in rows], atol=1e-3
    )
    (*_, last) = csv.DictReader((tmp_path / "world.csv").open(encoding="utf-8"))
    assert float(last["sd"]) >= max(float(rows[-1]["x_m_sd"]), float(rows[-1]["y_m_sd"])) - 1e-3
    speed = np.hypot(float(rows[-1]["vx"]), float(rows[-1]["vy"]))
    assert float(last["speed"]) == pytest.approx(speed, abs=1e-3)


def test_what_is_not_built_on_the_ground_says_so(tmp_path):
    path = write_graph(tmp_path, {"particles": {"size": 100}}, "color_histogram")
    images = tmp_path / "images"
    images.mkdir()
    first = next(scene(walk(1)))
    for number in range(2):
        cv2.imwrite(str(images / f"{number:03}.png"), first[0])
    tracker = Tracker(path, fps=FPS)
    tracker.init(first[0], corner_of(first[1]))
    with pytest.raises(ValueError, match="the state of person is on the ground"):
        tracker.predict(3)
    with pytest.raises(ValueError, match="the state of person is on the ground"):
        next(track(path, str(images), corner_of(first[1]), horizon=3))
    for _ in track(path, str(images), corner_of(first[1]), out=tmp_path / "run", keep_beliefs=True):
        pass
    with pytest.raises(ValueError, match="targets are on the ground"):
        smooth(open_run(tmp_path / "run"))


def test_parts_looks_and_rules_work_below_a_view(tmp_path):
    path = of_detections(tmp_path)
    graph = json.loads(path.read_text())
    nodes = graph["targets"]["person"]["nodes"]
    nodes["person"]["learn"] = {"below": {"ud_box": 0.5}}
    nodes["person"]["adapt"] = {
        "activate": {"above": {"ud_box": 0.4}},
        "deactivate": {"below": {"ud_box": 0.2}},
        "keep": 1,
    }
    nodes["view"]["fuse"] = "product"
    nodes["seen"]["agent"]["detection"]["appearance"] = 1.0
    nodes["color"] = {"parent": "view", "agent": "color_histogram"}
    given = {"offset_box": {"y": -0.4}, "size_box": {"w": 0.4, "h": 0.2}, "sd_px": {"x": 1, "y": 1}}
    nodes["head"] = {"parent": "view", "fuse": {"latent": {"given": given}}}
    nodes["hue"] = {"parent": "head", "agent": {"color_histogram": {"bins": 16}}}
    path.write_text(json.dumps(graph))
    tracker = DetectionsTracker(path, fps=FPS)
    places = walk(15)
    for image, box in scene(places):
        tracker.update(detections_of(box[None]), image)
    (target,) = tracker.targets
    np.testing.assert_allclose([target.state["x_m"], target.state["y_m"]], places[-1], atol=0.15)
    head = target.parts["head"].cxcywh
    np.testing.assert_allclose(head[:2], [box[0], box[1] - 0.4 * box[3]], atol=4.0)
    assert len(target.active) < 3


def test_a_stored_tracker_goes_on_and_knows_its_camera(tmp_path):
    tracker = DetectionsTracker(of_detections(tmp_path), fps=FPS)
    boxes = noisy(boxes_of(walk(15)), np.random.default_rng(1))
    for box in boxes[:10]:
        tracker.update(detections_of(box[None]))
    tracker.save(tmp_path / "tracker")
    again = DetectionsTracker.load(tmp_path / "tracker")
    for box in boxes[10:]:
        tracker.update(detections_of(box[None]))
        again.update(detections_of(box[None]))
    assert tracker.targets[0].state == again.targets[0].state
    write_camera(tmp_path, camera_at(0.0, 0.0, 0.0, degrees=29.0))
    with pytest.raises(ValueError, match=r"north.json is not what it was when the tracker was stored"):
        DetectionsTracker.load(tmp_path / "tracker")
    (tmp_path / "north.json").unlink()
    with pytest.raises(
        ValueError, match=r"the calibration .*north.json, which .* cannot be read: No such file"
    ):
        DetectionsTracker.load(tmp_path / "tracker")


@pytest.mark.slow
@pytest.mark.parametrize("filter_", ["extended", "unscented"])
def test_ellipses_hold_the_truth_as_often_as_they_say(tmp_path, filter_):
    path = of_detections(tmp_path, filter_)
    rng = np.random.default_rng(int(np.random.SeedSequence().entropy % 2**32))
    inside = []
    for _ in range(40):
        tracker = DetectionsTracker(path, fps=FPS)
        velocity = np.clip(START_SD * rng.standard_normal(2), -2.0, 2.0)
        place, places = np.array([rng.uniform(-2, 2), rng.uniform(9, 13)]), []
        for _ in range(30):  # as the motion says, with its noise of the velocity
            velocity = velocity + SPEED_SD * np.sqrt(1 / FPS) * rng.standard_normal(2)
            place = place + velocity / FPS
            places.append(place)
        for number, (box, truth) in enumerate(
            zip(noisy(boxes_of(np.array(places)), rng), places, strict=True)
        ):
            tracker.update(detections_of(box[None]))
            if number % 10 != 9 or not tracker.targets:
                continue
            own = tracker.targets[0].state
            away = np.array([own["x_m"], own["y_m"]]) - truth
            both = own["xy_corr"] * own["x_m_sd"] * own["y_m_sd"]
            spread = np.array([[own["x_m_sd"] ** 2, both], [both, own["y_m_sd"] ** 2]])
            inside.append(away @ np.linalg.solve(spread, away) < 4.605)
    assert len(inside) > 90
    assert 0.82 <= np.mean(inside) <= 0.97  # 90 %, and three standard errors of 120
