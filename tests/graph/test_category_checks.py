"""Wrong uses of categories, with what is said of each, word for word.

A case of `messages/categories.txt` is ``=== name``, lines of the graph as they are replaced (``-`` by ``+``),
and the messages, each after ``-->`` and without the file's name.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from bayesnet_track.graph.checks.run import check
from bayesnet_track.graph.text.load import read_graph
from bayesnet_track.graph.text.messages import GraphError

TABLE = Path(__file__).parent / "messages" / "categories.txt"
GRAPH = """\
bayesnet: 1
name: teams
targets:
  player:
    birth: {detector: detections}
    nodes:
      player:
        belief: {gaussian: {filter: kalman}}
        motion: {constant_velocity: {sd_px: {x: 1, y: 1, w: 1, h: 1}}}
        category: {team: {values: [red, blue]}}
      seen:
        parent: player
        agent: {detection: {confusion: {team: {red: {red: 0.9, blue: 0.1}, blue: {red: 0.2, blue: 0.8}}}}}
"""


def _cases():
    cases = []
    for part in TABLE.read_text(encoding="utf-8").split("=== ")[1:]:
        name, *lines = part.rstrip("\n").split("\n")
        text, old = GRAPH, ""
        changes: dict[str, list[str]] = {}
        for line in lines:
            if line.startswith("-->"):
                continue
            if line.startswith("-"):
                old = line[1:]
            changes.setdefault(old, []).extend([line[1:]] if line.startswith("+") else [])
        for old, new in changes.items():
            assert f"{old}\n" in text, old
            text = text.replace(f"{old}\n", "".join(f"{line}\n" for line in new))
        said = [line.removeprefix("--> ") for line in lines if line.startswith("-->")]
        cases.append(pytest.param(text, said, id=name))
    return cases


def test_the_graph_itself_is_valid():
    spec, at = read_graph(GRAPH, "g.yaml")
    assert check(spec, at).spec.name == "teams"


@pytest.mark.parametrize(("text", "said"), _cases())
def test_it_is_said_what_is_wrong(text, said):
    with pytest.raises(GraphError) as error:
        spec, at = read_graph(text, "g.yaml")
        check(spec, at)
    assert [line.removeprefix("g.yaml:") for line in str(error.value).splitlines()] == said
