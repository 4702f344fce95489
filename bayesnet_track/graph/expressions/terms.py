"""An expression as a tree of terms, the limits of one, and what is said of a wrong one."""

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

    def __init__(self, found: str, allowed: str, at: int, word: str = "", near: tuple[str, ...] = ()) -> None:
        super().__init__(f"character {at + 1}: {found}; allowed: {allowed}")
        self.found, self.allowed, self.at, self.word, self.near = found, allowed, at, word, near


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
    for inside in term.arguments if isinstance(term, Call) else ():
        yield from walk(inside)


def names_in(term: Term) -> list[str]:
    """The names that a term reads, each once, in the order of the text."""
    return list(dict.fromkeys(one.name for one in walk(term) if isinstance(one, Variable)))
