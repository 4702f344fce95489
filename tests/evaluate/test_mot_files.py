"""MOT ground truth and tracks from files, and the command that scores them."""

import json

import pytest

from bayesnet_track.cli.main import main
from bayesnet_track.evaluate.truth import is_mot, read_mot_tracks, read_mot_truth

TRUTH = "1,1,0,0,10,10,1,1,1.0\n1,2,50,0,10,10,1,1,0.5\n1,3,90,0,10,10,0,8,1\n2,1,2,0,10,10,1,1,1\n"
TRACKS = "1,7,0,0,10,10,0.9,-1,-1,-1\n2,8,2,0,10,10,0.1,-1,-1,-1\n2,7,70,0,10,10,0,-1,-1,-1\n"
FIGURES = {"true_ids": 2, "true_boxes": 3, "track_boxes": 3, "fp": 1, "fn": 1, "idsw": 1, "mota": 0.0}
"""1 miss, 1 false box, 1 switch of 3 boxes; the one of confidence 0 is not missed."""


@pytest.fixture
def write(tmp_path):
    """Writes a file of this name into the test's folder."""

    def make(name, text):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
        return path

    return make


@pytest.fixture
def cli(capsys):
    """Runs a command: exit code, what it says, what it complains of."""

    def run(*arguments):
        code = main([str(argument) for argument in arguments])
        said = capsys.readouterr()
        return code, said.out, said.err

    return run


def test_boxes_of_confidence_0_are_not_scored_and_all_others_are(write):
    truth = read_mot_truth(write("gt.txt", TRUTH + "9 4 1 2 3 4 -1\n8\t4\t1\t2\t3\t4\n"))
    assert truth.frames.tolist() == [0, 0, 1, 8, 7] and truth.ids.tolist() == [1, 2, 1, 4, 4]
    assert truth.boxes[1].tolist() == [50, 0, 10, 10]
    assert read_mot_tracks(write("tracks.txt", TRACKS)).ids.tolist() == [7, 8, 7]
    assert len(read_mot_tracks(write("none.txt", "")).boxes) == 0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1,1,0,0,9,9,1\n2,1,0,0,9,9,1\n1,1,5,5,9,9,1\n", ":3: identity 1 is in frame 1 already, in line 1"),
        ("1,1,0,0,9,9,1\n\n1,2,0,zero,9,9,1\n", ":3: 'zero' is not a number; expected frame,id,"),
        ("1,1,0,0,9,9,0\n2,1,0,0,9,9,0\n", ": no true box to score; 2 boxes have confidence 0"),
        ("", ": no true box to score"),
        (
            "image_name,x1,y1,x2,y2\na_1.jpg,1,2,3,4\n",
            ":1: no column of the header is called frame (unknown: image_name); replace each name in "
            "image_name by the image's place in the folder, and call the frame numbers frame if they "
            "count from 1",
        ),
    ],
)
def test_a_wrong_truth_is_named(write, text, message):
    path = write("gt.txt", text)
    with pytest.raises(ValueError) as error:
        read_mot_truth(path)
    assert str(error.value).startswith(f"{path}{message}")


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("1,2,3,4", False),
        ("1,2,3,4,5,6,7,8", False),
        ("NaN NaN NaN NaN", False),
        ("", False),
        ("1,1,0,0,9,9", True),
        ("\n 1 1 0 0 9 9 1\n", True),
        ("1,1,0,0,9,9,1,1,1,\n", True),
        ("1,1,0,0,9,9,1,-1,-1,-1", True),
    ],
)
def test_what_is_taken_for_mot(write, line, expected):
    assert is_mot(write("truth.txt", line)) is expected


@pytest.mark.parametrize("of_a_run", [False, True])
def test_score_of_several_targets(cli, write, of_a_run):
    tracks, truth = write("run/tracks.txt", TRACKS), write("gt.txt", TRUTH)
    write("run/journal.jsonl", "")
    given = tracks.parent if of_a_run else tracks
    code, out, err = cli("score", given, "--truth", truth, "--json")
    shown = json.loads(out)
    assert (code, err) == (0, f"{truth}: 1 of 4 boxes have confidence 0 and are not scored\n") and {
        name: shown[name] for name in FIGURES
    } == FIGURES
    code, out, _ = cli("score", given, "--truth", truth)
    assert code == 0 and "\nidsw           1           identity switches\n" in out


def test_the_cut_off_and_trajectories_are_set_by_options(cli, write):
    """The two tracks are exact, and the third box is nowhere: 1 missed, 1 false, 1 switch in 2 frames."""
    tracks, truth, single = write("tracks.txt", TRACKS), write("gt.txt", TRUTH), write("one.txt", "1,2,3,4\n")
    code, out, _ = cli("score", tracks, "--truth", truth, "--cutoff", 10, "--trajectories", "--json")
    shown = json.loads(out)
    assert code == 0 and shown["cutoff_px"] == 10 and shown["gospa"] == pytest.approx(50**0.5)
    assert shown["tgospa"] == pytest.approx(75**0.5) and shown["tgospa_switch"] == pytest.approx(25**0.5)
    write("run/journal.jsonl", "")
    for option in (["--cutoff", 10], ["--trajectories"]):
        code, _, err = cli("score", single.parent / "run", "--truth", single, *option)
        assert code == 2 and f"{option[0]}: {single} is the ground truth of one target" in err


def test_a_run_brings_its_own_truth_of_several_targets(cli, write):
    for name, text in (("tracks.txt", TRACKS), ("journal.jsonl", ""), ("truth.txt", TRUTH)):
        path = write(f"run/{name}", text)
    code, out, _ = cli("score", path.parent, "--json")
    assert code == 0 and json.loads(out)["idsw"] == 1


def test_what_cannot_be_scored_is_the_users_mistake(cli, write, tmp_path):
    tracks, truth = write("tracks.txt", TRACKS), write("gt.txt", TRACKS.replace("10,10,0,-1", "10,10,1,-1"))
    boxes, detections = write("boxes.txt", "1,2,3,4\n"), write("det.txt", "1,-1,0,0,9,9\n1,-1,5,5,9,9\n")
    binary = tmp_path / "binary"
    binary.write_bytes(b"\xff\xfe\xff")
    for arguments, message in {
        (tracks,): f"{tracks}: a file of tracks brings no ground truth; name one with --truth FILE",
        (tracks, "--truth", truth, "--target", "1"): f"--target: all targets in {truth} are scored at once; "
        "leave it out",
        (tracks, "--truth", boxes): f"{boxes}:1: 4 numbers; expected 6 to 10 "
        "(frame,id,left,top,width,height,confidence,...)",
        (tracks, "--truth", tmp_path / "none"): f"{tmp_path / 'none'}: No such file or directory",
        (tracks, "--truth", binary): f"{binary}: not a text file",
        (detections, "--truth", truth): f"{detections}:2: identity -1 is in frame 1 already, in line 1",
    }.items():
        assert cli("score", *arguments) == (2, "", f"bayesnet-track score: {message}\n")
