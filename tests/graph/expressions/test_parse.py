"""Reading expressions: what they mean, what is refused and where, and that no text does anything else."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bayesnet_track.graph.expressions.evaluate import log_values, values_of
from bayesnet_track.graph.expressions.parse import parse
from bayesnet_track.graph.expressions.terms import MAX_CHARACTERS, ExpressionError, names_in

VALUES = {"x": 3.0, "y": 5.0, "w": 2.0, "h": 4.0, "parent.x": 7.0}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1 + 2 * 3", 7),
        ("(1 + 2) * 3", 9),
        ("10 - 4 - 3", 3),
        ("2 ** 3 ** 2", 512),
        ("-x ** 2", -9),
        ("2 ** -1", 0.5),
        ("-x * y", -15),
        ("1 < x < 5", 1),
        ("1 < x < 2", 0),
        ("not x > y and 1", 1),
        ("x == 3 or y / 0 > 1", 1),
        ("where(x > y, 1, parent.x)", 7),
        ("max(1, x, .5e1) - min(x, y)", 2),
        ("clip(y, 0, 4) + abs(-1) + hypot(3, 4)", 10),
        ("atan2(0, 1) + sin(0) + cos(0) + sqrt(4) + exp(0) + log(1)", 4),
        ("tan(0) + tanh(0) + sign(-x) + floor(-0.5)", -2),
        ("mod(-1, 3) + mod(7, 4) + floor(2.7)", 7),
        (" + x ", 3),
    ],
)
def test_an_expression_means_what_it_means_elsewhere(text, value):
    assert values_of(parse(text), VALUES) == value


@pytest.mark.parametrize(
    ("text", "at", "found"),
    [
        ("", 0, "the end where the expression goes on"),
        ("x +", 3, "the end"),
        ("x y", 2, "'y' where"),
        ("2x", 0, "'2x'"),
        ("0x10", 0, "'0x'"),
        ("1_000", 0, "'1_'"),
        ("x.y.z", 0, "'x.y.'"),
        ("__import__('os')", 11, 'character "\'"'),
        ("().__class__", 2, "character '.'"),
        ("x[0]", 1, "character '['"),
        ("lambda: 1", 6, "character ':'"),
        ("x = 1", 2, "character '='"),
        ("x\x00", 1, "character '\\x00'"),
        ("h\N{SUPERSCRIPT TWO}", 1, "character '\N{SUPERSCRIPT TWO}'"),
        ("x if y else 1", 2, "'if' where"),
        ("eval(x)", 0, "unknown function 'eval'"),
        ("1 + hh", 4, "unknown name 'hh'"),
        ("normal(h, 2)", 0, "normal with 2 arguments"),
        ("min(x)", 0, "min with 1 argument"),
        ("normal + 1", 0, "function 'normal' without arguments"),
        ("1" * 30, 0, "a number of 30 characters"),
        ("1e999", 0, "number 1e999"),
        ("(" * 100_000, MAX_CHARACTERS, "an expression of 100000 characters"),
        ("(" * 900, 32, "nested deeper than 32 levels"),
        ("-" * 900 + "x", 32, "nested deeper than 32 levels"),
        ("2**" * 300 + "x", 96, "nested deeper than 32 levels"),
        ("sqrt(" * 150 + "x" + ")" * 150, 160, "nested deeper than 32 levels"),
        ("+".join("x" * 400), 199, "more than 200 numbers, names and operations"),
    ],
)
def test_what_is_wrong_is_named_at_its_character(text, at, found):
    with pytest.raises(ExpressionError) as error:
        parse(text, VALUES)
    assert error.value.found.startswith(found)
    assert error.value.at == at
    assert error.value.allowed


def test_the_names_that_are_near_are_known():
    with pytest.raises(ExpressionError) as error:
        parse("norml(x, 1, 2)")
    assert (error.value.word, "normal" in error.value.near) == ("norml", True)


def test_names_are_listed_once():
    assert names_in(parse("y * x + y ** parent.x")) == ["y", "x", "parent.x"]


@given(text=st.text(max_size=80) | st.text("xyh0.9e+-*/()<>=,! nortmal", max_size=120))
@settings(max_examples=300, deadline=None)
def test_any_text_is_an_expression_or_is_refused_at_a_character(text):
    try:
        term = parse(text, VALUES)
    except ExpressionError as error:
        assert 0 <= error.at <= len(text)
    else:
        assert log_values(term, VALUES) < 710 or log_values(term, VALUES) != log_values(term, VALUES)
