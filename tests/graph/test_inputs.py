"""Inputs: columns of CSV files by frame or time as names in expressions, and the time itself."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from bayesnet_track import Start, load_graph, track
from bayesnet_track.cli.main import main
from bayesnet_track.graph.text.explain import describe_error
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.sources.entrances.notices import InputNotice

PAN = [0.0, 4.0, 7.0, 7.0, 3.0, 1.0]
BOX = (60, 50, 20, 20)
ROWS = "".join(f"{frame},{pan}\n" for frame, pan in enumerate(PAN))


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    folder = tmp_path_factory.mktemp("images")
    for number in range(len(PAN)):
        assert cv2.imwrite(str(folder / f"{number}.png"), np.tile(np.arange(160, dtype=np.uint8), (120, 1)))
    return str(folder / "*.png")


def write(tmp_path, motion, columns=f"frame,pan\n{ROWS}", *, more="", below="", inputs=""):
    (tmp_path / "camera.csv").write_text(columns, encoding="utf-8")
    rows = "".join(f"{frame},{70 + pan},60\n" for frame, pan in enumerate(PAN))
    (tmp_path / "seen.csv").write_text(f"frame,u,y\n{rows}", encoding="utf-8")
    file = tmp_path / "camera.csv"
    inputs = inputs or f"{{pan: {{file: {file}{more}}}}}"
    text = (
        f"bayesnet: 1\nname: m\ninputs: {inputs}\ntargets:\n  a:\n    nodes:\n"
        f"      a: {{belief: {{gaussian: {{filter: extended, gate: 1}}}}, motion: {motion}, estimate: mean, "
        f"fuse: product}}\n      s: {{parent: a, agent: {{readings: {{file: {tmp_path / 'seen.csv'}, "
        f"sd: {{y: 2}}}}}}}}\n{below}"
    )
    path = tmp_path / "m.yaml"
    path.write_text(text, encoding="utf-8")
    return str(path)


def formula(drift):
    return f"{{expressions: {{drift: {{{drift}}}, sd: {{x: 1, y: 1}}}}}}"


def columns_of(path, images):
    return [line.targets[0].centre_box[0] for line in track(load_graph(path), images, [Start(BOX)], seed=1)]


def test_a_pan_angle_moves_what_rests(tmp_path, images):
    path = write(tmp_path, formula("x: x + pan - pan_before"))
    assert np.allclose(columns_of(path, images), 69.5 + np.array(PAN), atol=1e-9)


@pytest.mark.parametrize(("between", "values"), [("linear", [2, 4, 6, 8]), ("nearest", [0, 0, 8, 8]), (
    "previous", [0, 0, 0, 8])])  # fmt: skip
def test_between_two_rows_the_value_is_as_the_graph_says(tmp_path, images, between, values):
    path = write(tmp_path, formula("x: 50 + pan"), "frame,pan\n0,0\n4,8\n9,8\n", more=f", between: {between}")
    assert np.allclose(columns_of(path, images)[1:5], 50.0 + np.array(values), atol=1e-9)


def test_a_file_may_go_by_seconds_and_have_other_names(tmp_path, images):
    columns = "time_s;yaw rate;x\n0;0;9\n10;100;9\n"  # images come at 25 a second
    path = write(tmp_path, formula("x: 50 + pan"), columns, more=", column: yaw rate")
    found = np.array(columns_of(path, images)[1:])
    steps = np.diff(found)
    assert np.allclose(steps, steps[0]) and steps[0] == pytest.approx(10 / 25, rel=0.3)


def test_the_time_is_the_number_of_the_frame(tmp_path, images):
    path = write(tmp_path, formula("x: 50 + 3 * t"))
    assert np.allclose(columns_of(path, images)[1:], 50.0 + 3.0 * np.arange(1, len(PAN)), atol=1e-9)


def test_factors_and_measurements_read_inputs(tmp_path, images):
    walk = "{random_walk: {sd_px: {x: 5, y: 1}}}"
    below = (
        f"      u: {{parent: a, agent: {{readings: {{file: {tmp_path / 'seen.csv'}, sd: {{u: 0.01}}}}}}, "
        "measures: {u: x + pan}}\n"
    )
    path = write(tmp_path, walk, below=below)
    assert np.allclose(columns_of(path, images)[1:], 70.0, atol=0.01)
    below = "      f: {parent: a, factor: 'normal(x, 60 + pan, 0.1)'}\n"
    path = write(tmp_path, walk, below=below)
    assert np.allclose(columns_of(path, images)[1:], 60.0 + np.array(PAN[1:]), atol=0.4)


def test_what_a_file_lacks_is_said(tmp_path, images):
    path = write(tmp_path, formula("x: 50 + pan"), "frame,pan\n1,1\n2,1\n3,1\n")
    with pytest.warns(InputNotice) as notices:
        found = columns_of(path, images)
    said = [str(one.message) for one in notices]
    assert any("camera.csv: no row before frame 1; its values hold from 0 on" in one for one in said)
    assert any("camera.csv: no row after frame 3; its values hold until 5" in one for one in said)
    assert np.allclose(found[1:], 51.0)


def test_a_run_is_taken_up_again_with_equal_bytes_and_refuses_another_file(tmp_path, images, capsys):
    graph = write(tmp_path, formula("x: x + pan - pan_before"))
    whole, part = tmp_path / "whole", tmp_path / "part"
    for _ in track(graph, images, [Start(BOX)], seed=1, out=str(whole), checkpoint_every=1e-9):
        pass
    broken = track(graph, images, [Start(BOX)], seed=1, out=str(part), checkpoint_every=1e-9)
    for _ in range(3):
        next(broken)
    broken.close()
    columns = (tmp_path / "camera.csv").read_text(encoding="utf-8")
    (tmp_path / "camera.csv").write_text(columns + "9,0\n", encoding="utf-8")
    assert main(["resume", str(part), "-q"]) != 0
    assert "camera.csv" in capsys.readouterr().err
    (tmp_path / "camera.csv").write_text(columns, encoding="utf-8")
    assert main(["resume", str(part), "-q"]) == 0
    assert (part / "frames.npy.gz").read_bytes() == (whole / "frames.npy.gz").read_bytes()


WRONG = {
    "frame,tilt\n0,1\n": "camera.csv:1: no column 'pan'; there are frame, tilt",
    "pan\n1\n": "camera.csv:1: no column frame or time_s; allowed: one of them; there are pan",
    "frame,time_s,pan\n0,0,1\n": "camera.csv:1: both frame and time_s; allowed: one of them",
    "frame,pan\n": "camera.csv: no row below the header; allowed: one or more",
    "frame,pan\n0,far\n": "camera.csv:2: pan 'far'; a finite number with a decimal point",
    "frame,pan\n0,1\n1,nan\n": "camera.csv:3: pan 'nan'; a finite number with a decimal point",
    "frame,pan\n0,1\n1,\n": "camera.csv:3: pan ''; a finite number with a decimal point",
    "frame,pan\n3,1\n2,1\n": "camera.csv:3: frame 2 after 3; allowed: rows in rising order",
    "frame,pan\n1.5,1\n": "camera.csv:2: frame 1.5; a whole number from 0 on",
    "frame,pan,pan\n0,1,2\n": "camera.csv:1: 2 columns 'pan'; there are frame, pan, pan",
}


@pytest.mark.parametrize("columns", WRONG)
def test_a_wrong_file_is_refused_with_what_was_found(tmp_path, columns):
    with pytest.raises(GraphError) as error:
        load_graph(write(tmp_path, formula("x: x + pan"), columns))
    assert WRONG[columns] in str(error.value) and "m.yaml:3:" in str(error.value)


NAMES = {
    "{x: {file: camera.csv}}": "input 'x', which is a word of expressions; allowed: another name",
    "{t: {file: camera.csv}}": "input 't', which is a word of expressions; allowed: another name",
    "{pan: {file: nowhere.csv}}": "nowhere.csv: no such file",
    "{pan: {}}": "key 'file' is missing",
    "{pan: {file: camera.csv, between: cubic}}": "between is 'cubic'; allowed: one of linear",
}


@pytest.mark.parametrize("inputs", NAMES)
def test_a_wrong_input_is_refused_with_what_to_do(tmp_path, inputs):
    with pytest.raises(GraphError) as error:
        load_graph(write(tmp_path, formula("x: x"), inputs=inputs))
    assert NAMES[inputs] in str(error.value)


HINTS = {
    "gyro": "hint: a column of a CSV file is an input: inputs: {gyro: {file: FILE.csv}}",
    "width": "hint: width is written w; a column of a CSV file is an input: inputs: {width: ",
    "frame": "t is the time in frame intervals, the frame's number",
}


@pytest.mark.parametrize("name", HINTS)
def test_an_unknown_name_is_refused_with_where_it_may_come_from(tmp_path, name):
    with pytest.raises(GraphError) as error:
        load_graph(write(tmp_path, formula(f"x: x + {name} * dt")))
    assert f"unknown name '{name}'" in str(error.value) and HINTS[name] in describe_error(error.value)
