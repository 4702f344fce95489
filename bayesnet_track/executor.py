"""How the independent work of one frame is carried out: one piece after the other, or side by side.

The engine hands over work whose pieces do not depend on each other (the agents that observe, those that
learn) and takes back the results in the order of the pieces, so that an executor changes no result. One piece
is never split: an agent sees all its hypotheses at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol, TypeVar

from bayesnet_track.graph.net import Net
from bayesnet_track.planes import FramePair

Piece = TypeVar("Piece")
Made = TypeVar("Made")


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
            What waits for the outcome: target -> `nets.crew.Advanced`. Those that nobody advanced are
            missing, and are left to the engine.
        """
        ...
