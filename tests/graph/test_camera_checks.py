"""Wrong uses of cameras, views and states in metres, each with its message."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from bayesnet_track.graph.checks.run import check
from bayesnet_track.graph.text.load import load_graph, read_graph
from bayesnet_track.graph.text.messages import GraphError

MESSAGES = Path(__file__).parent / "messages"

GRAPH = """\
bayesnet: 1
name: street
queries: {}
cameras:
  north: {calibration: north.json}
targets:
  person:
    state: {ground: {unit: m}}
    existence: {}
    birth: {detector: detections}
    nodes:
      person:
        belief: {gaussian: {filter: extended}}
        motion: {constant_velocity: {sd_velocity: 0.5, sd: {w: 0.01, h: 0.01}}}
        fuse: product
      view: {parent: person, camera: north}
      seen: {parent: view, agent: detection}
"""
SEVERAL = GRAPH.replace(
    "  north: {calibration: north.json}\n",
    "  north: {calibration: north.json}\n  east: {calibration: east.json}\n",
).replace("camera: north}", "camera: [east, north]}")

# 6 m above the ground, looking down at 30 degrees
CAMERA = {
    "camera_matrix": [[800.0, 0.0, 320.0], [0.0, 800.0, 240.0], [0.0, 0.0, 1.0]],
    "rotation": [[1.0, 0.0, 0.0], [0.0, -0.5, -0.8660254037844386], [0.0, 0.8660254037844386, -0.5]],
    "translation": [0.0, 5.196152422706632, 3.0],
    "size": [640, 480],
}


def _cases(table, graph):
    cases = []
    for part in (MESSAGES / table).read_text(encoding="utf-8").split("=== ")[1:]:
        name, *lines = part.rstrip("\n").split("\n")
        old = "\n".join(line[1:] for line in lines if line.startswith("-") and not line.startswith("-->"))
        new = "\n".join(line[1:] for line in lines if line.startswith("+"))
        assert graph.count(old) == 1, name
        said = [line.removeprefix("--> ") for line in lines if line.startswith("--> ")]
        cases.append(pytest.param(graph.replace(old, new), said, id=name))
    return cases


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "north.json").write_text(json.dumps(CAMERA))
    (tmp_path / "east.json").write_text(json.dumps({**CAMERA, "translation": [1.0, 5.196152422706632, 3.0]}))
    return tmp_path


@pytest.mark.parametrize(
    ("text", "said"), [*_cases("cameras.txt", GRAPH), *_cases("several_cameras.txt", SEVERAL)]
)
def test_wrong_uses(text, said, folder):
    path = folder / "g.yaml"
    path.write_text(text)
    with pytest.raises(GraphError) as error:
        check(*read_graph(path))
    lines = str(error.value).replace(f"{folder}/", "").splitlines()
    assert [line.removeprefix("g.yaml:") for line in lines] == said


def test_the_graph_itself_is_right(folder):
    path = folder / "g.yaml"
    path.write_text(GRAPH)
    graph = load_graph(path)
    camera = graph.targets["person"].views["view"].camera
    assert camera.size == (640, 480)
    assert graph.calibrations["north.json"].path == folder / "north.json"


def test_a_list_of_cameras_is_a_view_of_each_in_the_order_of_the_graph(folder):
    path = folder / "g.yaml"
    path.write_text(SEVERAL)
    plate = load_graph(path).targets["person"]
    assert plate.order == ("person", "view.north", "seen.north", "view.east", "seen.east")
    assert {view: one.name for view, one in plate.views.items()} == {
        "view.north": "north",
        "view.east": "east",
    }
    assert plate.seen_by("seen.east").camera.translation[0] == 1.0
    assert plate.parent["seen.east"] == "view.east"


def test_names_of_nodes_below_a_list_of_cameras_are_those_of_each_camera(folder):
    path = folder / "g.yaml"
    path.write_text(
        SEVERAL.replace(
            "fuse: product",
            "fuse: {pool: {view: 2}}\n        adapt: {agents: [seen], activate: {above: {ud_box: 1}}, "
            "deactivate: {below: {ud_box: 0.5}}}",
        )
    )
    plate = load_graph(path).targets["person"]
    assert plate.inference("person").adapt.agents == ("seen.north", "seen.east")
    assert plate.inference("person").fuse.pool == {"view.north": 2.0, "view.east": 2.0}
    assert plate.governor == {"seen.north": "person", "seen.east": "person"}
