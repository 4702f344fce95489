"""The words of expressions: operations with their precedence, functions with their arguments, names."""

from __future__ import annotations

from dataclasses import dataclass

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
    """What a function takes and means.

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
        """Whether it can be called with so many arguments."""
        return count == len(self.parameters) or (self.more and count > len(self.parameters))


DENSITIES = {
    "normal": Function(("value", "mean", "sd"), "density of a normal distribution"),
    "laplace": Function(("value", "mean", "scale"), "density of a Laplace distribution"),
    "student_t": Function(
        ("value", "mean", "scale", "degrees"), "density of Student's t with so many degrees of freedom"
    ),
    "uniform": Function(("value", "low", "high"), "density of a uniform distribution; 0 outside"),
    "logistic": Function(("value", "mean", "scale"), "density of a logistic distribution"),
}
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
}
PARENT = "parent."
"""What stands before a field of the state that a latent node's own state is drawn around."""

WORDS = frozenset({*FUNCTIONS, *FRAME_NAMES, *STATE_NAMES, "and", "or", "not", "parent", "a", "b"})
"""Names that constants cannot have."""
