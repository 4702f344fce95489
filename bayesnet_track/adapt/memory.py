"""What the rules remember between frames: streaks, quiet levels, helpfulness. All immutable."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from statistics import median

QUIET_WINDOW = 50
QUIET_MINIMUM = 10


@dataclass(frozen=True)
class Streak:
    """Consecutive frames on which a condition held.

    Attributes:
        count: how many.
        turning: the value closest to the level, which would have broken the streak first.
    """

    count: int = 0
    turning: float = 0.0

    def above(self, value: float, level: float) -> Streak:
        """The streak after a frame on which the condition is value > level."""
        if value <= level:
            return Streak()
        return Streak(self.count + 1, value if self.count == 0 else min(self.turning, value))

    def below(self, value: float, level: float) -> Streak:
        """The streak after a frame on which the condition is value < level."""
        if value >= level:
            return Streak()
        return Streak(self.count + 1, value if self.count == 0 else max(self.turning, value))


@dataclass(frozen=True)
class Quiet:
    """The measured quiet level of a node's UD.

    It is the median of the last 50 values seen with the smallest active set that has at least 10 of them:
    the level of the agents that stay on. Values above the node's activation level are no quiet ones and are
    left out.

    Attributes:
        values: active set -> its last values of UD, px^2.
    """

    values: Mapping[frozenset[str], tuple[float, ...]] = field(default_factory=dict)

    def seen(self, active: frozenset[str], ud_px2: float) -> Quiet:
        """With one more value."""
        return Quiet({**self.values, active: (*self.values.get(active, ()), ud_px2)[-QUIET_WINDOW:]})

    @property
    def level_px2(self) -> float | None:
        """The quiet level, or None while no active set has been seen often enough."""
        known = [
            (len(active), sorted(active))
            for active, seen in self.values.items()
            if len(seen) >= QUIET_MINIMUM
        ]
        return median(self.values[frozenset(min(known)[1])]) if known else None


@dataclass(frozen=True)
class Memory:
    """The memory of one target's rules.

    Attributes:
        activate: governor -> streak above its activation level.
        deactivate: governor -> streak below its deactivation level.
        self_check: agent -> streak above its own level.
        attempts: agent -> local actions tried in this episode.
        lost: streak of frames that look lost.
        found: streak of frames that look found.
        quiet: governor (and root) -> quiet level.
        helpful: agent -> (sum of contributions while active, frames).
    """

    activate: Mapping[str, Streak] = field(default_factory=dict)
    deactivate: Mapping[str, Streak] = field(default_factory=dict)
    self_check: Mapping[str, Streak] = field(default_factory=dict)
    attempts: Mapping[str, int] = field(default_factory=dict)
    lost: Streak = Streak()
    found: Streak = Streak()
    quiet: Mapping[str, Quiet] = field(default_factory=dict)
    helpful: Mapping[str, tuple[float, int]] = field(default_factory=dict)

    def with_contributions(self, contribution: Mapping[str, float]) -> Memory:
        """With this frame's contributions of the active agents counted."""
        counted = dict(self.helpful)
        for agent, nats in contribution.items():
            total, frames = counted.get(agent, (0.0, 0))
            counted[agent] = (total + nats, frames + 1)
        return replace(self, helpful=counted)

    def helpfulness(self, agent: str) -> float | None:
        """Mean contribution in nats over the frames on which the agent was active; None when it never was."""
        total, frames = self.helpful.get(agent, (0.0, 0))
        return total / frames if frames else None
