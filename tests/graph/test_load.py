"""Graphs by name, by path, and from Python."""

from __future__ import annotations

import pytest

from bayesnet_track import GraphSpec, load_graph
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.graphs import find_graph, graph_names


@pytest.mark.parametrize("name", graph_names())
def test_every_installed_graph_is_lawful_and_bears_its_name(name):
    graph = load_graph(name)
    assert graph.spec.name == name
    assert load_graph(graph) is graph
    assert load_graph(GraphSpec.model_validate(graph.spec)).text == graph.text


def test_the_library():
    assert {"two_squares", "color_fusion", "general"} <= set(graph_names())
    assert find_graph("general").name == "general.yaml"
    with pytest.raises(KeyError, match="nearest: general"):
        find_graph("genral")


def test_a_path_is_read(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_bytes(find_graph("two_squares").read_bytes())
    assert load_graph(path).text == load_graph(str(path)).text == load_graph("two_squares").text


@pytest.mark.parametrize(
    ("name", "said"),
    [
        (
            "two_sqares",
            "two_sqares:1:1: graph: no installed graph of this name; allowed: "
            "a name that `bayesnet-track list` prints, or a path to a file; nearest: two_squares",
        ),
        ("no/such.yaml", "no/such.yaml:1:1: graph: cannot be read: No such file or directory"),
        ("a\0.yaml", r"'a\x00.yaml':1:1: graph: cannot be read: embedded null byte"),
    ],
)
def test_what_cannot_be_found_says_so(name, said):
    with pytest.raises(GraphError) as error:
        load_graph(name)
    assert str(error.value) == said


def test_a_graph_is_shown_by_name_and_size():
    graph = load_graph("general")
    assert repr(graph) == "CheckedGraph(general: 3 nodes, 2 of them agents)"
    assert repr(graph.targets) == "{'target': CheckedTarget(target: 3 nodes, 2 of them agents)}"


def test_a_graph_file_that_is_not_there_is_named_beside_the_nearest_one(tmp_path):
    (tmp_path / "own.yaml").write_text("bayesnet: 1")
    with pytest.raises(GraphError, match=r"cannot be read: No such file or directory; nearest: .*own\.yaml"):
        load_graph(tmp_path / "own.yml")
