"""The live net of one target: what decisions change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Fault:
    """An agent's last failure.

    Attributes:
        times: how many times in a row it had failed then.
        frame: when it failed.
        until: first frame in which it may work again; None when it never may.
        was_on: whether it was switched on.
    """

    times: int
    frame: int
    until: int | None
    was_on: bool


@dataclass(frozen=True)
class Turn:
    """When the agents on call run next.

    Attributes:
        due: the frame.
        gap: tracked frames from their last run to it.
    """

    due: int
    gap: int

    def since(self, frame: int, stride: int = 1) -> int:
        """How many tracked frames after their last run `frame` is, at most the gap.

        >>> Turn(due=12, gap=4).since(11), Turn(due=20, gap=4).since(15, stride=5)
        (3, 3)
        """
        return min((frame - self.due) // stride, 0) + self.gap


@dataclass(frozen=True)
class TargetNet:
    """The live net of one target.

    Attributes:
        template: the plate it was copied from.
        active: agents that are switched on.
        rests_until: self-stopped agent -> first frame at which it may be switched on again.
        rest_count: agent -> how many times it stopped itself.
        quarantined: agents that failed and are out.
        by_hand: agent that a person switched -> whether on; no rule switches it until it is released.
        shed: agents that were switched off for want of time, in this order.
        most_particles: most hypotheses for want of time; None without such a limit.
        faults: agent that failed, whether it is still out or not -> its last failure.
        sampled: agent that is switched off but still evaluated -> in one of so many tracked frames.
        turn: when its agents on call run next; None while they run in every frame.
        status: tracking, uncertain or lost.
    """

    template: str
    active: frozenset[str]
    rests_until: Mapping[str, int] = field(default_factory=dict)
    rest_count: Mapping[str, int] = field(default_factory=dict)
    quarantined: frozenset[str] = frozenset()
    status: str = "tracking"
    by_hand: Mapping[str, bool] = field(default_factory=dict)
    faults: Mapping[str, Fault] = field(default_factory=dict)
    shed: tuple[str, ...] = ()
    most_particles: int | None = None
    sampled: Mapping[str, int] = field(default_factory=dict)
    turn: Turn | None = None

    def looking(self, ordinal: int) -> frozenset[str]:
        """The agents that look at this tracked frame: those switched on, and those whose sample is due."""
        if not self.sampled:
            return self.active
        return self.active | {agent for agent, every in self.sampled.items() if ordinal % every == 0}

    def shed_without(self, agent: str) -> tuple[str, ...]:
        """The agents that are shed, but for one."""
        return tuple(one for one in self.shed if one != agent)
