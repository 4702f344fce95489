"""What expressions of a motion are checked for besides their text; messages are in `messages/`."""

import pytest

from bayesnet_track import GraphSpec
from bayesnet_track.graph.checks.factors import names_at
from bayesnet_track.graph.checks.motion import drift_of, sds_of
from bayesnet_track.graph.checks.plates import Plate
from bayesnet_track.graph.checks.run import check_graph
from bayesnet_track.graph.expressions.parse import term_text
from bayesnet_track.graph.spec import ByExpressions
from bayesnet_track.graph.text.messages import GraphError, Positions

MOTION = {"fields": {"speed": {"sd": 2}}, "drift": {"x": "x + speed*dt"}, "sd": {"x": 1.5, "speed": "-w"}}


def graph_of(motion, **more):
    nodes = {"s": {"motion": {"expressions": motion}}, "a": {"parent": "s", "agent": "hue"}}
    return {"name": "g", "targets": {"s": {"nodes": nodes}}, **more}


def test_numbers_and_texts_are_terms():
    motion = ByExpressions.model_validate(MOTION)
    assert {name: term_text(term) for name, term in drift_of(motion).items()} == {"x": "x + speed * dt"}
    assert {name: term_text(term) for name, term in sds_of(motion).items()} == {"x": "1.5", "speed": "-w"}


def test_factors_know_the_fields(cues):
    spec = check_graph(graph_of(MOTION), cues).spec
    assert names_at(Plate("s", spec.targets["s"], Positions(), {}, {}), "s")[:5] == (
        "x",
        "y",
        "w",
        "h",
        "speed",
    )


def test_a_constant_and_a_field_have_different_names(cues):
    with pytest.raises(GraphError, match="field 'speed', which is a constant"):
        check_graph(graph_of(MOTION, constants={"speed": 3}), cues)


def test_what_is_carried_moves_by_another_motion(cues):
    graph = graph_of(MOTION)
    graph["targets"]["t"] = {
        "nodes": {"t": {"motion": "constant_velocity"}, "b": {"parent": "t", "agent": "hue"}}
    }
    graph["joins"] = [{"between": ["t", "s"], "attachment": {}}]
    with pytest.raises(GraphError, match="attachment of s, whose motion is by expressions"):
        check_graph(GraphSpec.model_validate(graph), cues)
