"""How agents elsewhere are asked: all first, then those here, then the answers from elsewhere are collected.

The engine hands over work whose pieces do not depend on each other (the agents that observe, those that
learn), so that where an agent runs changes no result. One piece is never split: an agent sees all its
hypotheses at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from operator import call
from typing import Any, TypeVar

Piece = TypeVar("Piece")
Made = TypeVar("Made")
Wait = Callable[[], Made]
"""Waits for an answer that was asked for, and returns it."""


class AgentUnavailable(Exception):
    """An agent gave no answer for a reason outside of it: its process died, hangs, or is late.

    Its answer is missing in one frame; other than a fault of the cue it says nothing about the next one, and
    does not repeat when the run does.
    """


def is_elsewhere(cue: Any) -> bool:
    """True if a cue is at work in another process, and can be asked now and answer later (`ask_ahead`)."""
    return hasattr(cue, "ask_ahead")


def each_at_once(
    ask_ahead: Callable[[Piece], Wait[Made] | None],
    work: Callable[[Piece], Made],
    pieces: Iterable[Piece],
) -> Iterator[tuple[Piece, Made]]:
    """Every piece with what was made of it: first those that `work` makes here, then those from elsewhere.

    `ask_ahead` asks who is elsewhere and returns what waits for the answer; None for a piece to be done here.
    All are asked before anything is done here, and their answers collected after it. The work is done as
    pairs are collected, in the caller's frame, so that a stack shows who asks and who answers, and nothing
    between.

    >>> dict(each_at_once(lambda n: (lambda: -n) if n > 1 else None, lambda n: n, [1, 2, 0]))
    {1: 1, 0: 0, 2: -2}
    """
    waits: dict[Piece, Wait[Made]] = {}
    here: list[Piece] = []
    for piece in pieces:
        wait = ask_ahead(piece)
        if wait is None:
            here.append(piece)
        else:
            waits[piece] = wait
    return chain(
        zip(here, map(work, here), strict=True),
        zip(waits, map(call, waits.values()), strict=True),
    )


def defer_faults(ask: Callable[[], Wait[Made]], faults: tuple[type[BaseException], ...]) -> Wait[Made]:
    """What `ask` returns; where it raises one of `faults`, what raises it when it is waited for."""
    try:
        return ask()
    except faults as error:
        found = error

    def raised() -> Made:
        raise found

    return raised
