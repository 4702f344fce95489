"""The density of a net, as text and LaTeX."""

from __future__ import annotations

import pytest

from bayesnet_track import GraphSpec, load_graph
from bayesnet_track.graph.checks.run import check_graph
from bayesnet_track.graph.text.formula import (
    Integral,
    Likelihood,
    Product,
    factor_text,
    formula_latex,
    formula_text,
)
from bayesnet_track.graph.text.formula_parts import (
    latent_nodes,
    latex_motion_lines,
    mode_lines,
    motion_lines,
    moves,
)

WALK = {"random_walk": {"sd_px": {"x": 20, "y": 10}}}
PREDICTED = "p(s_t | e_1:t-1)"


@pytest.fixture
def target(cues):
    def make(nodes):
        spec = GraphSpec.model_validate({"name": "g", "targets": {"s": {"nodes": nodes}}})
        return check_graph(spec, cues).targets["s"]

    return make


def _fusion(pool="pool"):
    return {
        "s": {"motion": WALK, "fuse": "product"},
        "color": {"parent": "s", "fuse": pool},
        "hist": {"parent": "color", "agent": "hue"},
        "blobs": {"parent": "color", "agent": "blobs"},
        "flow": {"parent": "s", "agent": "motion"},
    }


def _first(text):
    return text.splitlines()[0]


def test_product_over_pool(target):
    assert formula_text(target(_fusion())).splitlines() == [
        f"p(s_t | e_1:t) ∝ {PREDICTED} · [p(e_hist | s_t)^½ · p(e_blobs | s_t)^½] · p(e_flow | s_t)",
        f"{PREDICTED} = ∫ p(s_t | s_t-1) p(s_t-1 | e_1:t-1) d s_t-1",
        "p(s_t | s_t-1): random walk, sd x 20 px, y 10 px",
    ]


def test_the_noise_of_velocities_is_told(target):
    nodes = _fusion()
    nodes["s"]["motion"] = {"constant_velocity": {"sd_px": {"x": 2}, "sd_velocity_px": 1.5}}
    expected = "p(s_t | s_t-1): constant velocity, sd x 2 px, sd velocity 1.5 px/frame"
    assert formula_text(target(nodes)).splitlines()[-1] == expected
    assert motion_lines(target(nodes)) == latex_motion_lines(target(nodes)) == []


def test_a_motion_by_expressions_is_an_equation_for_each_field(target):
    nodes = _fusion()
    nodes["s"]["motion"] = {
        "expressions": {
            "fields": {"vy": {"sd": 3}},
            "drift": {"y": "y + vy * dt", "vy": "exp(-dt / 4) * vy"},
            "sd": {"x": "0.1 * h", "vy": 2},
            "borders": "reflect",
        }
    }
    assert formula_text(target(nodes)).splitlines()[2:] == [
        "p(s_t | s_t-1): by expressions, reflected at the borders",
        "x_t = x + noise of sd (0.1 * h) · √dt",
        "y_t = y + vy * dt",
        "vy_t = exp(-dt / 4) * vy + noise of sd 2 · √dt",
    ]
    rows = formula_latex(target(nodes)).splitlines()
    assert rows[3:5] == [
        r"x_{t} &\sim \mathcal{N}\left(x,\, \left(0.1 \, h\right)^{2} \, \Delta t\right) \\",
        r"y_{t} &= y + \mathit{vy} \, \Delta t \\",
    ]


def test_constants_of_a_motion_are_told(cues):
    motion = {"expressions": {"drift": {"y": "y + fall"}, "sd": {"x": 1}}}
    nodes = {"s": {"motion": motion}, "a": {"parent": "s", "agent": "hue"}}
    graph = {"name": "g", "constants": {"fall": 2.5, "other": 1}, "targets": {"s": {"nodes": nodes}}}
    checked = check_graph(graph, cues).targets["s"]
    assert formula_text(checked).splitlines()[-1] == "fall = 2.5"
    assert r"\mathit{fall} &= 2.5" in formula_latex(checked)


def test_what_a_motion_depends_on_is_told(target):
    nodes = _fusion()
    further = {"size_reversion": {"sd_scale": 0.4}, "camera": "compensate", "inflate": {}, "relocalize": {}}
    nodes["s"]["motion"] = {
        "random_walk": {"sd_box": {"x": 0.1, "y": 0.1}, "sd_log": {"scale": 0.1}, **further}
    }
    assert formula_text(target(nodes)).splitlines()[-1] == (
        "p(s_t | s_t-1): random walk, sd x 0.1 √(wh), y 0.1 √(wh), scale 0.1 log, "
        "up to 4 times that while unsure, around the first size, with the camera, "
        "anywhere with probability 0.1 while unsure"
    )


def test_the_weights_of_a_pool_are_its_exponents(target):
    two_to_one = _first(formula_text(target(_fusion({"pool": {"hist": 2, "blobs": 1}}))))
    assert "[p(e_hist | s_t)^(2/3) · p(e_blobs | s_t)^(1/3)]" in two_to_one
    odd = _first(formula_text(target(_fusion({"pool": {"hist": 0.7123, "blobs": 0.2877}}))))
    assert "[p(e_hist | s_t)^0.712 · p(e_blobs | s_t)^0.288]" in odd


def test_inactive_agents_are_left_out_and_the_weights_scaled_again(target):
    text = formula_text(target(_fusion({"pool": {"hist": 2, "blobs": 1}})), {"blobs"})
    assert _first(text) == f"p(s_t | e_1:t) ∝ {PREDICTED} · p(e_blobs | s_t)"
    assert text.splitlines()[-1] == "left out (switched off): hist, flow"


def test_without_agents_only_the_prediction_is_left(target):
    assert _first(formula_text(target(_fusion()), ())) == f"p(s_t | e_1:t) ∝ {PREDICTED}"
    assert factor_text(target(_fusion()), ()) is None


def test_a_latent_node_integrates_over_its_own_state(target):
    latent = {"latent": {"given": {"sd_px": {"x": 6, "y": 6}}}}
    text = formula_text(target(_fusion(latent)))
    inner = "p(e_hist | color_t) · p(e_blobs | color_t)"
    assert f"[∫ p(color_t | s_t) · {inner} d color_t]" in _first(text)
    assert "p(color_t | s_t): Gaussian, sd x 6 px, y 6 px" in text


@pytest.mark.parametrize(
    ("belief", "said"),
    [
        ("particles", ""),
        ("gaussian", "; its likelihood a Gaussian"),
        ("grid", "; its likelihood on a grid"),
    ],
)
def test_how_a_latent_state_is_held(target, belief, said):
    nodes = _fusion({"latent": {"given": {"sd_px": {"x": 6, "y": 6}}}})
    nodes["color"]["belief"] = belief
    text = formula_text(target(nodes))
    assert text.splitlines()[-1] == f"p(color_t | s_t): Gaussian, sd x 6 px, y 6 px{said}"


def test_a_latent_root_has_two_states(target):
    nodes = _fusion()
    nodes["s"]["fuse"] = {"latent": {"given": {"sd_box": {"x": 0.1}}}}
    text = formula_text(target(nodes))
    assert f"{PREDICTED} · [∫ p(s_own_t | s_t) · [p(e_hist | s_own_t)^½" in text
    assert "p(s_own_t | s_t): Gaussian, sd x 0.1 √(wh)" in text


def test_the_factor_is_data(target):
    hist, flow = Likelihood("hist", "s"), Likelihood("flow", "s")
    assert factor_text(target(_fusion()), {"hist", "flow"}) == Product(((hist, 1.0), (flow, 1.0)))
    latent = {"latent": {"given": {"sd_px": {"x": 6}}}}
    only = factor_text(target(_fusion(latent)), {"hist"})
    assert only == Integral("color", "s", Likelihood("hist", "color"))


def test_latex(target):
    nodes = _fusion()
    nodes["my_cue"] = nodes.pop("flow")
    assert formula_latex(target(nodes), {"hist", "blobs"}).splitlines() == [
        r"\begin{align*}",
        r"p(\mathit{s}_{t} \mid e_{1:t}) &\propto p(\mathit{s}_{t} \mid e_{1:t-1}) \, "
        r"p(e_{\mathrm{hist}} \mid \mathit{s}_{t})^{1/2} \, "
        r"p(e_{\mathrm{blobs}} \mid \mathit{s}_{t})^{1/2} \\",
        r"p(\mathit{s}_{t} \mid e_{1:t-1}) &= \int p(\mathit{s}_{t} \mid \mathit{s}_{t-1}) \, "
        r"p(\mathit{s}_{t-1} \mid e_{1:t-1}) \, d\mathit{s}_{t-1}",
        r"\end{align*}",
        "% left out (switched off): my_cue",
    ]
    assert r"p(e_{\mathrm{my\_cue}} \mid" in formula_latex(target(nodes))


def test_latex_of_a_latent_node(target):
    text = formula_latex(target(_fusion({"latent": {"given": {"sd_px": {"x": 6}}}})))
    inner = r"p(\mathit{color}_{t} \mid \mathit{s}_{t}) \, p(e_{\mathrm{hist}} \mid \mathit{color}_{t})"
    assert rf"\left[\int {inner}" in text


def test_a_part_says_where_it_lies_in_its_parents_box(target):
    given = {"offset_box": {"y": -0.4}, "size_box": {"h": 0.25}, "sd_px": {"x": 2, "y": 2}}
    text = formula_text(target(_fusion({"latent": {"given": given}})))
    assert "p(color_t | s_t): Gaussian around (x, y - 0.4 h), 1 w by 0.25 h, sd x 2 px, y 2 px" in text


def test_factors_stand_in_the_density_and_below_it(cues):
    nodes = _fusion()
    nodes["s"]["motion"] = WALK
    nodes["size"] = {"parent": "s", "factor": "normal(h, slope * y + 12, 8)"}
    nodes["old"] = {"parent": "color", "factor": "exp(-x)"}
    plain = {"name": "g", "constants": {"slope": 0.32}, "targets": {"s": {"nodes": nodes}}}
    target = check_graph(plain, cues).targets["s"]
    lines = formula_text(target).splitlines()
    assert lines[0] == (
        f"p(s_t | e_1:t) ∝ {PREDICTED} · [p(e_hist | s_t)^½ · p(e_blobs | s_t)^½ · old(s_t)] · "
        "p(e_flow | s_t) · size(s_t)"
    )
    assert lines[3:] == ["size(s_t) = normal(h, slope * y + 12, 8), slope = 0.32", "old(s_t) = exp(-x)"]
    latex = formula_latex(target).splitlines()
    assert latex[1].endswith(r"\, \mathrm{size}(\mathit{s}_{t}) \\")
    assert latex[3] == (
        r"\mathrm{size}(\mathit{s}_{t}) &= \mathcal{N}\left(h;\, \mathit{slope} \, y + 12,\, 8\right)"
        r", \quad \mathit{slope} = 0.32 \\"
    )
    assert latex[4] == r"\mathrm{old}(\mathit{s}_{t}) &= \exp\left(-x\right)"


def test_a_factor_of_a_latent_node_is_inside_the_integral(target):
    nodes = {
        "s": {"motion": WALK},
        "part": {"parent": "s", "fuse": {"latent": {"given": {"sd_px": {"x": 3}}}}},
        "look": {"parent": "part", "agent": "hue"},
        "near": {"parent": "part", "factor": "normal(x - parent.x, 0, 2)"},
    }
    lines = formula_text(target(nodes)).splitlines()
    assert lines[0].endswith("[∫ p(part_t | s_t) · p(e_look | part_t) · near(part_t) d part_t]")
    assert lines[-1] == "near(part_t) = normal(x - parent.x, 0, 2)"


def test_modes_are_said_with_how_long_they_last_and_what_follows():
    assert mode_lines(load_graph("kalman_ball").targets["ball"], str) == []
    lines = formula_text(load_graph("bouncing_square").targets["square"]).splitlines()
    assert [line for line in lines if line.startswith("mode ")] == [
        "mode straight: moves so, 60 frames on average, then bounce 0.667, behind 0.333",
        "mode bounce: constant velocity, sd x 1 px, y 1 px, sd velocity 6 px/frame, 2 frames on average, "
        "then straight",
        "mode behind: moves so, 10 frames on average, then straight, hidden: every agent says 0.02",
    ]


def test_parts_with_a_motion_are_a_part_of_what_the_belief_is_about():
    plate = load_graph("person_levels").targets["person"]
    assert [own for own, _, _ in latent_nodes(plate) if moves(plate, own)] == ["torso", "head"]
    text = formula_text(plate)
    before = "person_t-1, torso_t-1, head_t-1"
    assert f"p(person_t, torso_t, head_t | {before}) = p(person_t | person_t-1) · " in text
    assert "p(head_t | torso_t, head_t-1, torso_t-1): Gaussian around (x, y - 0.816 h)" in text
    assert "sd x 2.5 px, y 1 px in the long run, sd x 1.5 px, y 0.6 px a frame" in text
    assert "[∫" not in text


def test_latex_of_modes_has_their_rates():
    ball = load_graph("hidden_ball").targets["ball"]
    latex = formula_latex(ball).splitlines()
    assert r"&= \sum_{m_{t-1}} P(m_{t} \mid m_{t-1}) \int p(\mathit{ball}_{t} \mid" in latex[3]
    assert r"&= \left[\exp\left(\Delta t \, \begin{pmatrix} -0.0167 & 0.0167 \\ 0.0667" in latex[4]
    said = [line for line in formula_text(ball).splitlines() if line.startswith("mode ")]
    assert [line for line in latex if line.startswith("% mode ")] == [f"% {line}" for line in said]


def test_latex_of_modes_by_steps_has_their_probabilities():
    after = {"seen": {"seen": 0.9, "behind": 0.1}, "behind": {"seen": 0.25, "behind": 0.75}}
    modes = {"seen": {"next": after["seen"]}, "behind": {"hidden": {}, "next": after["behind"]}}
    nodes = {"s": {"motion": WALK, "modes": modes}, "a": {"parent": "s", "agent": "intensity"}}
    latex = formula_latex(check_graph({"name": "g", "targets": {"s": {"nodes": nodes}}}).targets["s"])
    assert r"\begin{pmatrix} 0.9 & 0.1 \\ 0.25 & 0.75 \end{pmatrix}^{\Delta t}" in latex


def test_latex_of_latent_nodes():
    head = formula_latex(load_graph("person_parts").targets["person"])
    assert "% p(head_t | person_t): Gaussian around (x, y - 0.39 h), 0.44 w by 0.22 h, sd x 2.5 px" in head
    leaning = formula_latex(load_graph("person_leaning").targets["person"])
    assert r"x(\mathit{head}_{t}) &\sim \mathrm{t}\left(x_{\mathrm{parent}},\, 2,\, 3\right) \\" in leaning


def test_what_is_measured_stands_in_the_formula():
    radar = load_graph("radar_ball").targets["ball"]
    assert "radar: range = hypot(x - radar_x, y - radar_y) + noise" in formula_text(radar)
    latex = formula_latex(radar)
    assert r"\mathit{range}_{\mathrm{radar}} &= \mathrm{hypot}\left(x - \mathit{radar\_x}" in latex
