"""Write an expression as text, with no more brackets than it needs, and as LaTeX."""

from __future__ import annotations

from bayesnet_track.graph.expressions.terms import Call, Number, Term
from bayesnet_track.graph.expressions.vocabulary import (
    ATOM,
    BINARY,
    COMPARE,
    DENSITIES,
    NEGATIVE,
    POWER,
    PREFIX,
    SIGN,
)

_LATEX_SIGNS = {
    "*": r" \, ",
    "<=": r" \le ",
    ">=": r" \ge ",
    "==": " = ",
    "!=": r" \ne ",
    "and": r" \wedge ",
    "or": r" \vee ",
}
_LATEX_NAMES = {"pi": r"\pi", "dt": r"\Delta t"}
_LATEX_DENSITIES = {
    "normal": r"\mathcal{N}",
    "laplace": r"\mathrm{Laplace}",
    "student_t": r"\mathrm{t}",
    "uniform": r"\mathcal{U}",
    "logistic": r"\mathrm{Logistic}",
}
_LATEX_FUNCTIONS = {name: rf"\{name}" for name in ("min", "max", "exp", "log", "sin", "cos")}


def text_of(term: Term) -> str:
    """The text of a term; reading it gives an equal one.

    >>> from bayesnet_track.graph.expressions.parse import parse
    >>> text_of(parse("((x)*(2)) - (y - 1)**2"))
    'x * 2 - (y - 1) ** 2'
    """
    if isinstance(term, Number):
        return _number(term.value)
    if not isinstance(term, Call):
        return term.name
    parts = [_bracketed(text_of(inside), need) for inside, need in _needs(term)]
    match term.function:
        case "neg":
            return f"-{parts[0]}"
        case "not":
            return f"not {parts[0]}"
        case sign if sign in BINARY:
            return f" {sign} ".join(parts)
    return f"{term.function}({', '.join(map(text_of, term.arguments))})"


def latex_of(term: Term) -> str:
    r"""The term in LaTeX's mathematics.

    >>> from bayesnet_track.graph.expressions.parse import parse
    >>> latex_of(parse("normal(h, 0.32 * y + 12, 8)"))
    '\\mathcal{N}\\left(h;\\, 0.32 \\, y + 12,\\, 8\\right)'
    """
    if isinstance(term, Number):
        return _latex_number(term.value)
    if not isinstance(term, Call):
        return _latex_name(term.name)
    inside = [latex_of(one) for one in term.arguments]
    match term.function:
        case "/":
            return rf"\frac{{{inside[0]}}}{{{inside[1]}}}"
        case "sqrt":
            return rf"\sqrt{{{inside[0]}}}"
        case "abs":
            return rf"\left|{inside[0]}\right|"
        case "where":
            rows = rf"{inside[1]} & \text{{if }} {inside[0]} \\ {inside[2]} & \text{{else}}"
            return rf"\begin{{cases}} {rows} \end{{cases}}"
        case function if function in DENSITIES:
            name = _LATEX_DENSITIES[function]
            return rf"{name}\left({inside[0]};\, {_commas(inside[1:])}\right)"
        case function if function not in BINARY and function not in ("neg", "not"):
            name = _LATEX_FUNCTIONS.get(function, rf"\mathrm{{{function}}}")
            return rf"{name}\left({_commas(inside)}\right)"
    return _latex_operation(term)


def _latex_operation(term: Call) -> str:
    parts = [
        rf"\left({latex_of(one)}\right)" if needed and _is_open(one, term) else latex_of(one)
        for one, needed in _needs(term)
    ]
    if term.function == "**":
        return f"{parts[0]}^{{{latex_of(term.arguments[1])}}}"
    if term.function == "*" and parts[1][0].isdigit():
        return rf"{parts[0]} \cdot {parts[1]}"
    if term.function in ("neg", "not"):
        return ("-" if term.function == "neg" else r"\neg ") + parts[0]
    return _LATEX_SIGNS.get(term.function, f" {term.function} ").join(parts)


def _is_open(inside: Term, outside: Call) -> bool:
    """A fraction shows by itself where it ends, except below a power."""
    return not (isinstance(inside, Call) and inside.function == "/") or outside.function == "**"


def _needs(term: Call) -> list[tuple[Term, bool]]:
    """The arguments of an operation, each with whether it needs brackets."""
    if term.function not in BINARY:
        least = NEGATIVE_BINDS if term.function == NEGATIVE else PREFIX.get(term.function, 0)
        return [(one, _binding(one) < least) for one in term.arguments]
    own = BINARY[term.function]
    left, right = term.arguments
    if own == POWER:
        return [(left, _binding(left) < ATOM), (right, _binding(right) < SIGN)]
    strict = own + 1 if own == COMPARE else own
    return [(left, _binding(left) < strict), (right, _binding(right) <= own)]


NEGATIVE_BINDS = SIGN
"""What stands behind a minus sign binds at least so tightly."""


def _binding(term: Term) -> int:
    if not isinstance(term, Call):
        return ATOM
    if term.function == NEGATIVE:
        return SIGN
    return BINARY.get(term.function, PREFIX.get(term.function, ATOM))


def _bracketed(text: str, needed: bool) -> str:
    return f"({text})" if needed else text


def _commas(parts: list[str]) -> str:
    return r",\, ".join(parts)


def _number(value: float) -> str:
    whole = value.is_integer() and value < 1e15
    return str(int(value)) if whole else repr(value)


def _latex_number(value: float) -> str:
    mantissa, mark, power = _number(value).partition("e")
    return rf"{mantissa} \cdot 10^{{{int(power)}}}" if mark else mantissa


def _latex_name(name: str) -> str:
    if name in _LATEX_NAMES:
        return _LATEX_NAMES[name]
    before, dot, own = name.rpartition(".")
    own = own if len(own) == 1 else rf"\mathit{{{own.replace('_', chr(92) + '_')}}}"
    return rf"{own}_{{\mathrm{{{before}}}}}" if dot else own
