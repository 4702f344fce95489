"""How the independent work of one frame is carried out: one piece after the other, or side by side.

The engine hands over work whose pieces do not depend on each other (the agents that observe, those that
learn) and takes back the results in the order of the pieces, so that an executor changes no result. One piece
is never split: an agent sees all its hypotheses at once.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from typing import Any, Protocol, TypeVar

from bayesnet_track.journal.net.net import Net
from bayesnet_track.observation.planes import FramePair

Piece = TypeVar("Piece")
Made = TypeVar("Made")

Halves = Generator[bool, None, Made]
"""Work on one piece in two halves: it yields once, whether what it needs comes from elsewhere."""


class AgentUnavailable(Exception):
    """An agent gave no answer for a reason outside of it: its process died, hangs, or is late.

    Its answer is missing in one frame; other than a fault of the cue it says nothing about the next one, and
    does not repeat when the run does.
    """


class Executor(Protocol):
    """Carries out independent pieces of work."""

    def each(self, work: Callable[[Piece], Made], pieces: Sequence[Piece]) -> list[Made]:
        """`work` done for every piece; the results in the order of the pieces."""
        ...


class Serial:
    """One piece after the other, in the caller's thread."""

    def each(self, work: Callable[[Piece], Made], pieces: Sequence[Piece]) -> list[Made]:
        """`work` done for every piece, in order.

        >>> Serial().each(abs, [-1, 2])
        [1, 2]
        """
        return [work(piece) for piece in pieces]


def is_elsewhere(cue: Any) -> bool:
    """Whether a cue is at work in another process, and can be asked now and heard later (`ask_ahead`)."""
    return hasattr(cue, "ask_ahead")


def asked(cue: Any, method: str, *arguments: Any) -> Halves[Any]:
    """What a method of a cue returns; one elsewhere is asked, and heard in the second half."""
    if not is_elsewhere(cue):
        return getattr(cue, method)(*arguments)
    hear = cue.ask_ahead(method, *arguments)
    yield True
    return hear()


def each_at_once(
    executor: Executor, work: Callable[[Piece], Halves[Made]], pieces: Sequence[Piece]
) -> list[Made]:
    """`work` done for every piece, the results in the order of the pieces.

    All that are elsewhere are asked before the executor does what is done here, and heard after it.

    >>> def work(number):
    ...     yield number > 1
    ...     return -number
    >>> each_at_once(Serial(), work, [1, 2, 0])
    [-1, -2, 0]
    """
    begun = [work(piece) for piece in pieces]
    made: dict[int, Made] = {}
    here: list[int] = []
    elsewhere: list[int] = []
    for index, one in enumerate(begun):
        try:
            (elsewhere if next(one) else here).append(index)
        except StopIteration as stop:  # there was nothing to wait for
            made[index] = stop.value
    made.update(zip(here, executor.each(_second_half, [begun[index] for index in here]), strict=True))
    made.update((index, _second_half(begun[index])) for index in elsewhere)
    return [made[index] for index in range(len(begun))]


def _second_half(begun: Halves[Made]) -> Made:
    try:
        next(begun)
    except StopIteration as stop:
        made: Made = stop.value
        return made
    raise RuntimeError("work in two halves has a third")


class Crew(Protocol):
    """Advances whole nets elsewhere, those of targets that depend on no other, while the engine goes on."""

    @property
    def plates(self) -> frozenset[str]:
        """The plates whose targets it takes."""
        ...

    def start(
        self, net: Net, targets: Mapping[str, Any], frames: FramePair
    ) -> Callable[[], Mapping[str, Any]]:
        """Take the frame of these targets (id -> `TargetState`) in hand.

        Returns:
            What waits for the outcome: target -> `engine.crew.Advanced`. Those that nobody advanced are
            missing, and are left to the engine.
        """
        ...
