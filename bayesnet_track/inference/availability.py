"""Agents that give no answer in a frame for reasons outside of them: those known before, those found out."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from bayesnet_track.journal.events.faults import AgentMissed

Key = tuple[str, str, str]


@dataclass(frozen=True)
class Missing:
    """No answer, and why."""

    reason: str


@dataclass(eq=False)
class Availability:
    """Who gives no answer in one frame.

    An agent that was known to be missing is not asked, so that a run with the same inputs repeats.

    Attributes:
        frame: frame index.
        known: (target, agent, what it was asked for) -> why it gives none.
        reported: those of them that were to be asked, or were found out.
    """

    frame: int = 0
    known: dict[Key, str] = field(default_factory=dict)
    reported: dict[Key, str] = field(default_factory=dict)

    @staticmethod
    def of(frame: int, missed: Iterable[AgentMissed]) -> Availability:
        """Those that are known to be missing in `frame`."""
        return Availability(frame, {(one.target, one.node, one.during): one.reason for one in missed})

    def misses(self, target: str, agent: str, during: str) -> Missing | None:
        """Why the agent cannot be asked; None when it can."""
        key = (target, agent, during)
        if key not in self.known:
            return None
        self.reported[key] = self.known[key]
        return Missing(self.known[key])

    def note(self, target: str, agent: str, during: str, reason: str) -> None:
        """The agent was asked and gave no answer."""
        self.known[target, agent, during] = self.reported[target, agent, during] = reason

    def of_target(self, target: str, during: str) -> TargetAvailability:
        """Those of one target, asked for one thing."""
        return TargetAvailability(self, target, during)

    @property
    def events(self) -> tuple[AgentMissed, ...]:
        """Those that were missed, in an order that does not depend on when they were found out."""
        if not self.reported:
            return ()
        return tuple(
            AgentMissed(self.frame, target, agent, reason, during)
            for (target, agent, during), reason in sorted(self.reported.items())
        )


@dataclass(frozen=True)
class TargetAvailability:
    """Who of one target's agents gives no answer, asked for one thing."""

    availability: Availability = field(default_factory=Availability)
    target: str = ""
    during: str = ""

    def misses(self, agent: str) -> Missing | None:
        """Why the agent cannot be asked; None when it can."""
        return self.availability.misses(self.target, agent, self.during)

    @property
    def missed(self) -> dict[str, str]:
        """Those that were to be asked, or were found out -> the reason."""
        asked = (self.target, self.during)
        return {
            agent: reason
            for (target, agent, during), reason in self.availability.reported.items()
            if (target, during) == asked
        }

    def note(self, agent: str, missing: Missing) -> None:
        """The agent was asked and gave no answer."""
        self.availability.note(self.target, agent, self.during, missing.reason)
