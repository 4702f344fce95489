"""Options that several commands share: what they take, and what they refuse in which words."""

import shlex

import pytest

from bayesnet_track import load_graph
from bayesnet_track.cli.arguments import (
    UsageError,
    parse_start,
    read_start,
    run_folder,
    set_values,
)
from bayesnet_track.cli.batch.results import csv_text, result
from bayesnet_track.cli.batch.work import ROW
from bayesnet_track.cli.main import main
from bayesnet_track.cli.parser import make_parser
from bayesnet_track.graph.text.messages import GraphError

RUN = "run general --source none --init 1,2,3,4 --out none"


def parsed(line):
    return make_parser().parse_args(line.split())


def refused(line, capsys):
    """The message of a command that is refused."""
    try:
        code = main(shlex.split(line))
    except SystemExit as exit_request:
        code = exit_request.code
    assert code == 2
    return capsys.readouterr().err


def test_plugins_are_named_one_by_one_or_by_commas():
    options = parsed(f"{RUN} --allow-plugins a,b --allow-plugins c --cue-file x.py --cue-file y.py")
    assert options.allow_plugins == [["a", "b"], ["c"]] and options.cue_file == ["x.py", "y.py"]
    assert parsed(RUN).allow_plugins == []


@pytest.mark.parametrize(("line", "port"), [("", None), ("--view", 0), ("--view 8080", 8080)])
def test_a_view_has_a_free_port_or_that_which_is_given(line, port):
    assert parsed(f"{RUN} {line}").view == port


@pytest.mark.parametrize("port", ["80", "65536", "x", "٨٠٨٠"])
def test_other_ports_are_refused(port, capsys):
    assert "a port from 1024 to 65535 is needed" in refused(f"{RUN} --view {port}", capsys)


def test_a_calibration_belongs_to_a_pair(capsys):
    message = refused(f"{RUN} --calibration pair.yaml", capsys)
    assert "of a pair: give --right, --stereo or --depth, too" in message


def test_a_value_is_set_in_a_graph_by_its_path():
    graph = load_graph("two_squares")
    changed = set_values(graph.text, ["square.belief.particles.size=77"])
    assert changed.spec.targets["square"].nodes["square"].belief.particles.size == 77
    with pytest.raises(UsageError, match="--set 'size': PATH=VALUE is needed"):
        set_values(graph.text, ["size"])
    with pytest.raises(GraphError, match="unknown key 'sise'; allowed: size"):
        set_values(graph.text, ["square.belief.particles.sise=77"])


@pytest.mark.parametrize(
    ("text", "plate", "box"),
    [("1,2,3,4", None, (1, 2, 3, 4)), ("ball:-1,.5,3e1,4", "ball", (-1, 0.5, 30, 4))],
)
def test_start_boxes_name_their_plate_or_none(text, plate, box):
    start = parse_start(text)
    assert (start.plate, start.box) == (plate, box)
    with pytest.raises(UsageError, match="four numbers X,Y,W,H are needed"):
        parse_start(f"{text},5")


def test_a_start_box_is_that_of_its_frame(tmp_path):
    truth = tmp_path / "truth.txt"
    truth.write_text("1,2,3,4\nnan,nan,nan,nan\n")
    assert read_start(truth, 0).box == (1, 2, 3, 4)
    for frame, what in ((1, "the target is absent in frame 1"), (2, "it has boxes for frames 0 to 1")):
        with pytest.raises(UsageError, match=what):
            read_start(truth, frame)


def test_a_run_is_a_folder_not_a_video():
    assert str(run_folder("runs/mine")) == "runs/mine"
    with pytest.raises(UsageError, match=r"--out runs/mine --video mp4 writes runs/mine/video\.mp4"):
        run_folder("runs/mine.mp4")


def test_a_board_has_two_numbers_of_inner_corners(capsys):
    for text in ("9", "9x", "x6", "2x6", "9x101", "9×6"):
        line = f"calibrate stereo left right --board {text} --square 0.025 --out none.yaml"
        assert "--board" in refused(line, capsys)


@pytest.mark.parametrize(
    ("settings", "what"),
    [
        ("--set min_scor=0.5", "did you mean min_score"),
        ("--set min_score=0.5 --set min_score=0.6", "is given twice"),
        ("--set min_score", "key=value is needed"),
        ("--set min_score=2", "min_score: "),
        ("--set min_score=[1", "is no value"),
    ],
)
def test_parameters_are_checked_and_the_nearest_is_named(settings, what, capsys):
    assert what in refused(f"detect motion --source none --out none.txt {settings}", capsys)


def test_the_table_of_a_batch_leaves_empty_what_is_not_known():
    row = dict.fromkeys(ROW) | {"video": "a", "seed": 0, "status": "finished", "frames": 9, "lost_frames": 2}
    header, line = csv_text([row]).splitlines()
    assert header.split(",") == list(ROW) and line.startswith("a,0,finished,9,,2,")
    assert (
        result(row) == "9 frames, lost in 2"
        and result(row | {"auc": 0.5}) == "9 frames, auc 0.500, lost in 2"
    )
    assert result(row | {"status": "failed", "reason": "no disk"}) == "failed: no disk"


RECTANGLES = "".join(f"{n},1,{n + 50},1,51,31,1,31\n" for n in range(1, 9))
"""MOT of 8 columns, whose lines are rectangles as well."""


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("run general --source none --out {out} --init-from {file}", "--truth-format mot or polygons"),
        ("fit general --out {out} --source none --truth {file}", "--truth-format mot or polygons"),
        ("learn-shape {out} --source none --truth {file}", "--truth-format mot or polygons"),
        ("run general --source none --out {out} --init-from {file} --truth-format mot", "source 'none'"),
        ("run general --source none --out {out} --init-from {file} --truth-format polygons", "source 'none'"),
    ],
)
def test_a_truth_with_two_readings_is_refused_until_an_option_decides(tmp_path, capsys, command, message):
    path = tmp_path / "truth.txt"
    path.write_text(RECTANGLES)
    assert main(shlex.split(command.format(out=tmp_path / "out", file=path))) != 0
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(("form", "box"), [("mot", (51, 1, 51, 31)), ("polygons", (1, 1, 50, 30))])
def test_the_option_decides_where_the_target_starts(tmp_path, form, box):
    path = tmp_path / "truth.txt"
    path.write_text(RECTANGLES)
    assert read_start(path, 0, form).box == box
