"""Every message, word for word: the tables in `messages/` hold graphs and what is said of them.

A case is ``=== name``, the graph, and its messages, each after ``-->`` and without the file's name. In
`nodes.txt` and `checks.txt` the graph is the nodes of one target, five lines down and six columns in.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from bayesnet_track import GraphSpec
from bayesnet_track.graph.checks.run import check, check_graph
from bayesnet_track.graph.text.load import read_graph
from bayesnet_track.graph.text.messages import (
    MAX_MESSAGES,
    GraphError,
    Positions,
    listed,
    nearest,
    shown_value,
)
from bayesnet_track.observation.cue import installed_cues

TABLES = Path(__file__).parent / "messages"
HEAD = "bayesnet: 1\nname: g\ntargets:\n  t:\n    nodes:\n"


def _cases(table):
    cases = []
    for part in (TABLES / table).read_text(encoding="utf-8").split("=== ")[1:]:
        name, *lines = part.rstrip("\n").split("\n")
        graph = [line for line in lines if not line.startswith("--> ")]
        said = [line.removeprefix("--> ") for line in lines if line.startswith("--> ")]
        cases.append(pytest.param("\n".join([*graph, ""]), said, id=name))
    return cases


def _nodes(text):
    return HEAD + "".join(f"      {line}\n" for line in text.splitlines())


def _said(error):
    return [line.removeprefix("g.yaml:") for line in str(error.value).splitlines()]


@pytest.mark.parametrize(("text", "said"), _cases("files.txt"))
def test_files(text, said):
    with pytest.raises(GraphError) as error:
        read_graph(text, "g.yaml")
    assert _said(error) == said


@pytest.mark.parametrize(("text", "said"), _cases("nodes.txt"))
def test_nodes(text, said):
    with pytest.raises(GraphError) as error:
        read_graph(_nodes(text), "g.yaml")
    assert _said(error) == said


@pytest.mark.parametrize(("text", "said"), _cases("checks.txt"))
def test_checks(text, said, cues):
    spec, at = read_graph(_nodes(text), "g.yaml")
    with pytest.raises(GraphError) as error:
        check(spec, at, cues)
    assert _said(error) == said


@pytest.mark.parametrize(("text", "said"), _cases("measures.txt"))
def test_measures(text, said, cues):
    built_in = {name: installed_cues()[name] for name in ("readings", "detection")}
    spec, at = read_graph(_nodes(text), "g.yaml")
    with pytest.raises(GraphError) as error:
        check(spec, at, {**cues, **built_in})
    assert _said(error) == said


def test_a_graph_from_python_names_the_path_of_keys(cues):
    nodes = {"s": {"fuse": "product"}, "a": {"parent": "s", "agent": {"hue": {"bins": 1}}}}
    spec = GraphSpec.model_validate({"name": "g", "targets": {"t": {"nodes": nodes}}})
    with pytest.raises(GraphError) as error:
        check_graph(spec, cues)
    assert set(str(error.value).splitlines()) == {
        "<python>:targets.t.nodes.s: s: key 'motion' is missing at the root; "
        "allowed: random_walk, constant_velocity, damped_velocity, constant_acceleration, expressions, "
        "box_velocity",
        "<python>:targets.t.nodes.a.agent.hue.bins: a: bins is 1; "
        "allowed: a whole number at least 4, at most 128 (bins round the hue circle, count)",
    }


def test_plain_data_from_python_too(cues):
    nodes = {"s": {"motion": "constant_velocty"}, "a": {"parent": "s", "agent": "hue", "active": 1}}
    data = {"name": "g", "targets": {"t": {"nodes": nodes}}}
    with pytest.raises(GraphError) as error:
        check_graph(data, cues)
    assert str(error.value).splitlines() == [
        "<python>:targets.t.nodes.s.motion: s: unknown motion 'constant_velocty'; allowed: random_walk, "
        "constant_velocity, damped_velocity, constant_acceleration, expressions, box_velocity; "
        "nearest: constant_velocity",
        "<python>:targets.t.nodes.a.active: a: active is 1; allowed: true or false",
    ]
    nodes["s"], nodes["a"]["active"] = {"motion": "constant_velocity"}, True
    assert check_graph(data, cues).targets["t"].agents == ("a",)


def test_a_checked_graph_knows_its_tree(cues):
    nodes = {
        "flow": {"parent": "s", "agent": "motion"},
        "s": {
            "motion": "constant_velocity",
            "fuse": "product",
            "adapt": {"deactivate": {"below": {"ud_box": 1}}},
        },
        "color": {"parent": "s", "fuse": "pool", "adapt": {"deactivate": {"below": {"ud_box": 1}}}},
        "hist": {"parent": "color", "agent": {"hue": {"bins": 16}}},
        "other": {"parent": "color", "agent": "blobs"},
        "more": {"parent": "s", "agent": {"hue": {"bins": 64}}},
    }
    graph = check_graph({"name": "g", "targets": {"t": {"nodes": nodes}}}, cues)
    target = graph.targets["t"]
    assert target.root == "s"
    assert target.order == ("s", "flow", "color", "hist", "other", "more")
    assert target.children == {"s": ("flow", "color", "more"), "color": ("hist", "other")}
    assert target.parent["s"] is None
    assert target.parent["hist"] == "color"
    assert target.governor == {"flow": "s", "hist": "color", "other": "color", "more": "s"}
    assert target.parameters["hist"].bins == 16
    assert target.parameters["other"].window == (3, 3)
    assert read_graph(graph.text)[0] == graph.spec


def test_all_errors_of_all_targets_are_reported(cues):
    plate = "{nodes: {s: {motion: constant_velocity}, a: {parent: s, agent: hu}}}"
    spec, at = read_graph(f"name: g\ntargets:\n  t: {plate}\n  u: {plate}\n", "g.yaml")
    with pytest.raises(GraphError) as error:
        check(spec, at, cues)
    assert [(one.line, one.nearest) for one in error.value.errors] == [(3, "hue"), (4, "hue")]


def test_many_errors_are_cut_and_it_says_so():
    text = "name: g\ntargets: {}\n" + "".join(f"k{i}: 1\n" for i in range(500))
    with pytest.raises(GraphError) as error:
        read_graph(text, "g.yaml")
    assert len(error.value.errors) == MAX_MESSAGES
    assert str(error.value).endswith("\ng.yaml: and more errors")


def test_an_error_stands_at_what_was_written_nearest_to_it():
    at = Positions("f", {("a",): (1, 1)}, {(): (1, 1), ("a",): (1, 4)})
    assert at.message(("a", "b", "c"), "x").column == 4
    assert at.message(("a",), "x", on_key=True).column == 1
    assert at.message(("z",), "x").column == 1


def test_what_is_shown_stays_short_and_printable():
    assert listed(str(i) for i in range(20)).endswith("10, 11, ... (8 more)")
    assert len(shown_value("x" * 9999)) < 80
    assert len(shown_value("\x1b" * 9999)) < 130
    assert "\x1b" not in shown_value("\x1b[31m") + listed(["\x1b[31m"])
    assert shown_value({str(i): i for i in range(9)}) == "a mapping of 9 keys"
    assert nearest("zzz", ["activate"]) == ""


@pytest.mark.parametrize(
    ("word", "names", "near"),
    [
        ("max_rate", ["early_rate", "rate_max"], "rate_max"),
        ("max_rate", ["active", "learn_rate_max"], "learn_rate_max"),
        ("velocity", ["box_velocity", "random_walk"], "box_velocity"),
        ("deactivate", ["estimate", "learn"], ""),
        ("fusion", ["fuse", "learn"], "fuse"),
        ("rate", ["early_rate", "rate_max"], "rate_max"),
    ],
)
def test_the_nearest_name_has_the_same_words_or_letters(word, names, near):
    assert nearest(word, names) == near
