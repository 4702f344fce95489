"""Suggestions for wrong command lines, one by one; `test_cli` has whole lines."""

import pytest

from bayesnet_track.cli.main import main
from bayesnet_track.cli.parser import make_parser, suggest, suggest_nearest


def test_a_suggestion_of_argparse_is_replaced_by_ours():
    for own in ("", ", maybe you meant 'run'?"):  # the second is of Python 3.15
        message = f"argument COMMAND: invalid choice: 'rnu'{own} (choose from run, demo)"
        assert suggest(message) == "no command 'rnu'; did you mean run?"


def test_the_nearest_name_or_nothing():
    assert suggest_nearest("--vidoe", ["--video", "--view"]) == "; did you mean --video?"
    assert suggest_nearest("--zzz", ["--video", "--view"]) == ""


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--video", "x.mp4"], "'x.mp4': the video is written into the run, as video.mp4: --video mp4"),
        (["--video", "general"], "'general': mkv or mp4 is needed, or nothing: write --video last"),
    ],
)
def test_the_video_takes_a_format_and_no_name(given, said, capsys):
    run = ["run", "general", "--source", "none", "--init", "1,2,3,4", "--out", "none"]
    lines = ([], ["--video"], ["--video", "mp4"])
    assert [make_parser().parse_args([*run, *line]).video for line in lines] == [False, "mkv", "mp4"]
    with pytest.raises(SystemExit):
        make_parser().parse_args([*run, *given])
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    "command",
    [
        ["fit", "general", "--motion", "--out", "none.yaml"],
        ["learn-shape", "none.npz", "--source", "none"],
        ["learn-stereo", "--source", "none", "--right", "none"],
    ],
)
def test_a_file_that_is_missing_is_named_with_its_option(command, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main([*command, "--truth", "none.txt"]) == 2
    said = f"bayesnet-track {command[0]}: --truth none.txt: No such file or directory; expected a text file"
    assert capsys.readouterr().err.startswith(said)
