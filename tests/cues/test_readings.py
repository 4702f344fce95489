"""The cue of readings: what it takes from a file, what it refuses, and a hidden ball that it holds."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bayesnet_track import Start, track
from bayesnet_track.cues.readings import CUE, ReadingsError, read_readings
from bayesnet_track.graph.text.change import change_graph
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.sources.scene_source import SceneSource

QUANTITIES = ("range", "bearing")


def file_of(tmp_path, text, name="radar.csv"):
    (tmp_path / name).write_text(text, encoding="utf-8")
    return str(tmp_path / name)


def test_empty_cells_and_frames_without_a_row_are_no_readings(tmp_path):
    path = file_of(tmp_path, "bearing, frame ,other,range\n-1.5,0,x,60\n,3,,61.5\n\n")
    assert read_readings(path, QUANTITIES) == {0: {"range": 60.0, "bearing": -1.5}, 3: {"range": 61.5}}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", r":1: no column 'frame'; there are none"),
        ("frame,range\n0,1\n", r":1: no column 'bearing'; there are frame, range"),
        ("frame,range,bearing\n0,far,1\n", r":2: range 'far'; a finite number"),
        ("frame,range,bearing\n0,nan,1\n", r":2: range 'nan'; a finite number"),
        ("frame,range,bearing\n0.5,1,1\n", r":2: frame '0\.5'; a whole number"),
        ("frame,range,bearing\n,1,1\n", r":2: frame ''; a whole number"),
        ("frame,range,bearing\n-1,1,1\n", r":2: frame '-1'; a whole number"),
        ("frame,range,bearing\n2,1,1\n2,1,1\n", r":3: frame 2 again; one row a frame"),
    ],
)
def test_what_is_wrong_with_a_file_is_said_with_its_line(tmp_path, text, words):
    with pytest.raises(ReadingsError, match=words):
        read_readings(file_of(tmp_path, text), QUANTITIES)


def test_a_file_that_is_not_there_is_missing(tmp_path):
    parameters = CUE.parameters.model_validate({"file": str(tmp_path / "no.csv"), "sd": {"range": 1}})
    assert CUE.missing(parameters).endswith("no.csv: no such file of readings")
    assert CUE.files(parameters) == (str(tmp_path / "no.csv"),)
    assert CUE.gives(parameters) == ("range",)


def errors(graph):
    """Distances of the estimate from the target in frames in which it is hidden, px."""
    source = SceneSource.named("occluder_long", 0, 45)
    truth = [truth_of(source, index) for index in range(45)]
    results = track(graph, source, [Start(source.scene.start_box)])
    found = [np.hypot(*(np.array(one.targets[0].centre_box[:2]) - truth[one.frame.index])) for one in results]
    return np.array(found[25:40])


def truth_of(source, index):
    x, y, w, h = source.scene.truth[index]
    return np.array([x + w / 2, y + h / 2])


def test_a_radar_holds_a_ball_that_no_camera_sees(tmp_path):
    source, rng = SceneSource.named("occluder_long", 0, 45), np.random.default_rng(1)
    rows = ["frame,range,bearing"]
    for index in range(1, 45):
        x, y = truth_of(source, index) - (160, 480)
        noise = rng.standard_normal(2) * (2, 0.01)
        rows.append(f"{index},{math.hypot(x, y) + noise[0]},{math.atan2(y, x) + noise[1]}")
    path = file_of(tmp_path, "\n".join(rows) + "\n")
    plain = load_graph("radar_ball")
    with_radar = change_graph(plain.text, [f"radar.agent.readings.file={path}"])
    assert errors(with_radar).mean() < 4
    assert errors(plain).mean() > 8
