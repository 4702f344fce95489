"""Which names an expression has at its node, and which a constant has; messages are in `messages/`."""

from __future__ import annotations

import pytest

from bayesnet_track import GraphSpec
from bayesnet_track.graph.checks.factors import names_at
from bayesnet_track.graph.checks.plates import Plate
from bayesnet_track.graph.checks.run import check_graph
from bayesnet_track.graph.expressions.terms import FRAME_NAMES
from bayesnet_track.graph.text.messages import GraphError, Positions

BOX = ("x", "y", "w", "h")
PARENT = tuple(f"parent.{name}" for name in BOX)


LATENT = {"fuse": {"latent": {"given": {"sd_px": {"x": 3}}}}}


def plate_of(root, node=None, constants=None):
    nodes = {"s": root, "n": {"parent": "s", **(node or {})}, "a": {"parent": "n", "agent": "hue"}}
    spec = GraphSpec.model_validate({"name": "g", "targets": {"t": {"nodes": nodes}}})
    return Plate("t", spec.targets["t"], Positions(), {}, constants or {})


@pytest.mark.parametrize(
    ("motion", "belief", "names"),
    [
        ({"random_walk": {"sd_px": {"x": 1}}}, "particles", BOX),
        ("constant_velocity", "particles", (*BOX, "vx", "vy")),
        ("damped_velocity", "gaussian", (*BOX, "vx", "vy")),
        ("constant_acceleration", "particles", (*BOX, "vx", "vy", "ax", "ay")),
        ({"constant_velocity": {"sd_angle_deg": 2}}, "particles", (*BOX, "vx", "vy", "angle")),
        ("constant_velocity", "grid", BOX),
    ],
)
def test_the_names_are_those_of_the_state(motion, belief, names):
    plate = plate_of({"motion": motion, "belief": belief}, constants={"slope": 1.0})
    assert names_at(plate, "s") == names_at(plate, "n") == (*names, *FRAME_NAMES, "t", "slope")


@pytest.mark.parametrize(
    ("belief", "names"),
    [("particles", (*BOX, *PARENT, "parent.vx", "parent.vy")), ("gaussian", BOX), ("grid", BOX)],
)
def test_a_latent_node_has_a_box_of_its_own(belief, names):
    plate = plate_of({"motion": "constant_velocity"}, {**LATENT, "belief": belief})
    assert names_at(plate, "n") == (*names, *FRAME_NAMES, "t")


@pytest.mark.parametrize("name", ["x", "vx", "normal", "pi", "parent", "and"])
def test_a_constant_has_a_name_of_its_own(cues, name):
    nodes = {"s": {"motion": "constant_velocity"}, "a": {"parent": "s", "agent": "hue"}}
    graph = {"name": "g", "constants": {name: 1}, "targets": {"t": {"nodes": nodes}}}
    with pytest.raises(GraphError, match=f"constant '{name}', which is a word of expressions"):
        check_graph(graph, cues)


def test_a_checked_target_knows_its_factors_and_their_constants(cues):
    nodes = {
        "s": {"motion": "constant_velocity"},
        "a": {"parent": "s", "agent": "hue"},
        "f": {"parent": "s", "factor": "normal(h, slope * y, 8)"},
    }
    constants = {"slope": 0.3, "unused": 2}
    target = check_graph(
        {"name": "g", "constants": constants, "targets": {"t": {"nodes": nodes}}}, cues
    ).targets["t"]
    assert target.factors["f"].constants == {"slope": 0.3}
    assert target.order == ("s", "a")


@pytest.mark.parametrize(
    ("motion", "node", "belief", "fits"),
    [
        ("constant_velocity", {}, "particles", True),
        ({"expressions": {"fields": {"speed": {}}, "sd": {"x": 1}}}, {}, "particles", False),
        ({"expressions": {"fields": {"vx": {}, "vy": {}}, "sd": {"x": 1}}}, {}, "particles", True),
        ({"random_walk": {"sd_px": {"x": 3}}}, {}, "particles", False),
        ("constant_velocity", {}, "grid", False),
        ("constant_velocity", LATENT, "particles", False),
    ],
)
def test_what_an_agent_reads_is_a_field_of_its_node(motion, node, belief, fits):
    """`against: velocity` of the flow and the points."""
    for cue in ("motion", "klt"):
        nodes = {
            "s": {"motion": motion, "belief": belief},
            "n": {"parent": "s", **node},
            "a": {"parent": "n", "agent": {cue: {"against": "velocity"}}},
        }
        graph = {"name": "g", "targets": {"t": {"nodes": nodes}}}
        if fits:
            check_graph(graph)
            continue
        message = f"{cue} reads vx, vy, which the state of this node does not have"
        with pytest.raises(GraphError, match=message):
            check_graph(graph)
