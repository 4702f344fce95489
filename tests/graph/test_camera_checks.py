"""Wrong uses of cameras, views and states in metres, each with its message."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from bayesnet_track.graph.checks.run import check
from bayesnet_track.graph.text.load import load_graph, read_graph
from bayesnet_track.graph.text.messages import GraphError

TABLE = Path(__file__).parent / "messages" / "cameras.txt"

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

# 6 m above the ground, looking down at 30 degrees
CAMERA = {
    "camera_matrix": [[800.0, 0.0, 320.0], [0.0, 800.0, 240.0], [0.0, 0.0, 1.0]],
    "rotation": [[1.0, 0.0, 0.0], [0.0, -0.5, -0.8660254037844386], [0.0, 0.8660254037844386, -0.5]],
    "translation": [0.0, 5.196152422706632, 3.0],
    "size": [640, 480],
}


def _cases():
    cases = []
    for part in TABLE.read_text(encoding="utf-8").split("=== ")[1:]:
        name, *lines = part.rstrip("\n").split("\n")
        old = "\n".join(line[1:] for line in lines if line.startswith("-") and not line.startswith("-->"))
        new = "\n".join(line[1:] for line in lines if line.startswith("+"))
        assert GRAPH.count(old) == 1, name
        said = [line.removeprefix("--> ") for line in lines if line.startswith("--> ")]
        cases.append(pytest.param(GRAPH.replace(old, new), said, id=name))
    return cases


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "north.json").write_text(json.dumps(CAMERA))
    return tmp_path


@pytest.mark.parametrize(("text", "said"), _cases())
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
    camera = graph.targets["person"].views["view"]
    assert camera.size == (640, 480)
    assert graph.calibrations["north.json"].path == folder / "north.json"
