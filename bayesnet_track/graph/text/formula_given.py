"""Distributions of latent nodes and measurement functions, both by expressions, as text and as LaTeX."""

from __future__ import annotations

from collections.abc import Iterator

from bayesnet_track.graph.checked import CheckedTarget, Conditional
from bayesnet_track.graph.expressions.terms import DRAWN, Call, Term, Variable
from bayesnet_track.graph.expressions.write import latex_of, text_of


def lines(given: Conditional, state: str) -> Iterator[str]:
    """A line a field: ``x of head_t ~ normal(parent.x, 5)``."""
    for name, term in given.fields.items():
        drawn = _distribution(term)
        yield f"{name} of {state} {'=' if drawn is None else '~'} {text_of(term if drawn is None else drawn)}"
    yield from (f"{name} = {value:g}" for name, value in given.constants.items())


def latex_lines(given: Conditional, state: str) -> Iterator[str]:
    """The same in LaTeX, one line of `align*` each, without its end."""
    for name, term in given.fields.items():
        drawn = _distribution(term)
        sign, shown = ("=", latex_of(term)) if drawn is None else (r"\sim", _latex(drawn))
        yield rf"{name}({state}) &{sign} {shown}"


def measured_lines(target: CheckedTarget) -> Iterator[str]:
    """What agents measure: ``radar: range = hypot(x, y) + noise``, with the constants used."""
    for agent, functions in target.measures.items():
        for quantity, term in functions.terms.items():
            yield f"{agent}: {quantity} = {text_of(term)} + noise"
        yield from (f"{name} = {value:g}" for name, value in functions.constants.items())


def measured_latex_lines(target: CheckedTarget) -> Iterator[str]:
    """The same as rows of amsmath's `align*`, without the ends of lines."""
    for agent, functions in target.measures.items():
        for quantity, term in functions.terms.items():
            left = latex_of(Variable(f"{agent}.{quantity}"))
            yield rf"{left} &= {latex_of(term)} + \varepsilon"
        yield from (f"{latex_of(Variable(name))} &= {value:g}" for name, value in functions.constants.items())


def _latex(drawn: Call) -> str:
    """A distribution, whose first parameter is no value: with a comma behind it."""
    return latex_of(drawn).replace(r";\,", r",\,", 1)


def _distribution(term: Term) -> Call | None:
    """The distribution without the value that is drawn from it; None of a value."""
    if isinstance(term, Call) and term.arguments[:1] == (Variable(DRAWN),):
        return Call(term.function, term.arguments[1:], term.at)
    return None
