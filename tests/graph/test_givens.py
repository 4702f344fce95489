"""Distributions of latent nodes and measurement functions: read with the constants that they use."""

from __future__ import annotations

from bayesnet_track import load_graph
from bayesnet_track.graph.checks.factors import MEASURE_CHECKS, is_drawn
from bayesnet_track.graph.checks.run import check_graph
from bayesnet_track.graph.text.formula_parts import given_lines, latex_given_lines


def test_a_distribution_is_read_with_the_constants_that_it_uses(cues):
    given = {"x": "laplace(parent.x + lean, 3)", "w": "parent.w / 2"}
    nodes = {
        "s": {"motion": "constant_velocity"},
        "n": {"parent": "s", "fuse": {"latent": {"given": given}}},
        "a": {"parent": "n", "agent": "hue"},
    }
    constants = {"lean": 2.0, "unused": 1.0}
    graph = check_graph({"name": "g", "constants": constants, "targets": {"t": {"nodes": nodes}}}, cues)
    found = graph.targets["t"].givens["n"]
    assert [is_drawn(term) for term in found.fields.values()] == [True, False]
    assert list(given_lines(found, "n_t")) == [
        "x of n_t ~ laplace(parent.x + lean, 3)",
        "w of n_t = parent.w / 2",
        "lean = 2",
    ]
    assert next(latex_given_lines(found, "n_t")).startswith(r"x(n_t) &\sim \mathrm{Laplace}\left(")


def test_measurement_functions_are_read_with_the_constants_that_they_use():
    found = load_graph("radar_ball").targets["ball"].measures["radar"]
    assert set(found.terms) == {"range", "bearing"}
    assert found.constants == {"radar_x": 160.0, "radar_y": 480.0}
    assert len(MEASURE_CHECKS) == 4
