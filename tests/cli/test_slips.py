"""Suggestions for wrong command lines, one by one; `test_cli` has whole lines."""

import argparse

import pytest

from bayesnet_track.cli.options import add_video_option
from bayesnet_track.cli.parser import nearest, suggest


def test_a_suggestion_of_argparse_is_replaced_by_ours():
    for own in ("", ", maybe you meant 'run'?"):  # the second is of Python 3.15
        message = f"argument COMMAND: invalid choice: 'rnu'{own} (choose from run, demo)"
        assert suggest(message) == "no command 'rnu'; did you mean run?"


def test_the_nearest_name_or_nothing():
    assert nearest("--vidoe", ["--video", "--view"]) == "; did you mean --video?"
    assert nearest("--zzz", ["--video", "--view"]) == ""


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--video", "x.mp4"], "'x.mp4': the video is written into the run, as video.mp4: --video mp4"),
        (["--video", "general"], "'general': mkv or mp4 is needed, or nothing: write --video last"),
    ],
)
def test_the_video_takes_a_format_and_no_name(given, said):
    parser = argparse.ArgumentParser(exit_on_error=False)
    add_video_option(parser)
    assert [parser.parse_args(one).video for one in ([], ["--video"], ["--video", "mp4"])] == [
        False,
        "mkv",
        "mp4",
    ]
    with pytest.raises(argparse.ArgumentError, match=said):
        parser.parse_args(given)
