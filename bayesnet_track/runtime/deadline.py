"""Watch how long frames take against a budget, and tell the engine of those that were late."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

from bayesnet_track.journal.events.event import Input
from bayesnet_track.journal.events.load import LateFrame, SpareTime
from bayesnet_track.journal.net.net import Net

FOR_AGENTS = 0.8
"""Share of the budget by which agents that work elsewhere have to answer: the rest is for what follows."""

FOR_ONE = 0.5
"""Share of the budget for which one of them is waited for in a frame: the rest is for what others learn."""

WARM_UP = 5
"""First frames, which load what is compiled: their time says nothing."""

TOLD_EVERY = 50
"""Frames in time after which they are told of, while something is done without."""


class Patience:
    """For how long agents elsewhere are waited for in one frame.

    Args:
        until: moment by which all answers are needed.
        each_s: seconds for which one agent is waited for.
    """

    def __init__(self, until: float, each_s: float) -> None:
        self._until, self._each_s = until, each_s
        self._waited: dict[str, float] = {}

    def until(self, agent: str, now: float) -> float:
        """The moment by which the agent has to answer what it is asked `now`.

        >>> patience = Patience(10.8, 0.5)
        >>> patience.until("hue", 10.0)
        10.5
        >>> patience.waited("hue", 0.4)
        >>> round(patience.until("hue", 10.6), 9), patience.until("motion", 10.6)
        (10.7, 10.8)
        """
        return min(self._until, now + max(self._each_s - self._waited.get(agent, 0.0), 0.0))

    def waited(self, agent: str, seconds: float) -> None:
        """The agent was waited for."""
        self._waited[agent] = self._waited.get(agent, 0.0) + seconds


class Punctual(Protocol):
    """Who asks agents elsewhere, and can leave an answer that comes too late.

    Attributes:
        patience: for how long answers are waited for; a later one is never used (`AgentUnavailable`). None
            for as long as they take.
    """

    patience: Patience | None


class Deadline:
    """The time that a frame may take.

    Args:
        budget_ms: milliseconds.
        asking: who asks agents elsewhere, to be told by when each frame needs their answers.
        clock: seconds of the monotonic clock.
        known_until: up to this frame it is known already what was late: nothing is told, nobody is hurried.
    """

    def __init__(
        self,
        budget_ms: float,
        asking: Punctual | None = None,
        clock: Callable[[], float] = time.monotonic,
        known_until: int = -1,
    ) -> None:
        self.budget_ms, self._known_until = budget_ms, known_until
        self._is_known = False
        self._asking, self._clock = asking, clock
        self._began = 0.0
        self._frames = self._calm = 0
        self._spent = self._most = 0.0

    def begin(self) -> None:
        """A frame begins."""
        self._began = self._clock()
        if self._asking is not None and self._frames >= WARM_UP and not self._is_known:
            budget_s = self.budget_ms / 1000.0
            self._asking.patience = Patience(self._began + FOR_AGENTS * budget_s, FOR_ONE * budget_s)

    def end(self) -> None:
        """The frame is done."""
        if self._asking is not None:
            self._asking.patience = None
        self._frames += 1
        self._spent = 1000.0 * (self._clock() - self._began)
        if self._frames <= WARM_UP:
            self._spent = 0.0
        is_late = self._spent > self.budget_ms
        self._calm = 0 if is_late else self._calm + 1
        self._most = 0.0 if is_late else max(self._most, self._spent)

    def inputs_for(self, frame: int, net: Net) -> tuple[Input, ...]:
        """What the engine is given with the next frame: that the last was late, or that there is time.

        It is asked before `begin`.
        """
        self._is_known = frame <= self._known_until
        if self._is_known:
            self._calm, self._most = 0, 0.0
            return ()
        if self._spent > self.budget_ms:
            return (LateFrame(frame, self._spent, self.budget_ms),)
        if self._calm < TOLD_EVERY:
            return ()
        spare = SpareTime(frame, self._most, self.budget_ms, self._calm)
        self._calm, self._most = 0, 0.0
        is_short = any(one.shed or one.most_particles is not None for one in net.targets.values())
        return (spare,) if is_short else ()
