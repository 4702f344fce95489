"""Runs without a start box: by detections from a file, by a detector, from the command line and by hand."""

from __future__ import annotations

import hashlib
import json

import numpy as np
import pytest

from bayesnet_track import Tracker, open_run, track
from bayesnet_track.cli.main import main
from bayesnet_track.engine.starts import StartError
from bayesnet_track.graph.checks.run import check_graph
from bayesnet_track.graph.text.write import write_graph
from bayesnet_track.journal.events.lives import CandidateConfirmed
from bayesnet_track.journal.events.runs import RunStarted
from bayesnet_track.observation.detector import DetectorError


def graph_by(detector, **birth):
    node = {"motion": {"random_walk": {"sd_px": {"x": 4, "y": 4}}}, "belief": {"particles": {"size": 100}}}
    agent = {"parent": "s", "agent": "intensity"}
    kind = {"birth": {"detector": detector, **birth}, "nodes": {"s": node, "a": agent}}
    return check_graph({"name": "births", "targets": {"square": kind}})


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    """A folder of 8 pictures: nothing in the first two, then a bright patterned square that moves right."""
    import cv2

    folder = tmp_path_factory.mktemp("pictures")
    rng = np.random.default_rng(0)
    cells = np.kron(rng.integers(150, 255, (5, 5)), np.ones((4, 4))).astype(np.uint8)
    for n in range(8):
        image = np.full((90, 120, 3), 40, np.uint8)
        if n >= 2:
            image[30:50, 20 + 3 * n : 40 + 3 * n] = cells[:, :, None]
        cv2.imwrite(str(folder / f"{n:03d}.png"), image)
    return folder


@pytest.fixture
def found(tmp_path):
    """A file of detections of that square."""
    path = tmp_path / "found.txt"
    path.write_text("".join(f"{n + 1},-1,{20 + 3 * n},30,20,20,0.8,-1,-1,-1\n" for n in range(2, 8)))
    return path


def test_a_run_by_detections_from_a_file(pictures, found, tmp_path):
    """Nobody is there at first; every output is written all the same, and the journal names the file."""
    graph = graph_by("detections", confirm={"hits": 2, "of": 2})
    out = tmp_path / "run"
    results = list(track(graph, str(pictures), out=out, detections=found, video=True))
    assert [len(result.targets) for result in results] == [0, 0, 0, 1, 1, 1, 1, 1]
    assert results[-1].targets[0].centre_box[0] == pytest.approx(20 + 21 + 9.5, abs=4)
    events = open_run(out).events
    assert isinstance(events[0], RunStarted)
    assert events[0].inputs == {str(found): hashlib.sha256(found.read_bytes()).hexdigest()}
    (confirmed,) = [event for event in events if isinstance(event, CandidateConfirmed)]
    assert (confirmed.frame, confirmed.detector, confirmed.score) == (3, "detections", pytest.approx(0.8))
    assert len((out / "tracks.txt").read_text().splitlines()) == 5
    assert (out / "video.mkv").stat().st_size > 0


def test_without_a_file_nothing_is_said_of_one(pictures, tmp_path):
    graph = graph_by({"gray_level": {"min_area_px": 100}})
    list(track(graph, str(pictures), out=tmp_path / "run"))
    first = json.loads((tmp_path / "run" / "journal.jsonl").read_text().splitlines()[0])
    assert first["event"] == "run_started" and "inputs" not in first


def test_graph_and_file_have_to_go_together(pictures, found):
    with pytest.raises(DetectorError, match="no file of them is given"):
        next(track(graph_by("detections"), str(pictures)))
    with pytest.raises(DetectorError, match="no plate of the graph has births by them"):
        next(track(graph_by("motion"), str(pictures), detections=found))
    with pytest.raises(StartError, match="no start box is given"):
        next(track("general", str(pictures)))


def test_a_tracker_without_a_box():
    tracker = Tracker(graph_by({"gray_level": {"min_area_px": 100}}, confirm={"hits": 1, "of": 1}))
    empty = np.full((90, 120, 3), 40, np.uint8)
    there = empty.copy()
    there[30:50, 50:70] = 220
    tracker.init(empty)
    assert tracker.update(empty) == (False, (0.0, 0.0, 0.0, 0.0))
    assert tracker.score == 0 and tracker.targets == ()
    ok, box = tracker.update(there)
    assert ok and box == pytest.approx((50, 30, 20, 20), abs=3)
    with pytest.raises(ValueError, match="no start box"):
        Tracker("general").init(empty)


def test_from_the_command_line(pictures, found, tmp_path, capsys):
    path = tmp_path / "g.yaml"
    path.write_text(write_graph(graph_by("detections").spec))
    run = ["run", str(path), "--source", str(pictures), "--out", str(tmp_path / "run")]
    assert main([*run, "--detections", str(found)]) == 0
    assert "no target" not in capsys.readouterr().err.splitlines()[-1]
    assert main(["log", str(tmp_path / "run"), "--target", "1"]) == 0
    story = capsys.readouterr().out.splitlines()
    assert story[0].startswith(
        "frame 4: detections detected it in 3 of 3 evaluations since frame 2, mean score 0.80"
    )
    assert story[-1] == "summary: 4 frames, lost in 0; alive at the end of the run"
    assert main(["log", str(tmp_path / "run"), "--target", "2"]) == 2
    assert "no target '2' in this run; there are 1" in capsys.readouterr().err
    assert main(["run", "general", *run[2:]]) == 2
    assert "no start box" in capsys.readouterr().err
    assert main([*run, "--detections", str(path)]) == 2
    assert f"{path}:1" in capsys.readouterr().err
    assert main([*run, "--overwrite"]) == 2
    assert "no file of them is given" in capsys.readouterr().err
