"""Expressions as trees of terms, and their words: operations, functions, names."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

MAX_CHARACTERS = 1000
MAX_NESTING = 32
MAX_TERMS = 200
DRAWN = "value"
"""What stands for the value in a distribution that something is drawn from."""


class ExpressionError(ValueError):
    """An expression that is not accepted.

    Attributes:
        found: what was found.
        allowed: what is allowed instead, or empty.
        at: index of the character at which it was found.
        word: a name that was found, to be compared with `near`.
        near: the names that are allowed there.
    """

    def __init__(
        self, fault: str, remedy: str, index: int, word: str = "", candidates: tuple[str, ...] = ()
    ) -> None:
        super().__init__(f"character {index + 1}: {fault}; allowed: {remedy}")
        self.found, self.allowed, self.at, self.word, self.near = fault, remedy, index, word, candidates


@dataclass(frozen=True)
class Number:
    """A number, at least 0: a sign is an operation."""

    value: float
    at: int = field(default=0, compare=False)


@dataclass(frozen=True)
class Variable:
    """A name, such as ``x`` or ``parent.x``."""

    name: str
    at: int = field(default=0, compare=False)


@dataclass(frozen=True)
class Call:
    """A function of its arguments; an operation is called as its sign, a minus sign ``neg``."""

    function: str
    arguments: tuple[Term, ...]
    at: int = field(default=0, compare=False)


Term = Number | Variable | Call


def walk(term: Term) -> Iterator[Term]:
    """The term and all inside it, each before its arguments."""
    yield term
    for argument in term.arguments if isinstance(term, Call) else ():
        yield from walk(argument)


def names_in(term: Term) -> list[str]:
    """The names that a term reads, each once, in the order of the text."""
    return list(dict.fromkeys(part.name for part in walk(term) if isinstance(part, Variable)))


OR, AND, NOT, COMPARE, SUM, PRODUCT, SIGN, POWER, ATOM = range(9)
"""How tightly operations bind, the loosest first."""

BINARY = {
    "or": OR,
    "and": AND,
    **dict.fromkeys(("<", "<=", ">", ">=", "==", "!="), COMPARE),
    "+": SUM,
    "-": SUM,
    "*": PRODUCT,
    "/": PRODUCT,
    "**": POWER,
}
PREFIX = {"not": NOT, "-": SIGN, "+": SIGN}
NEGATIVE = "neg"


@dataclass(frozen=True)
class Function:
    """Arguments and meaning of a function.

    Attributes:
        parameters: names of its arguments; of the last one any number where `more`.
        meaning: what it gives.
        more: whether the last argument may be repeated.
    """

    parameters: tuple[str, ...]
    meaning: str
    more: bool = False

    @property
    def form(self) -> str:
        """The list of its arguments, as in the text.

        >>> FUNCTIONS["clip"].form, FUNCTIONS["max"].form
        ('(a, low, high)', '(a, b, ...)')
        """
        return f"({', '.join(self.parameters)}{', ...' if self.more else ''})"

    def takes(self, count: int) -> bool:
        """True if it can be called with so many arguments."""
        return count == len(self.parameters) or (self.more and count > len(self.parameters))


DENSITIES = {
    "normal": Function(("value", "mean", "sd"), "density of a normal distribution"),
    "laplace": Function(("value", "mean", "scale"), "density of a Laplace distribution"),
    "student_t": Function(
        ("value", "mean", "scale", "degrees"), "density of Student's t with so many degrees of freedom"
    ),
    "uniform": Function(("value", "low", "high"), "density of a uniform distribution; 0 outside"),
    "logistic": Function(("value", "mean", "scale"), "density of a logistic distribution"),
    "lognormal": Function(
        ("value", "mean", "sd"), "density of a value whose logarithm is normal; 0 of values up to 0"
    ),
    "gamma": Function(("value", "shape", "scale"), "density of a gamma distribution; 0 below 0"),
    "exponential": Function(("value", "scale"), "density of an exponential distribution, mean `scale`"),
    "truncated_normal": Function(
        ("value", "mean", "sd", "low", "high"),
        "density of a normal distribution cut off outside `low` to `high`",
    ),
}
AROUND_0 = ("normal", "laplace", "student_t", "logistic")
"""Densities that an error around 0 may have: symmetric about their first parameter."""
FUNCTIONS = {
    "where": Function(("condition", "a", "b"), "`a` where the condition is not 0, else `b`"),
    "min": Function(("a", "b"), "the smallest", more=True),
    "max": Function(("a", "b"), "the largest", more=True),
    "clip": Function(("a", "low", "high"), "`a`, kept between `low` and `high`"),
    "abs": Function(("a",), "absolute value"),
    "exp": Function(("a",), "e to the power of `a`"),
    "log": Function(("a",), "natural logarithm"),
    "sqrt": Function(("a",), "square root"),
    "sin": Function(("a",), "sine of an angle in radians"),
    "cos": Function(("a",), "cosine of an angle in radians"),
    "tan": Function(("a",), "tangent of an angle in radians"),
    "tanh": Function(("a",), "hyperbolic tangent, between -1 and 1"),
    "sign": Function(("a",), "-1, 0 or 1"),
    "floor": Function(("a",), "the largest whole number up to `a`"),
    "mod": Function(("a", "b"), "what is left of `a` after whole multiples of `b`; it has the sign of `b`"),
    "atan2": Function(("a", "b"), "angle of the point (b, a), radians"),
    "hypot": Function(("a", "b"), "sqrt(a² + b²)"),
    "mask": Function(("a", "b"), "gray value of the factor's mask in column `a`, row `b`: 0 to 1"),
    **DENSITIES,
}
MASK = "mask"
"""The function that only a factor with an image has."""

FRAME_NAMES = {
    "frame_width": "width of the frame, px",
    "frame_height": "height of the frame, px",
    "dt": "time since the target's last frame, in frame intervals",
    "pi": "3.14159...",
}
STATE_NAMES = {
    "x": "column of the box's centre, px",
    "y": "row of the box's centre, px, downward",
    "w": "width of the box, px",
    "h": "height of the box, px",
    "vx": "velocity of x, px per frame",
    "vy": "velocity of y, px per frame",
    "ax": "acceleration of x, px per frame²",
    "ay": "acceleration of y, px per frame²",
    "angle": "rotation since the first frame, degrees, clockwise",
    "mode": "number of the target's mode from 0 on; the names of its modes stand for theirs, `mode == turn`",
}
PARENT = "parent."
"""What stands before a field of the state that a latent node's own state is drawn around."""

FRAME_S = "frame_s"
"""Name of queries alone: seconds per frame interval."""
WORDS = frozenset({*FUNCTIONS, *FRAME_NAMES, *STATE_NAMES, "and", "or", "not", "parent", "a", "b"})
"""Names that constants cannot have."""

TIMES = ("frame", "time", "time_s", "frame_number")
"""What is written for the time."""

COMPUTED = {
    **dict.fromkeys(("speed", "velocity"), (("vx", "vy"), "hypot({}, {})")),
    **dict.fromkeys(("direction", "heading"), (("vy", "vx"), "atan2({}, {})")),
    "width": (("w",), "{}"),
    "height": (("h",), "{}"),
    "area": (("w", "h"), "{} * {}"),
    "left": (("x", "w"), "{} - {} / 2"),
    "right": (("x", "w"), "{} + {} / 2"),
    "top": (("y", "h"), "{} - {} / 2"),
    "bottom": (("y", "h"), "{} + {} / 2"),
}
"""Quantity that is no field of a state -> the fields that it is computed from, and how."""
