"""Sensors of quantities through the front doors: `track`, the command line, `DetectionsTracker`."""

import csv
import json
import math
import warnings

import numpy as np
import pytest

from bayesnet_track import DetectionsTracker, track
from bayesnet_track.cli.main import main
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.sources.entrances.notices import InputNotice
from bayesnet_track.sources.sources import open_source

GRAPH = """\
bayesnet: 1
name: sea
targets:
  ship:
    state: point
    associate: marginal
    existence: {detection: 0.9, clutter: 2, births: 0.1}
    birth: {detector: detections}
    nodes:
      ship:
        belief: {gaussian: {filter: extended, likelihood: sigma_points, gate: 1}}
        motion: {constant_velocity: {sd_velocity_px: 0.2, start_velocity_sd_px: 3}}
        estimate: mean
      radar:
        parent: ship
        agent: {detection: {sd: {range: 2, bearing: 0.01}, within: {range: [0, 500], bearing: [-3.2, 3.2]}}}
        measures: {range: "hypot(x, y)", bearing: "atan2(y, x)"}
"""
START, SPEED = np.array([[-150.0, 20.0], [90.0, -200.0]]), np.array([[1.0, -2.0], [0.5, 2.0]])


def looks(count=25, seed=0):
    rng = np.random.default_rng(seed)
    for k in range(count):
        at = START + k * SPEED
        z = np.stack([np.hypot(*at.T), np.arctan2(at[:, 1], at[:, 0])], 1)
        z = z + rng.normal(size=z.shape) * [2.0, 0.01]
        false = rng.uniform([0, -math.pi], [500, math.pi], (rng.poisson(2), 2))
        yield k, at, np.concatenate([z[rng.random(2) < 0.9], false])


@pytest.fixture
def files(tmp_path):
    graph, rows = tmp_path / "sea.yaml", tmp_path / "radar.csv"
    graph.write_text(GRAPH)
    lines = [f"{k},{r:.6f},{b:.6f}" for k, _, z in looks() for r, b in z]
    rows.write_text("\n".join(["time_s,range,bearing", *lines]))
    return str(graph), str(rows), tmp_path


def near(places, at):
    return all(min(np.hypot(*(np.array(one) - two)) for one in places) < 8 for two in at)


@pytest.mark.slow
def test_a_run_without_a_source_follows_both_ships(files, capsys):
    graph, rows, folder = files
    assert main(["run", graph, "--detections", rows, "-o", str(folder / "run")]) == 0
    with (folder / "run" / "tracks.csv").open() as file:
        table = list(csv.DictReader(file))
    last = [one for one in table if one["frame"] == "24"]
    assert near([(float(one["x"]), float(one["y"])) for one in last], START + 24 * SPEED)
    assert {one["w"] for one in table} == {one["h"] for one in table} == {""}
    assert (folder / "run" / "tracks.txt").read_text() == ""
    started = [json.loads(one) for one in (folder / "run" / "journal.jsonl").read_text().splitlines()]
    assert sum(one.get("event") == "target_started" for one in started) >= 2
    capsys.readouterr()
    assert main(["log", str(folder / "run")]) == 0
    said = capsys.readouterr().out
    assert "ship 1 starts, at " in said
    assert "1 x 1 px" not in said


def test_a_tracker_gives_each_detection_its_target():
    tracker = DetectionsTracker(load_graph_text())
    ids = []
    for k, at, z in looks():
        given = {"radar": {"range": z[:, 0], "bearing": z[:, 1]}}
        found = tracker.update(given, time_s=float(k))["radar"]
        places = np.stack([z[:, 0] * np.cos(z[:, 1]), z[:, 0] * np.sin(z[:, 1])], 1)
        own = [np.hypot(*(places - one).T) < 8 for one in at]
        ids.append([{*found[which].tolist()} - {-1} for which in own])
    for ship in (0, 1):
        numbers = set().union(*(one[ship] for one in ids[5:]))
        assert len(numbers) == 1
    assert ids[10][0] != ids[10][1]


def load_graph_text(text=GRAPH):
    import yaml

    return load_graph(yaml.safe_load(text))


@pytest.mark.slow
def test_a_stored_tracker_goes_on_with_the_same_numbers(tmp_path):
    first = DetectionsTracker(load_graph_text(), fps=1)
    steps = list(looks())
    for _, _, z in steps[:12]:
        first.update({"radar": {"range": z[:, 0], "bearing": z[:, 1]}})
    first.save(tmp_path / "t.bin")
    second = DetectionsTracker.load(tmp_path / "t.bin")
    for _, _, z in steps[12:]:
        given = {"radar": {"range": z[:, 0], "bearing": z[:, 1]}}
        assert first.update(given)["radar"].tolist() == second.update(given)["radar"].tolist()
    assert first.targets == second.targets


@pytest.mark.slow
def test_an_interrupted_run_is_taken_up_with_equal_bytes(files):
    graph, rows, folder = files
    list(track(graph, None, detections=rows, out=folder / "whole", checkpoint_every=1e-9))
    part = track(graph, None, detections=rows, out=folder / "part", checkpoint_every=1e-9)
    for result in part:
        if result.frame.index == 11:
            break
    part.close()
    assert main(["resume", str(folder / "part"), "--quiet"]) == 0
    assert (folder / "part" / "tracks.csv").read_bytes() == (folder / "whole" / "tracks.csv").read_bytes()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (3, 'detections of sensors are a mapping, such as {"radar": {"range": [..], "bearing": [..]}}'),
        ({"lidar": {}}, "detections of 'lidar'; the graph's sensors are radar"),
        ({"radar": 5}, "radar: a mapping of range, bearing to columns is needed, not int"),
        (
            {"radar": {"range": [1.0]}},
            "radar: no 'bearing'; it measures range, bearing, and may have a score",
        ),
        (
            {"radar": {"range": [1.0], "bearing": [1.0], "speed": [1.0]}},
            "radar: unknown 'speed'; it measures range, bearing, and may have a score",
        ),
        (
            {"radar": {"range": [1.0], "bearing": [1.0, 2.0]}},
            "radar: bearing of shape (2,) beside range of (1,)",
        ),
        ({"radar": {"range": ["a"], "bearing": [1.0]}}, "radar: real numbers are needed"),
        (
            {"radar": {"range": [-1.0], "bearing": [1.0]}},
            "radar: row 0: range is -1; its measure is never negative",
        ),
        (
            {"radar": {"range": [1.0], "bearing": [90.0]}},
            "radar: row 0: bearing is 90; angles are in radians",
        ),
        ({"radar": {"range": [1.0], "bearing": [1.0], "score": [2.0]}}, "radar: score goes beyond 0..1"),
    ],
)
def test_what_a_program_gives_is_checked_and_loses_nothing(given, said):
    tracker = DetectionsTracker(load_graph_text())
    tracker.update({"radar": {"range": [5.0], "bearing": [0.0]}})
    with pytest.raises((TypeError, ValueError)) as error:
        tracker.update(given)
    assert said in str(error.value)
    assert tracker.update({"radar": {"range": [5.0], "bearing": [0.0]}})["radar"].shape == (1,)


def test_rows_that_cannot_be_used_are_left_out_with_a_notice():
    tracker = DetectionsTracker(load_graph_text())
    with pytest.warns(match="radar: 2 of 3 detections are not finite or outside of `within`"):
        found = tracker.update({"radar": {"range": [5.0, math.nan, 900.0], "bearing": [0.0, 0.0, 0.0]}})
    assert found["radar"].tolist() == [-1, -1, -1]


def test_a_graph_of_boxes_needs_a_source_and_a_sensor_no_video(files):
    graph, rows, folder = files
    with pytest.raises(ValueError, match="no source: a video, a folder of images"):
        list(track("kalman_detections", None))
    with pytest.raises(ValueError, match="has columns of boxes, such as frame,id,left,top,width,height"):
        list(track("kalman_detections", None, detections=rows))
    with pytest.raises(ValueError, match="no images to draw on"):
        list(track(graph, None, detections=rows, out=folder / "run", video=True))
    colour = GRAPH.replace("state: point", "state: box").replace(
        "        measures", '        inverse: {x: range, y: bearing, w: "9", h: "9"}\n        measures'
    )
    colour = colour.replace("        estimate: mean\n", "        estimate: mean\n        fuse: product\n")
    colour += "      look: {parent: ship, agent: color_histogram}\n"
    with pytest.raises(ValueError, match=r"has no images, and the graph sea looks at them \(agent look\)"):
        list(track(load_graph_text(colour), None, detections=rows))


def test_a_file_of_boxes_is_no_file_of_quantities(files):
    graph, _, folder = files
    boxes = folder / "det.txt"
    boxes.write_text("1,-1,10,20,41,31,0.5,-1,-1,-1\n")
    with pytest.raises(ValueError, match=r"whose times stand for frames is named \*.csv, with frame"):
        list(track(graph, None, detections=boxes))
    named = folder / "det.csv"
    named.write_text(boxes.read_text())
    with pytest.raises(ValueError, match="neither a column 'frame' nor 'time_s'"):
        list(track(graph, None, detections=named))


@pytest.mark.slow
def test_frames_of_a_video_are_met_by_their_numbers(files):
    """A sensor beside a source of frames: rows by `frame`; those by time are refused."""
    graph, rows, folder = files
    by_frame = folder / "frames.csv"
    lines = [f"{k},{r:.6f},{b:.6f}" for k, _, z in looks() for r, b in z]
    by_frame.write_text("\n".join(["frame,range,bearing", *lines]))
    import cv2

    images = folder / "images"
    images.mkdir()
    for k in range(25):
        cv2.imwrite(str(images / f"{k:03}.png"), np.zeros((20, 30, 3), np.uint8))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with_images = [one.targets for one in track(graph, str(images), detections=by_frame)][-1]
    alone = [one.targets for one in track(graph, None, detections=by_frame)][-1]
    assert [one.centre_box for one in with_images] == [one.centre_box for one in alone]
    with pytest.raises(ValueError, match="rows by time_s are their own source"):
        list(track(graph, str(images), detections=rows))


BOXES = [(10 + 3 * k, 20.0, 40, 30) for k in range(12)]


def plain(k):
    return f"{k + 1},-1,{BOXES[k][0]},{BOXES[k][1]},{BOXES[k][2]},{BOXES[k][3]},1,-1,-1,-1"


def named(k):
    left, top, width, height = BOXES[k]
    return f"{k + 1},{left},{top},{left + width},{top + height},1"


FORMS = {
    "det.txt": lambda: "\n".join(map(plain, range(12))),
    "det.csv": lambda: "\n".join(["frame,x1,y1,x2,y2,score", *map(named, range(12))]),
    "plain.csv": lambda: "\n".join(map(plain, range(12))),
    "det.jsonl": lambda: "\n".join(
        f'{{"frame": {k}, "detections": [{{"box": {list(BOXES[k])}}}]}}' for k in range(12)
    ),
}


@pytest.mark.parametrize("form", FORMS)
def test_a_file_of_boxes_is_a_source_of_its_own(tmp_path, form):
    """As beside images of that size."""
    path = tmp_path / "boxes" / form
    path.parent.mkdir()
    path.write_text(FORMS[form]())
    with pytest.warns(
        InputNotice, match="frames are taken as 83 x 50 px, which holds all boxes, and 25 a second"
    ):
        alone = [
            one.targets for one in track("kalman_detections", None, detections=path, out=tmp_path / "run")
        ]
    import cv2

    images = tmp_path / "images"
    images.mkdir()
    for k in range(12):
        cv2.imwrite(str(images / f"{k:03}.png"), np.zeros((50, 83, 3), np.uint8))
    beside = [one.targets for one in track("kalman_detections", str(images), detections=path)]
    assert len(alone) == 12 and len(alone[-1]) == 1
    assert [[t.centre_box for t in one] for one in alone] == [[t.centre_box for t in one] for one in beside]


def test_seqinfo_says_size_rate_and_length(tmp_path):
    """MOTChallenge's layout; one that cannot be used is said, and the size assumed."""
    path = tmp_path / "SEQ" / "det" / "det.txt"
    path.parent.mkdir(parents=True)
    path.write_text(FORMS["det.txt"]())
    info = tmp_path / "SEQ" / "seqinfo.ini"
    info.write_text("[Sequence]\nname=SEQ\nimWidth=640\nimHeight=480\nframeRate=30\nseqLength=15\n")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with open_source(str(path)) as source:
            assert (source.width, source.height, source.declared_frames) == (640, 480, 15)
            assert [one.time_s for one in source][-1] == pytest.approx(14 / 30)
    info.write_text("[Sequence]\nimWidth=640\nimHeight=0\nframeRate=30\nseqLength=15\n")
    with (
        pytest.warns(InputNotice, match="seqinfo.ini: not used: imWidth 640, imHeight 0"),
        open_source(str(path)) as source,
    ):
        assert (source.width, source.height) == (83, 50)
