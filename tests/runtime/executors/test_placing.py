"""Agents are where the command line, the graph and the executor put them, in this order."""

from __future__ import annotations

import pytest

from bayesnet_track import load_graph
from bayesnet_track.engine.step import make_engine
from bayesnet_track.graph.text.messages import GraphError
from bayesnet_track.runtime.executors import PlacingError, make_executor, parse_places
from bayesnet_track.runtime.executors.placing import agent_specs, places_of

AGENTS = {"a": ("placed", {}), "b": ("placed", {"x": 1.0}), "c": ("kept", {})}


@pytest.fixture
def places(placed):
    engine = make_engine(placed.graph(AGENTS), 0, placed.cues)

    def of(default, **wanted):
        found = places_of(
            engine, default, {name.replace("__", "."): at for name, at in wanted.items()}, placed.cues
        )
        return [found["plate", agent] for agent in AGENTS]

    return of


def test_the_more_special_word_counts_and_opaque_agents_stay(places):
    assert places("engine") == ["engine", "engine", "engine"]
    assert places("process") == ["process", "process", "engine"]
    assert places("engine", b="process") == ["engine", "process", "engine"]
    assert places("process", b="process", plate__b="engine") == ["process", "engine", "engine"]


def test_what_cannot_be_is_refused_with_the_reason(places, placed):
    with pytest.raises(PlacingError, match="agent c cannot be in a process: kept keeps what cannot be sent"):
        places("engine", c="process")
    with pytest.raises(PlacingError, match="no agent 'd'; the graph has a, b, c"):
        places("engine", d="process")
    for text in ("a", "a=cloud", "=engine"):
        with pytest.raises(PlacingError, match="AGENT=WHERE is needed, WHERE one of engine, process"):
            parse_places([text])
    with pytest.raises(ValueError, match="executor 'thread'; there are serial, processes"):
        make_executor("thread")


def test_a_cue_that_no_other_process_can_make_is_refused(placed):
    with (
        pytest.raises(PlacingError, match="cannot be in a process: how its cue is made"),
        placed.executing({"a": ("unnamed", {})}, "processes"),
    ):
        pass


def test_the_graph_places_agents_and_refuses_what_is_opaque(tmp_path):
    text = """
bayesnet: 1
name: placed
targets:
  it:
    nodes:
      root: {fuse: product, motion: {random_walk: {sd_px: {x: 5, y: 5}}}}
      color: {parent: root, agent: color_histogram, on: process}
      flow: {parent: root, agent: motion, on: engine}
      klt: {parent: root, agent: opencv_tracker, on: %s}
"""
    path = tmp_path / "graph.yaml"
    path.write_text(text % "process")
    with pytest.raises(GraphError, match="klt: opencv_tracker keeps what cannot be sent to another process"):
        load_graph(path)
    path.write_text(text % "engine")
    engine = make_engine(load_graph(path))
    assert list(agent_specs(engine, places_of(engine, "process", {}))) == ["it.color"]
    assert list(agent_specs(engine, places_of(engine, "engine", {}))) == ["it.color"]
    assert list(agent_specs(engine, places_of(engine, "process", {"flow": "process"}))) == [
        "it.color",
        "it.flow",
    ]
