"""What the rules remember between frames: streaks, baselines, helpfulness. All immutable."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from statistics import median

from bayesnet_track.adapt.information import Worth
from bayesnet_track.numerics.records import changed

QUIET_WINDOW = 50
QUIET_MINIMUM = 10


@dataclass(frozen=True)
class Streak:
    """Consecutive frames on which a condition held.

    Attributes:
        count: how many.
        values: the values of the last of them, as many as the rule asks for: the one closest to the level is
            where a rule that fires now would not have fired.
    """

    count: int = 0
    values: tuple[float, ...] = ()

    def then(self, holds: bool, value: float, frames: int) -> Streak:
        """The streak after a frame more, for a rule that asks for `frames` of them."""
        return Streak(self.count + 1, (*self.values, value)[-frames:]) if holds else NO_STREAK


NO_STREAK = Streak()


@dataclass(frozen=True)
class Quiet:
    """The measured baseline of a node's UD.

    It is the median of the last 50 values seen with the smallest set of active agents below the node that has
    at least 10 of them: the level of the agents that stay on. Fewer agents are less sure, so sets larger than
    the present one are not asked: until 10 values are seen with so few agents, the level is unknown. Values
    above the node's activation level, of a lost target, or without an active agent are no quiet ones.

    Attributes:
        values: set of active agents -> its last values of UD, px^2.
    """

    values: Mapping[frozenset[str], tuple[float, ...]] = field(default_factory=dict)

    def seen(self, active: frozenset[str], ud_px2: float) -> Quiet:
        """With one more value."""
        return Quiet({**self.values, active: (*self.values.get(active, ()), ud_px2)[-QUIET_WINDOW:]})

    def level_px2(self, active: frozenset[str]) -> float | None:
        """The baseline with `active` switched on, or None while it is unknown."""
        if len(self.values) == 1:  # the usual case, told apart from the others because it is asked often
            ((agents, seen),) = self.values.items()
            applies = len(seen) >= QUIET_MINIMUM and (len(agents) <= len(active) or not active)
            return self._only_median if applies else None
        known = [
            (len(agents), sorted(agents))
            for agents, seen in self.values.items()
            if len(seen) >= QUIET_MINIMUM and (len(agents) <= len(active) or not active)
        ]
        return median(self.values[frozenset(min(known)[1])]) if known else None

    @cached_property
    def _only_median(self) -> float:
        """The median of the only set's values: several rules of a frame ask for it."""
        (seen,) = self.values.values()
        return median(seen)


NO_QUIET = Quiet()


@dataclass(frozen=True)
class Memory:
    """The memory of one target's rules.

    Attributes:
        activate: governor -> streak above its activation level.
        deactivate: governor -> streak below its deactivation level.
        self_check: agent -> streak above its own level.
        lost: streak of frames that look lost.
        unfit: the fits of the same frames; minus infinity where UD is too high.
        found: streak of frames that look found.
        seen: streak of frames that do not look lost, where the score says so.
        unsure: streak of frames that look uncertain or lost, where the score says so.
        quiet: governor (and root) -> baseline.
        helpful: agent -> (sum of contributions while active, frames).
        missed: agent -> frames in a row in which it gave no answer.
        worth: governor whose rules go by it -> what its agents contributed, the past fading.
    """

    activate: Mapping[str, Streak] = field(default_factory=dict)
    deactivate: Mapping[str, Streak] = field(default_factory=dict)
    self_check: Mapping[str, Streak] = field(default_factory=dict)
    lost: Streak = NO_STREAK
    found: Streak = NO_STREAK
    seen: Streak = NO_STREAK
    unsure: Streak = NO_STREAK
    quiet: Mapping[str, Quiet] = field(default_factory=dict)
    helpful: Mapping[str, tuple[float, int]] = field(default_factory=dict)
    worth: Mapping[str, Worth] = field(default_factory=dict)
    missed: Mapping[str, int] = field(default_factory=dict)
    unfit: Streak = NO_STREAK

    def with_contributions(self, contribution: Mapping[str, float]) -> Memory:
        """With this frame's contributions of the active agents counted."""
        return changed(self, helpful=self.counting(contribution))

    def counting(self, contribution: Mapping[str, float]) -> dict[str, tuple[float, int]]:
        """`helpful` with them counted."""
        counted = dict(self.helpful)
        for agent, nats in contribution.items():
            total, frames = counted.get(agent, (0.0, 0))
            counted[agent] = (total + nats, frames + 1)
        return counted

    def helpfulness(self, agent: str) -> float | None:
        """Mean contribution in nats over the frames on which the agent was active; None when it never was."""
        total, frames = self.helpful.get(agent, (0.0, 0))
        return total / frames if frames else None
