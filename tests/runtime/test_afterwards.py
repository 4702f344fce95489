"""A run that is over gets statuses by the share of its frames that is above a level."""

import csv
import io
from dataclasses import replace
from itertools import islice

import cv2
import pytest

from bayesnet_track import open_run, track
from bayesnet_track.cli.main import main
from bayesnet_track.graph.text.change import set_value
from bayesnet_track.graphs import find_graph
from bayesnet_track.runtime.recording.exports import DriftCheck, judge_afterwards
from bayesnet_track.sources.scenes import make_scene

ROOT = ("targets", "target", "nodes", "target", "guarantee")
ABOVE = 1.0  # never, while the run goes on


def made(folder, **guarantee):
    """A run of `general` over 12 frames of a scene, of which the last four are black."""
    scene = make_scene("gray_square", seed=0)
    (folder / "img").mkdir()
    for number, frame in enumerate(islice(scene.frames, 12)):
        cv2.imwrite(str(folder / "img" / f"{number:02}.png"), frame if number < 8 else frame * 0)
    graph = folder / "g.yaml"
    text = find_graph("general").read_text(encoding="utf-8")
    graph.write_text(set_value(text, ROOT, {"above": ABOVE, "frames": 1, **guarantee}), encoding="utf-8")
    for _ in track(graph, folder / "img", scene.start_box, out=folder / "run"):
        pass
    return open_run(folder / "run")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return made(tmp_path_factory.mktemp("afterwards"), afterwards=[0.5, 0.6, 0.7, ABOVE])


def test_seven_of_eleven_frames_may_be_called_at_the_level_of_three_quarters(run):
    own = run.metrics[1:]
    judged, (found,) = judge_afterwards(run)
    assert found == DriftCheck("1", 0.7, 0, 7, 11)
    assert [line.status == "tracking" for line in judged.metrics[1:]] == [line.score > 0.7 for line in own]
    assert judged.metrics[0] == run.metrics[0] and judged.events == run.events
    lost = [line.frame for line in run.metrics if line.status == "lost"]
    assert lost and [line.frame for line in judged.metrics if line.status == "lost"] == lost
    assert [line.centre_box for line in judged.metrics] == [line.centre_box for line in run.metrics]


def test_frames_after_the_target_has_ended_count_as_not_tracked(run):
    """Of its own 8 frames 7 are above 0.7, too many for that level; of the 11 of the run they are not."""
    ended = replace(run, metrics=run.metrics[:9])
    assert judge_afterwards(ended)[1] == (DriftCheck("1", 0.7, 0, 7, 8),)


def test_export_writes_what_was_judged(run, capsys):
    assert main(["export", run.name, "--format", "csv", "--afterwards"]) == 0
    said = capsys.readouterr()
    rows = list(csv.DictReader(io.StringIO(said.out)))
    assert sum(row["status"] == "tracking" for row in rows) == 1 + 7
    assert "target 1: tracking in 7 of 11 frames instead of 0, where the mean score is above 0.7" in said.err


def test_without_levels_there_is_nothing_to_judge_by(tmp_path, run, capsys):
    plain = made(tmp_path)
    judged, found = judge_afterwards(plain)
    assert judged.metrics == plain.metrics and found == ()
    assert main(["export", plain.name, "--format", "csv", "--afterwards"]) == 2
    assert "has a guarantee with levels for it" in capsys.readouterr().err
    assert main(["export", run.name, "--format", "arviz", "--afterwards", "--out", str(tmp_path / "a")]) == 2
    assert "--afterwards judges statuses" in capsys.readouterr().err
