"""The densities of joined targets, as text and LaTeX."""

from __future__ import annotations

from bayesnet_track.graph.spec import Join
from bayesnet_track.graph.text.formula import join_latex, join_text

CARRIED = Join.model_validate(
    {"between": ["person", "box"], "occlusion": {"stay": 0.9}, "exclusion": {"nats": 2}, "attachment": {}}
)
CROWD = Join.model_validate({"exclusion": {}})


def test_pixels_that_are_shared_and_who_is_in_front():
    lines = join_text(CARRIED).splitlines()
    assert lines[0] == "while the beliefs of person and box overlap by 0.05 or more:"
    assert lines[1].startswith(
        "p(person_t, box_t | e_1:t) ∝ p(person_t | e_1:t-1) · p(box_t | e_1:t-1) · Σ_o p(o_t)"
    )
    assert lines[1].endswith("· e^(-2 c(person_t, box_t))")
    assert "p(o_t): that of the last frame with probability 0.9" in lines
    assert lines[-1].startswith("p(box_t | box_t-1, person_t): with person, sd 1 px, while it is carried")


def test_without_memory_either_may_be_in_front():
    lines = join_text(CROWD).splitlines()
    assert lines[0].startswith("while the beliefs of target and other_target overlap")
    assert lines[-1] == "p(o_t): 1/2 each, anew in every frame"


def test_latex_has_the_equation_and_the_words_as_comments():
    lines = join_latex(CARRIED).splitlines()
    assert lines[1] == r"\begin{align*}"
    assert r"\sum_{o_t} p(o_t)" in lines[2]
    assert all(line.startswith("% ") for line in (lines[0], *lines[4:]))
    only = Join.model_validate({"between": ["a", "b"], "attachment": {}})
    assert all(line.startswith("% ") for line in join_latex(only).splitlines())


def test_a_factor_of_two_states():
    spring = Join.model_validate(
        {
            "between": ["hand", "face"],
            "factor": "normal(hypot(a.x-b.x, a.y-b.y), 40, 10)",
            "when": {"overlap": 0},
        }
    )
    assert join_text(spring).splitlines() == [
        "of every hand and face:",
        "p(hand_t, face_t | e_1:t) ∝ p(hand_t | e_1:t) · p(face_t | e_1:t) · f(hand_t, face_t)",
        "f(a, b) = normal(hypot(a.x - b.x, a.y - b.y), 40, 10)",
    ]
    latex = join_latex(spring)
    assert r"p(\mathit{hand}_{t}, \mathit{face}_{t} \mid e_{1:t}) &\propto" in latex
    assert r"f(a, b) &= \mathcal{N}\left(\mathrm{hypot}\left(x_{\mathrm{a}} - x_{\mathrm{b}}" in latex
