"""Wrong uses of sensors of quantities and of point states, with what is said of each, word for word.

A case of `messages/sensors.txt` is ``=== name``, lines of the graph as they are replaced (``-`` by ``+``),
and the messages, each after ``-->`` and without the file's name.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bayesnet_track.graph.checks.run import check
from bayesnet_track.graph.checks.sensors import read_inverses, sensors_of
from bayesnet_track.graph.text.load import read_graph
from bayesnet_track.graph.text.messages import GraphError

TABLE = Path(__file__).parent / "messages" / "sensors.txt"
GRAPH = """\
bayesnet: 1
name: sea
constants: {east: 10}
targets:
  ship:
    state: point
    existence: {}
    birth: {detector: detections}
    nodes:
      ship:
        belief: {gaussian: {filter: extended}}
        motion: {constant_velocity: {sd_velocity_px: 0.5}}
        estimate: mean
      radar:
        parent: ship
        agent:
          detection:
            sd: {range: 2, bearing: 0.01}
            within: {range: [0, 500], bearing: [-3.2, 3.2]}
        measures: {range: "hypot(x - east, y)", bearing: "atan2(y, x - east)"}
        inverse: {x: "east + range * cos(bearing)", y: "range * sin(bearing)"}
"""


def _cases():
    cases = []
    for part in TABLE.read_text(encoding="utf-8").split("=== ")[1:]:
        name, *lines = part.rstrip("\n").split("\n")
        text = GRAPH
        old = "\n".join(line[1:] for line in lines if line.startswith("-") and not line.startswith("-->"))
        new = "\n".join(line[1:] for line in lines if line.startswith("+"))
        assert text.count(old) == 1, name
        said = [line.removeprefix("--> ") for line in lines if line.startswith("--> ")]
        cases.append(pytest.param(text.replace(old, new), said, id=name))
    return cases


def _said(text):
    with pytest.raises(GraphError) as error:
        check(*read_graph(text, "g.yaml"))
    return [line.removeprefix("g.yaml:") for line in str(error.value).splitlines()]


@pytest.mark.parametrize(("text", "said"), _cases())
def test_wrong_uses(text, said):
    assert _said(text) == said


def test_the_graph_itself_is_right():
    plate = check(*read_graph(GRAPH, "g.yaml")).targets["ship"]
    assert set(plate.inverses["radar"].terms) == {"x", "y"}
    assert plate.inverses["radar"].anchor is None


def test_without_an_inverse_h_is_followed_from_the_middle_of_within():
    text = GRAPH[: GRAPH.index("        inverse")]
    anchor = check(*read_graph(text, "g.yaml")).targets["ship"].inverses["radar"].anchor
    assert anchor.place == pytest.approx(np.array([260.0, 0.0]), abs=1e-6)
    assert anchor.values == pytest.approx(np.array([250.0, 0.0]), abs=1e-6)


def test_agents_of_boxes_are_no_sensors():
    boxes = SimpleNamespace(agents={}, cues={})
    assert sensors_of(boxes) == {}
    assert read_inverses(boxes) == {}
