"""An adaptive number of hypotheses in a whole run: it rises when a ball is thrown, and the log says why."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any, get_args

import pytest

from bayesnet_track import GraphSpec, Start, open_run, track
from bayesnet_track.cli.main import main
from bayesnet_track.journal.events.beliefs import ParticlesResized
from bayesnet_track.journal.net import Decision, replay
from bayesnet_track.journal.text.sentences import explain, why
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.scenes.library import SceneSource

GRAPH: dict[str, Any] = {
    "name": "thrown_ball",
    "targets": {
        "ball": {
            "nodes": {
                "ball": {
                    "belief": {
                        "particles": {
                            "size": {"kld_revised": {"bin_px": 8, "error": 0.05}},
                            "min": 300,
                            "max": 4000,
                        }
                    },
                    "motion": {"random_walk": {"sd_px": {"x": 15, "y": 15}}},
                },
                "color": {"parent": "ball", "agent": "color_histogram"},
            }
        }
    },
}
LAST, FLIGHT = 8, range(3, 8)


@pytest.fixture(scope="module")
def directory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of a run until the ball has been caught; the ball is thrown in frame 3."""
    where, scene = tmp_path_factory.mktemp("runs") / "thrown", make_scene("ball_between_children", 0)
    source, graph = SceneSource(scene, "scene:thrown"), GraphSpec.model_validate(GRAPH)
    results = track(graph, source, [Start(scene.start_box)], out=where)
    while next(results).frame.index < LAST:
        pass
    results.close()
    return where


def resizings(directory: Path) -> list[ParticlesResized]:
    events = open_run(directory).events
    return [event for event in events if isinstance(event, ParticlesResized)]


def test_the_number_rises_during_the_flight(directory: Path) -> None:
    sizes = {line.frame: line.particles for line in open_run(directory).metrics}
    assert {sizes[frame] for frame in range(FLIGHT[0])} == {300}
    assert sizes[FLIGHT[0]] > 2 * 300  # in the frame of the throw itself
    assert max(sizes[frame] for frame in FLIGHT) > 4 * 300
    assert all(300 <= size <= 4000 for size in sizes.values())


def test_the_journal_says_why(directory: Path) -> None:
    sizes = {line.frame: line.particles for line in open_run(directory).metrics}
    first = resizings(directory)[0]
    assert (first.frame, first.target, first.before) == (FLIGHT[0], "1", 300)
    assert first.early and first.particles == sizes[first.frame]
    assert first.bins is not None and first.bins > 1 and first.worth is not None and first.worth > 1
    assert first.turning is not None and first.turning > first.level == 0.05
    assert f"asks for {first.need:.0f} hypotheses" in explain(first)


def test_an_error_at_the_turning_value_keeps_the_number(directory: Path) -> None:
    """The sentence is true: run again with the error that it names, the throw does not change the number."""
    first = resizings(directory)[0]
    assert first.turning is not None
    for share, changes in ((1.01, False), (0.97, True)):
        graph = copy.deepcopy(GRAPH)
        particles = graph["targets"]["ball"]["nodes"]["ball"]["belief"]["particles"]
        particles["size"]["kld_revised"]["error"] = share * first.turning
        scene = make_scene("ball_between_children", 0)
        results = track(
            GraphSpec.model_validate(graph), SceneSource(scene, "scene:thrown"), [Start(scene.start_box)]
        )
        size = [next(results).targets[0].particles for _ in range(FLIGHT[0] + 1)][-1]
        results.close()
        assert (size > 300 * 1.25) == changes


def test_commands_tell_it(directory: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sentences = [explain(event) for event in resizings(directory)]
    assert main(["log", str(directory)]) == 0
    output = capsys.readouterr().out
    assert all(sentence.partition(": ")[2] in output for sentence in sentences)
    assert main(["log", str(directory), "--kind", "particles_resized"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == len(sentences)


def test_folding_the_decisions_passes_over_it(directory: Path) -> None:
    events = open_run(directory).events
    decisions = [event for event in events if isinstance(event, get_args(Decision))]
    assert not any(isinstance(decision, ParticlesResized) for decision in decisions)
    assert replay(decisions).targets["1"].active == {"color"}
    lines = open_run(directory).metrics
    assert f"{resizings(directory)[0].particles}" in why(events, lines, FLIGHT[0])
