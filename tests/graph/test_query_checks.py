"""Queries: what they may ask, polygons in files, and every message (`messages/queries.txt`)."""

from __future__ import annotations

from pathlib import Path

import pytest

from bayesnet_track.graph.checks.queries import COLUMNS
from bayesnet_track.graph.checks.run import check, check_graph
from bayesnet_track.graph.text.load import read_graph
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.runtime.recording.interchange import TRACK_COLUMNS
from bayesnet_track.runtime.recording.tracks import CSV_COLUMNS

HEAD = """bayesnet: 1
name: g
constants: {goal_x: 610}
targets:
  ball:
    nodes:
      s: {motion: {constant_velocity: {}}}
      a: {parent: s, agent: hue}
  hand:
    nodes:
      s: {motion: {random_walk: {sd_px: {x: 9}}}}
      a: {parent: s, agent: hue}
queries:
"""
TABLE = (Path(__file__).parent / "messages" / "queries.txt").read_text("utf-8")
CASES = [part.strip().split("\n") for part in TABLE.split("=== ")[1:]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("graph")
    (folder / "zone.csv").write_text("x,y\n0,0\n10,0\n10,10\n0,0\n", encoding="utf-8")
    (folder / "two.csv").write_text("0,0\n10,0\n", encoding="utf-8")
    (folder / "words.csv").write_text("x,y\n0,0\n10,west\n", encoding="utf-8")
    return folder


def of(folder, query, cues):
    (folder / "g.yaml").write_text(f"{HEAD}  {query}\n", encoding="utf-8")
    return check(*read_graph(folder / "g.yaml"), cues)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case[0])
def test_messages(folder, cues, case):
    with pytest.raises(GraphError) as error:
        of(folder, case[1], cues)
    said = str(error.value).replace(f"{folder}/g.yaml:", "--> ").splitlines()
    assert said == case[2:]


def test_a_polygon_of_a_file_stands_in_the_graph(folder, cues):
    graph = of(folder, "inside: {of: ball, count: {polygon: zone.csv}}", cues)
    assert "polygon: [[0, 0], [10, 0], [10, 10]]" in graph.text
    again = check_graph(graph.spec, cues)  # the file is not needed any more
    assert again.text == graph.text


@pytest.mark.parametrize(
    "query",
    [
        'q: {of: ball, probability: "x > goal_x and abs(y - 240) < 60", event_above: 0.9}',
        'q: {of: ball, value: "hypot(vx, vy) / frame_s", unit: px/s, interval: 0.5}',
        'q: {of: [hand, ball], probability: "hypot(a.x - b.x, a.y - b.y) < 40"}',
        'q: {of: [ball, ball], value: "a.vx - b.vx"}',
        'q: {of: ball, count: {condition: "x > frame_width / 2"}}',
        "q: {of: ball, count: {polygon: [[0, 0], [10, 0], [10, 10]], point: foot}}",
    ],
)
def test_a_graph_with_a_query_is_written_and_read_again(folder, cues, query):
    graph = of(folder, query, cues)
    assert read_graph(graph.text)[0] == graph.spec
    assert "q" in graph.spec.queries


def test_names_of_columns_are_those_of_the_tables():
    assert set(COLUMNS) == {*CSV_COLUMNS, *TRACK_COLUMNS}
