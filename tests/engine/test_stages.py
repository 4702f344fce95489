"""The stages of a graph: those that it asks for, and a frame enters no others."""

import sys
from pathlib import Path

import pytest

from bayesnet_track import Tracker, load_graph
from bayesnet_track.cli.main import main
from bayesnet_track.engine.compiled import compile_graph
from bayesnet_track.engine.step import compile_stages
from bayesnet_track.sources.scenes import make_scene

TABLES = ("arrange", "associate", "filter tables")
PAGE = Path(__file__).parents[2] / "docs" / "architecture.md"


def names(graph):
    return [stage.name for stage in compile_stages(compile_graph(load_graph(graph)))]


@pytest.mark.parametrize(
    ("graph", "stages"),
    [
        ("two_squares", ["filter", "measure, decide, learn", "load"]),
        (
            "sort",
            ["arrange", "associate", "filter tables", "filter", "measure, decide, learn", "tracks", "load"],
        ),
        ("carried_box", ["carry and filter", "join", "measure, decide, learn", "joins", "load"]),
        ("orange_and_gray_detected", ["filter", "measure, decide, learn", "tracks", "load"]),
    ],
)
def test_a_graph_has_the_stages_that_it_asks_for(graph, stages):
    assert [one for one in names(graph) if one != "scene cuts"] == stages


def test_the_command_prints_them_with_the_functions_that_do_the_work(capsys):
    assert main(["graph", "sort", "--plan"]) == 0
    printed = capsys.readouterr().out
    assert "1. arrange: engine.rows.finding.arrange\n" in printed
    assert "2. associate: engine.lifecycle.association.associate_first\n" in printed
    assert "6. tracks: engine.lifecycle.track_management.manage_tracks\n" in printed


def test_the_page_names_what_a_frame_enters(capsys):
    assert main(["graph", "two_squares", "--plan"]) == 0
    assert capsys.readouterr().out in PAGE.read_text(encoding="utf-8")
    scene = make_scene("two_squares", 0)
    images = list(scene.frames)[:4]
    tracker = Tracker("two_squares")
    tracker.init(images[0], scene.start_box)
    entered = set()

    def note(frame, event, argument):
        if event == "call":
            entered.add(frame.f_code)

    sys.setprofile(note)
    try:
        for image in images[1:]:
            tracker.update(image)
    finally:
        sys.setprofile(None)

    def functions(graph):
        return {
            call.__code__ for one in compile_stages(compile_graph(load_graph(graph))) for call in one.calls
        }

    for stage in compile_stages(compile_graph(load_graph("two_squares"))):
        assert stage.run.__code__ in entered
        assert any(call.__code__ in entered for call in stage.calls)
    others = set.union(*(functions(graph) for graph in ("sort", "carried_box", "orange_and_gray_detected")))
    strange = others - functions("two_squares")
    assert len(strange) >= 5 and not strange & entered
