"""How a latent node's state is held where its graph does not say."""

from __future__ import annotations

import pytest

from bayesnet_track import load_graph
from bayesnet_track.graph.checks.latent import form_of
from bayesnet_track.graph.checks.run import check_graph

XY = {"sd_px": {"x": 3, "y": 3}}


def form(given, fuse=None, root=None, measuring="m", nodes=None, motion=None, **part):
    """The form of `part`, below a root, with one agent or with the further `nodes`."""
    written = {
        "root": {"motion": motion or {"random_walk": XY}, **(root or {})},
        "part": {"parent": "root", "fuse": {"latent": {"given": given, **(fuse or {})}}, **part},
        "m": {"parent": "part", "agent": "intensity"},
        **(nodes or {}),
    }
    graph = check_graph({"bayesnet": 1, "name": "g", "targets": {"t": {"nodes": written}}})
    return form_of(graph.targets["t"], "part", measuring)


def score(parent="part", agent="color_histogram"):
    return {"parent": parent, "agent": agent}


def test_it_is_a_gaussian_where_all_below_is_measured():
    assert form(XY) == "gaussian"
    assert form({**XY, "offset_box": {"y": 0.2}, "size_box": {"w": 0.5}}) == "gaussian"
    assert form({"sd_px": {"x": 3}}) == form({"sd_px": {"x": 3, "y": 3, "w": 1}}) == "gaussian"
    pool = {"p": {"parent": "part", "fuse": "pool"}, "n": score("p"), "o": score("p", "texture")}
    assert form(XY, measuring="mno", nodes=pool) == "gaussian"
    assert form(XY, measuring="mn", nodes=pool) == "grid"
    inner = {"q": {"parent": "part", "fuse": {"latent": {"given": XY}}}, "n": score("q")}
    assert form(XY, measuring="mn", nodes=inner) == "gaussian"
    assert form(XY, measuring="m", nodes=inner) == "grid"


@pytest.mark.parametrize(
    "given",
    [
        {**XY, "heavy_tail": {"weight": 0.1, "factor": 3}},
        {**XY, "offset_box": {"y": 0.2}, "size_box": {"w": 0.5}},
        XY,
    ],
)
def test_it_is_a_grid_where_x_and_y_alone_are_uncertain(given):
    assert form(given, measuring="") == "grid"


@pytest.mark.parametrize(
    ("given", "further"),
    [
        ({"sd_px": {"x": 3}}, {}),
        ({"sd_px": {"x": 3, "y": 3, "w": 1}}, {}),
        ({"sd_box": {"x": 0.1, "y": 0.1}}, {}),
        ({**XY, "sd_log": {"scale": 0.1}}, {}),
        ({"x": "normal(parent.x, 3)"}, {}),
        (XY, {"motion": {"random_walk": {**XY, "sd_log": {"scale": 0.02}}}}),
        (XY, {"motion": {"expressions": {"sd": {"x": 3, "w": 1}}}}),
        (XY, {"nodes": {"f": {"parent": "part", "factor": "normal(x - parent.x, 0, 2)"}}}),
        (XY, {"fuse": {"draw": "one"}}),
        (XY, {"belief": "particles"}),
    ],
)
def test_it_is_one_draw_elsewhere(given, further):
    assert form(given, measuring="", **further) == "one"


def test_what_is_written_counts():
    assert form(XY, fuse={"draw": "kernel"}) == "kernel"
    assert form(XY, measuring="", belief="gaussian") == "gaussian"
    assert form(XY, belief="grid") == "grid"


def test_a_factor_of_the_own_state_is_no_measurement_and_fits_a_grid():
    assert form(XY, nodes={"f": {"parent": "part", "factor": "normal(y, 40, 9)"}}) == "grid"


def test_the_library_holds_its_parts_by_draws():
    """Their noise is not wider than what the agents distinguish, or is theirs to remember."""
    for name in ("person_parts", "person_leaning", "person_levels"):
        target = load_graph(name).targets["person"]
        assert {form_of(target, part, ()) for part in ("head", "torso")} == {"one"}
