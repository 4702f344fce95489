"""Writing expressions as text and as LaTeX."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bayesnet_track.graph.expressions.parse import latex_of, parse, term_text


@given(data=st.data())
@settings(max_examples=100, deadline=None)
def test_what_is_written_reads_as_the_same_expression(terms, data):
    term = data.draw(terms)
    assert parse(term_text(term)) == term


@pytest.mark.parametrize(
    ("text", "latex"),
    [
        ("normal(h, 0.32 * y + 12, 8)", r"\mathcal{N}\left(h;\, 0.32 \, y + 12,\, 8\right)"),
        ("(x - y) * 2 ** -(w + 1)", r"\left(x - y\right) \cdot 2^{-\left(w + 1\right)}"),
        ("1e-9 / sqrt(frame_width)", r"\frac{1 \cdot 10^{-9}}{\sqrt{\mathit{frame\_width}}}"),
        (
            "where(x <= pi, abs(h), parent.x)",
            r"\begin{cases} \left|h\right| & \text{if } x \le \pi \\ "
            r"x_{\mathrm{parent}} & \text{else} \end{cases}",
        ),
        (
            "not (x < 1 or atan2(x, y) != 0)",
            r"\neg \left(x < 1 \vee \mathrm{atan2}\left(x,\, y\right) \ne 0\right)",
        ),
        ("(x / y) ** 2", r"\left(\frac{x}{y}\right)^{2}"),
    ],
)
def test_latex(text, latex):
    assert latex_of(parse(text)) == latex


@given(data=st.data())
@settings(max_examples=100, deadline=None)
def test_latex_closes_what_it_opens(terms, data):
    latex = latex_of(data.draw(terms))
    assert latex.count("{") == latex.count("}")
    assert latex.count(r"\left") == latex.count(r"\right")
