"""Expressions from text to trees and back, and as LaTeX.

The parser is our own because its messages name the character and the words of this language, the same in
every version of Python, and because text that nests deeper than a limit must not reach a recursive parser.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection
from dataclasses import dataclass, field

from bayesnet_track.graph.expressions.evaluate import values_of
from bayesnet_track.graph.expressions.terms import (
    AROUND_0,
    ATOM,
    BINARY,
    COMPARE,
    DENSITIES,
    DRAWN,
    FUNCTIONS,
    MASK,
    MAX_CHARACTERS,
    MAX_NESTING,
    MAX_TERMS,
    NEGATIVE,
    POWER,
    PREFIX,
    SIGN,
    Call,
    ExpressionError,
    Function,
    Number,
    Term,
    Variable,
    walk,
)

MAX_DIGITS = 24
_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)(?P<joined>\w?)"
    r"|(?P<word>[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)?)(?P<dotted>\.?)"
    r"|(?P<sign>\*\*|[<>=!]=|[-+*/()<>,])|(?P<wrong>\S))",
    re.ASCII,
)
_SIGNS = "numbers, names, + - * / ** ( ) , < <= > >= == != and or not"


def parse(
    text: str,
    names: Collection[str] | None = None,
    *,
    mask: bool = False,
    draws: bool = False,
    error: bool = False,
) -> Term:
    """The tree of an expression; of `names` alone, unless None.

    With `mask` it may ask the factor's mask. With `draws` it may be one distribution, without the value that
    is drawn, `normal(mean, sd)`; the value is then the variable `DRAWN`. With `error` it is the distribution
    of an error around 0, `student_t(scale, degrees)`, or the sd of a normal one.

    >>> parse("2 * x")
    Call(function='*', arguments=(Number(value=2.0, at=0), Variable(name='x', at=4)), at=2)

    Raises:
        ExpressionError: what is wrong with it, and at which character.
    """
    if len(text) > MAX_CHARACTERS:
        fault, remedy = f"an expression of {len(text)} characters", f"at most {MAX_CHARACTERS} characters"
        raise ExpressionError(fault, remedy, MAX_CHARACTERS)
    if not error:
        return _Parser(_tokens(text), names, mask, 1 if draws else 0).whole()
    term = _Parser(_tokens(text), names, mask, 2).whole()
    if isinstance(term, Call) and term.arguments[:1] == (Variable(DRAWN),):
        return term
    return Call("normal", (Variable(DRAWN), Number(0.0), term))


def parse_value(text: str, names: Collection[str], *, error: bool = False) -> Term:
    """The tree of an expression of which the value counts, not its logarithm as in a factor; see `parse`.

    >>> parse_value("x / (2 - 2)", ["x"])  # doctest: +ELLIPSIS
    Traceback (most recent call last):
        ...
    bayesnet_track.graph.expressions.terms.ExpressionError: character 3: x / (2 - 2), a division by 0; ...

    Raises:
        ExpressionError: as of `parse`; or a part of it has no finite value in any frame, which would make
            every answer NaN, or a condition certain.
    """
    term = parse(text, names, error=error)
    for part in reversed(list(walk(term))):
        if isinstance(part, Call):
            _check_constant(part)
    return term


@dataclass(frozen=True)
class _Token:
    kind: str
    text: str
    at: int


_END = "the end"
_ONE = "one distribution, or a value without any"


def _tokens(text: str) -> list[_Token]:
    tokens: list[_Token] = []
    for match in _TOKEN.finditer(text):
        kind = str(match.lastgroup)
        start = match.start(kind)
        if kind in ("joined", "dotted"):
            kind = "number" if kind == "joined" else "word"
            start = match.start(kind)
            if suffix := match[match.lastgroup or ""]:
                raise ExpressionError(f"{match[kind] + suffix!r}", _SIGNS, start)
        if kind == "wrong":
            raise ExpressionError(f"character {match[kind]!r}", _SIGNS, start)
        if kind == "number" and sum(map(str.isdigit, match[kind])) > MAX_DIGITS:
            raise ExpressionError(
                f"a number of {len(match[kind])} characters", f"at most {MAX_DIGITS} digits", start
            )
        tokens.append(_Token(kind, match[kind], start))
    return [*tokens, _Token("end", _END, len(text.rstrip()))]


@dataclass
class _Parser:
    """One pass over the tokens, by precedence climbing."""

    tokens: list[_Token]
    names: Collection[str] | None
    mask: bool = False
    omitted: int = 0
    place: int = 0
    depth: int = 0
    terms: int = field(default=0)

    @property
    def next(self) -> _Token:
        return self.tokens[self.place]

    def take(self) -> _Token:
        token = self.next
        self.place += token.kind != "end"
        return token

    def whole(self) -> Term:
        term = self.term(0)
        if self.next.kind != "end":
            raise self.error(self.next, "an operation, or the end of the expression")
        first = self.tokens[0]
        if self.omitted and first.text in DENSITIES and (term.at, self.is_one_call()) != (first.at, True):
            raise ExpressionError(f"{first.text} inside an expression", _ONE, first.at)
        return term

    def is_one_call(self) -> bool:
        """True if the text is a function of arguments and nothing else."""
        depth = 0
        for number, token in enumerate(self.tokens[1:], 2):
            depth += {"(": 1, ")": -1}.get(token.text, 0)
            if depth == 0:
                return self.tokens[number].kind == "end"
        return False

    def term(self, min_binding: int) -> Term:
        """A term whose operations bind at least as tightly as `min_binding`."""
        self.depth += 1
        if self.depth > MAX_NESTING:
            fault, remedy = f"nested deeper than {MAX_NESTING} levels", f"at most {MAX_NESTING} levels"
            raise ExpressionError(fault, remedy, self.next.at)
        left = self.first()
        while self.next.text in BINARY and BINARY[self.next.text] >= min_binding:
            sign = self.take()
            binding = BINARY[sign.text]
            # Only powers group from the right; what stands under one may have a sign of its own.
            right = self.term(SIGN if binding == POWER else binding + 1)
            left = self.operation(sign, left, right)
            if binding == COMPARE:
                left = self.chain(left, right)
        self.depth -= 1
        return left

    def chain(self, left: Term, middle: Term) -> Term:
        """``a < b < c`` as ``a < b and b < c``."""
        while BINARY.get(self.next.text) == COMPARE:
            sign = self.take()
            right = self.term(COMPARE + 1)
            also = self.operation(sign, middle, right)
            left, middle = self.counted(Call("and", (left, also), sign.at)), right
        return left

    def first(self) -> Term:
        token = self.take()
        if token.text in PREFIX:
            inner = self.term(PREFIX[token.text])
            if token.text == "+":
                return inner
            return self.counted(Call(NEGATIVE if token.text == "-" else token.text, (inner,), token.at))
        if token.kind == "number":
            return self.counted(Number(_finite(token), token.at))
        if token.text == "(":
            inner = self.term(0)
            self.close("an operation or ')'")
            return inner
        if token.kind == "word" and token.text not in BINARY:
            return self.call(token) if self.next.text == "(" else self.variable(token)
        raise self.error(token, "a number, a name, or '('")

    def variable(self, token: _Token) -> Term:
        if token.text in FUNCTIONS:
            form = FUNCTIONS[token.text].form
            raise ExpressionError(f"function {token.text!r} without arguments", token.text + form, token.at)
        if self.names is not None and token.text not in self.names:
            raise ExpressionError(
                f"unknown name {token.text!r}", ", ".join(self.names), token.at, token.text, tuple(self.names)
            )
        return self.counted(Variable(token.text, token.at))

    def call(self, token: _Token) -> Term:
        if token.text not in FUNCTIONS:
            fault = f"unknown function {token.text!r}"
            functions = tuple(name for name in FUNCTIONS if self.mask or name != MASK)
            raise ExpressionError(fault, ", ".join(functions), token.at, token.text, functions)
        if token.text == MASK and not self.mask:
            remedy = "in a factor that has a mask: {parent: ..., mask: FILE, factor: ...}"
            raise ExpressionError("mask without an image", remedy, token.at)
        self.take()
        arguments: list[Term] = []
        while self.next.text != ")" or arguments:
            arguments.append(self.term(0))
            if self.next.text != ",":
                break
            self.take()
        self.close("an operation, ',' or ')'")
        function = FUNCTIONS[token.text]
        is_drawn = self.omitted > 0 and token is self.tokens[0] and token.text in DENSITIES
        if is_drawn and self.omitted == 2 and token.text not in AROUND_0:
            fault = f"{token.text}, which is no error around 0"
            raise ExpressionError(fault, f"an sd, or one of {', '.join(AROUND_0)}", token.at)
        if is_drawn:
            function = Function(function.parameters[self.omitted :], function.meaning)
        shorter = len(arguments) == len(function.parameters) - self.omitted
        if self.omitted and not is_drawn and token.text in DENSITIES and shorter:
            raise ExpressionError(f"{token.text} inside an expression", _ONE, token.at)
        if not function.takes(len(arguments)):
            fault = f"{token.text} with {len(arguments)} argument{'' if len(arguments) == 1 else 's'}"
            raise ExpressionError(fault, token.text + function.form, token.at)
        if is_drawn:
            left_out: tuple[Term, ...] = (Variable(DRAWN, token.at), Number(0.0, token.at))
            arguments[:0] = left_out[: self.omitted]
        return self.counted(Call(token.text, tuple(arguments), token.at))

    def close(self, remedy: str) -> None:
        token = self.take()
        if token.text != ")":
            raise self.error(token, remedy)

    def operation(self, sign: _Token, left: Term, right: Term) -> Term:
        return self.counted(Call(sign.text, (left, right), sign.at))

    def counted(self, term: Term) -> Term:
        self.terms += 1
        if self.terms > MAX_TERMS:
            fault = f"more than {MAX_TERMS} numbers, names and operations"
            raise ExpressionError(fault, f"at most {MAX_TERMS}", term.at)
        return term

    def error(self, token: _Token, remedy: str) -> ExpressionError:
        fragment = _END if token.kind == "end" else repr(token.text)
        return ExpressionError(f"{fragment} where the expression goes on", remedy, token.at)


def _check_constant(call: Call) -> None:
    """Refuse a term that has no finite value whatever it reads."""
    if call.function == "/" and _constant(call.arguments[1]) == 0.0:
        raise ExpressionError(f"{term_text(call)}, a division by 0", "a divisor other than 0", call.at)
    value = _constant(call)
    if value is not None and not math.isfinite(value):
        noun = "which has no value" if math.isnan(value) else "which is infinite"
        raise ExpressionError(f"{term_text(call)}, {noun}", "constants with a finite value", call.at)


def _constant(term: Term) -> float | None:
    """The value of a term that reads nothing; None of any other."""
    parts = [part for part in walk(term) if isinstance(part, Variable | Call)]
    reads = any(
        part.name != "pi" if isinstance(part, Variable) else part.function in (MASK, *DENSITIES)
        for part in parts
    )
    return None if reads else float(values_of(term, {"pi": math.pi}))


def _finite(token: _Token) -> float:
    value = float(token.text)
    if math.isinf(value):
        raise ExpressionError(f"number {token.text}", "numbers up to 1.797e308", token.at)
    return value


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
    "lognormal": r"\mathrm{Lognormal}",
    "gamma": r"\mathrm{Gamma}",
    "exponential": r"\mathrm{Exp}",
    "truncated_normal": r"\mathcal{N}_{\mathrm{trunc}}",
}
_LATEX_FUNCTIONS = {name: rf"\{name}" for name in ("min", "max", "exp", "log", "sin", "cos", "tan", "tanh")}


def term_text(term: Term) -> str:
    """The text of a term; reading it gives an equal one.

    >>> from bayesnet_track.graph.expressions.parse import parse
    >>> term_text(parse("((x)*(2)) - (y - 1)**2"))
    'x * 2 - (y - 1) ** 2'
    """
    if isinstance(term, Number):
        return _number(term.value)
    if not isinstance(term, Call):
        return term.name
    parts = [_bracketed(term_text(argument), need) for argument, need in _needs(term)]
    match term.function:
        case "neg":
            return f"-{parts[0]}"
        case "not":
            return f"not {parts[0]}"
        case sign if sign in BINARY:
            return f" {sign} ".join(parts)
    return f"{term.function}({', '.join(map(term_text, term.arguments))})"


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
    arguments = [latex_of(argument) for argument in term.arguments]
    match term.function:
        case "/":
            return rf"\frac{{{arguments[0]}}}{{{arguments[1]}}}"
        case "sqrt":
            return rf"\sqrt{{{arguments[0]}}}"
        case "abs":
            return rf"\left|{arguments[0]}\right|"
        case "where":
            rows = rf"{arguments[1]} & \text{{if }} {arguments[0]} \\ {arguments[2]} & \text{{else}}"
            return rf"\begin{{cases}} {rows} \end{{cases}}"
        case function if function in DENSITIES:
            name = _LATEX_DENSITIES[function]
            return rf"{name}\left({arguments[0]};\, {_commas(arguments[1:])}\right)"
        case function if function not in BINARY and function not in ("neg", "not"):
            name = _LATEX_FUNCTIONS.get(function, rf"\mathrm{{{function}}}")
            return rf"{name}\left({_commas(arguments)}\right)"
    return _latex_operation(term)


def _latex_operation(term: Call) -> str:
    parts = [
        rf"\left({latex_of(argument)}\right)" if needed and _is_open(argument, term) else latex_of(argument)
        for argument, needed in _needs(term)
    ]
    if term.function == "**":
        return f"{parts[0]}^{{{latex_of(term.arguments[1])}}}"
    if term.function == "*" and parts[1][0].isdigit():
        return rf"{parts[0]} \cdot {parts[1]}"
    if term.function in ("neg", "not"):
        return ("-" if term.function == "neg" else r"\neg ") + parts[0]
    return _LATEX_SIGNS.get(term.function, f" {term.function} ").join(parts)


def _is_open(inner: Term, outer: Call) -> bool:
    """A fraction shows by itself where it ends, except below a power."""
    return not (isinstance(inner, Call) and inner.function == "/") or outer.function == "**"


def _needs(term: Call) -> list[tuple[Term, bool]]:
    """The arguments of an operation, each with whether it needs brackets."""
    if term.function not in BINARY:
        min_binding = NEGATIVE_BINDS if term.function == NEGATIVE else PREFIX.get(term.function, 0)
        return [(argument, _binding(argument) < min_binding) for argument in term.arguments]
    binding = BINARY[term.function]
    left, right = term.arguments
    if binding == POWER:
        return [(left, _binding(left) < ATOM), (right, _binding(right) < SIGN)]
    strict = binding + 1 if binding == COMPARE else binding
    return [(left, _binding(left) < strict), (right, _binding(right) <= binding)]


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
    is_whole = value.is_integer() and value < 1e15
    return str(int(value)) if is_whole else repr(value)


def _latex_number(value: float) -> str:
    mantissa, mark, power = _number(value).partition("e")
    return rf"{mantissa} \cdot 10^{{{int(power)}}}" if mark else mantissa


def _latex_name(name: str) -> str:
    if name in _LATEX_NAMES:
        return _LATEX_NAMES[name]
    prefix, dot, symbol = name.rpartition(".")
    symbol = symbol if len(symbol) == 1 else rf"\mathit{{{symbol.replace('_', chr(92) + '_')}}}"
    return rf"{symbol}_{{\mathrm{{{prefix}}}}}" if dot else symbol
