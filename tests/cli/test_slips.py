"""Suggestions for wrong command lines, one by one; `test_cli` has whole lines."""

import argparse

import pytest

from bayesnet_track.cli.options.runs import add_video_option
from bayesnet_track.cli.slips import Parser, boxes_in_words, nearest, suggest


@pytest.mark.parametrize(
    ("given", "slips"),
    [
        (["--init", "1", "2", "3", "4"], ["--init takes one word, without spaces: --init 1,2,3,4"]),
        (["--init", "1,", "2.5,", "3,", "4"], ["--init takes one word, without spaces: --init 1,2.5,3,4"]),
        (["--learn", "1", "2"], ["--learn takes one word, without spaces: --learn 1,2"]),
        (["--init", "1,2,3,4", "5"], []),
        (["--init", "ball:1,2,3,4"], []),
        (["--end", "1", "2"], []),
        (["--init"], []),
    ],
)
def test_a_box_in_several_words_is_shown_as_one(given, slips):
    assert list(boxes_in_words(given)) == slips


def test_a_suggestion_of_argparse_is_replaced_by_ours():
    parser = argparse.ArgumentParser()
    parser.add_argument("command", metavar="COMMAND", choices=["run", "demo"])
    for own in ("", ", maybe you meant 'run'?"):  # the second is of Python 3.15
        message = f"argument COMMAND: invalid choice: 'rnu'{own} (choose from run, demo)"
        assert suggest(parser, message) == "no command 'rnu'; did you mean run?"


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


class Refused(Exception):
    """What a parser says instead of exiting."""


def refused(given, *options):
    class Strict(Parser):
        def exit(self, status=0, message=None):
            raise Refused(message)

    parser = Strict(prog="x")
    parser.add_argument("graph")
    for option in options:
        parser.add_argument(option, required=option == "--source")
    with pytest.raises(Refused) as said:
        parser.refuse(parser.parse_known_args(given)[1])
    return str(said.value)


def test_a_video_without_its_option_is_shown_with_it(tmp_path):
    video = tmp_path / "car.mp4"
    video.touch()
    said = refused(["general", str(video), "--out", "runs/x"], "--source", "--out")
    assert f"write --source {video}\n" in said
    assert f"write --source {video}\n" in refused(["general", "--seed=1", str(video)], "--source", "--seed")
    # What stands behind another option is no source, and a graph is none.
    assert "write" not in refused(["general", "--out", str(video)], "--source", "--out")
    graph = tmp_path / "own.yaml"
    graph.touch()
    assert "write" not in refused([str(graph), "a" * 300], "--source")


def test_truth_belongs_to_score():
    assert "`score RUN --truth FILE`" in refused(["general", "--truth", "a.txt"], "--target")
