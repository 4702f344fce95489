"""The cue of readings: what it takes from a file, what it refuses, and a hidden ball that it holds."""

from __future__ import annotations

import math
import os
import warnings
from pathlib import Path

import numpy as np
import pytest

from bayesnet_track import Start, Tracker, load_graph, track
from bayesnet_track.cues.readings import CUE, ReadingsError, read_readings
from bayesnet_track.graph.text.change import change_graph
from bayesnet_track.runtime.checkpoints.origins import file_sha256
from bayesnet_track.runtime.checkpoints.recipe import Recipe
from bayesnet_track.sources.entrances.notices import InputNotice
from bayesnet_track.sources.scenes.library import SceneSource

QUANTITIES = ("range", "bearing")


def file_of(tmp_path, text, name="radar.csv"):
    (tmp_path / name).write_text(text, encoding="utf-8")
    return str(tmp_path / name)


def test_empty_cells_and_frames_without_a_row_are_no_readings(tmp_path):
    path = file_of(tmp_path, "bearing, frame ,other,range\n-1.5,0,x,60\n,3,,61.5\n\n")
    assert read_readings(path, QUANTITIES).rows == {0: {"range": 60.0, "bearing": -1.5}, 3: {"range": 61.5}}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", r":1: no column 'frame'; there are none"),
        ("frame,range\n0,1\n", r":1: no column 'bearing'; there are frame, range"),
        ("frame,range,bearing,range\n0,1,2,3\n", r":1: 2 columns 'range'; there are frame, range"),
        ("frame,range,bearing\n0,far,1\n", r":2: range 'far'; a number, or nothing"),
        ("frame,range,bearing\n0,m,rad\n1,1,1\n", r":2: range 'm'; a number, or nothing"),
        ("frame,range,bearing\n1,371,8,-1,52\n", r":2: 5 cells under 3 columns; between commas"),
        ("frame;range;bearing\n1;371,8;1.5\n", r":2: '371,8': the comma may be a decimal point or group"),
        ("frame;range;bearing\n1;1,371;\n2;2,500;\n", r":2: '1,371': the comma may be a decimal point or"),
        ("frame,range,bearing\n0.5,1,1\n", r":2: frame '0\.5'; a whole number"),
        ("frame,range,bearing\n,1,1\n", r":2: frame ''; a whole number"),
        ("frame,range,bearing\n-1,1,1\n", r":2: frame '-1'; a whole number"),
        ("frame,range,bearing\n2,1,1\n2,,1\n", r":3: frame 2 again, with bearing 1 after range 1, bearing 1"),
    ],
)
def test_what_is_wrong_with_a_file_is_said_with_its_line(tmp_path, text, words):
    with pytest.raises(ReadingsError, match=words):
        read_readings(file_of(tmp_path, text), QUANTITIES)


SAME = {3: {"range": 371.8, "bearing": -1.5}, 9: {"range": 0.25}}


@pytest.mark.parametrize(
    "text",
    [
        "frame,range,bearing\n3,371.8,-1.5\n9,0.25,\n",
        "frame,range,bearing\r\n9,0.25\r\n3,371.8,-1.5\r\n",
        "\ufeffframe;range;bearing\n3;371,8;-1,5\n9;0,25;\n",
        "frame\trange\tbearing\n3\t371.8\t-1.5\n9\t0.25\tnan\n",
        "# frame,range,bearing\n3.0000e+00,3.718e+02,-1.5\n9,0.25,inf\n",
        'frame,range,bearing\n"3","371,8","-1,5"\n"9","0,25",""\n',
    ],
)
def test_files_of_spreadsheets_and_libraries_hold_the_same(tmp_path, text):
    assert read_readings(file_of(tmp_path, text), QUANTITIES).rows == SAME


def radar(tmp_path, rows):
    """The graph with readings `rows`, one for each line."""
    path = file_of(tmp_path, "\n".join(["frame,range,bearing", *rows]) + "\n")
    return change_graph(load_graph("radar_ball").text, [f"radar.agent.readings.file={path}"]), path


def notices(graph, path, end=10):
    """What the run of the first `end` frames says of the file."""
    source = SceneSource.named("occluder_long", 0, end)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        track(graph, source, [Start(source.scene.start_box)]).close()
    assert all(one.filename == __file__ for one in caught)
    return [str(one.message).removeprefix(f"{path}: ") for one in caught]


OUTSIDE = "readings are of frames that are not read"


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([f"{k},300,-1" for k in range(1, 10)], []),
        (
            [f"{k},300,-1" for k in range(20)],
            [f"10 of 20 {OUTSIDE} (10 to 19)"],
        ),
        (
            [f"{k},300,-1" for k in range(1, 11)],
            [f"1 of 10 {OUTSIDE} (frame 10)"],
        ),
        (["400,300,-1"], [f"1 of 1 {OUTSIDE} (frame 400)"]),
        (
            [f"{k},300,-1" for k in range(5)],
            ["the readings end at frame 4; the run goes on to 9 without any"],
        ),
        ([f"{k},300,-1" for k in (0, 4, 8)], []),
        (
            ["1,nan,-1", "5,300,-1", "9,,-inf"],
            ["2 rows with numbers that are not finite (1 to 9)"],
        ),
        ([], ["no reading in it"]),
        (["8,300,-1", "1,300,-1", "8,300,-1"], ["1 rows repeat a frame and its values (frame 8)"]),
    ],
)
def test_what_of_a_file_is_not_used_is_said(tmp_path, rows, said):
    found = notices(*radar(tmp_path, rows))
    assert len(found) == len(said)
    assert all(one.startswith(words) for one, words in zip(found, said, strict=True))


def test_a_tracker_without_a_known_end_says_what_is_no_number(tmp_path):
    graph, _ = radar(tmp_path, ["1,nan,-1", "500,300,-1"])
    with pytest.warns(InputNotice, match="1 rows with numbers that are not finite") as caught:
        Tracker(graph)
    assert len(caught) == 1


def test_a_file_that_is_written_anew_is_read_anew(tmp_path):
    """Also where it has the same size and time, and in the same process."""
    graph, path = radar(tmp_path, ["1,394,-1.88", "2,394,-1.88"])
    stamp = Path(path).stat()
    first = run_with(graph, tmp_path / "first")
    Path(path).write_text(Path(path).read_text().replace("394", "399"))
    os.utime(path, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    second = run_with(graph, tmp_path / "second")
    assert first.sha256 != second.sha256 == file_sha256(path)
    assert (tmp_path / "first" / "tracks.txt").read_text() != (tmp_path / "second" / "tracks.txt").read_text()


def run_with(graph, out):
    """The recorded file of readings of a run of four frames."""
    source = SceneSource.named("occluder_long", 0, 4)
    list(track(graph, source, [Start(source.scene.start_box)], out=out))
    (model,) = Recipe.read(out).models.values()
    return model


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


@pytest.mark.slow
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
