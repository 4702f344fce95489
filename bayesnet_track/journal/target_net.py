"""The live net of one target, and the numbers that change it."""

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
    """The next run of the agents on call.

    Attributes:
        due: the frame.
        gap: tracked frames from their last run to it.
    """

    due: int
    gap: int

    def since(self, frame: int, stride: int = 1) -> int:
        """Number of tracked frames from their last run to `frame`, at most the gap.

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
        return self.active | {agent for agent, interval in self.sampled.items() if ordinal % interval == 0}

    def shed_without(self, agent: str) -> tuple[str, ...]:
        """The agents that are shed, but for one."""
        return tuple(name for name in self.shed if name != agent)


@dataclass(frozen=True)
class Cause:
    """The numbers that made a threshold rule fire.

    Attributes:
        unit: the threshold's unit: ud_px2, ud_box or ud_baseline; score where the rule goes by it.
        level: the threshold in that unit.
        value: UD at this frame in that unit, or the score.
        frames: how many consecutive frames it had to hold.
        turning: the threshold, in that unit, at which the rule would not have fired.
        ud_px2: UD at this frame in px^2.
        scale_px2: px^2 per unit (1, the estimate's area, or the baseline).
    """

    unit: str
    level: float
    value: float
    frames: int
    turning: float
    ud_px2: float
    scale_px2: float


@dataclass(frozen=True)
class RuleCause:
    """The numbers that made an agent's own rule fire, whose threshold is a plain number, with their words.

    Attributes:
        rule: the key of the rule.
        quantity: what was compared, in words.
        unit: its unit, with the space before it.
        relation: `>` if the rule fires above the threshold, `<` if below.
        level: the threshold.
        value: the quantity at this frame.
        frames: how many consecutive frames it had to hold.
        turning: the threshold at which the rule would not have fired.
    """

    rule: str
    quantity: str
    unit: str
    relation: str
    level: float
    value: float
    frames: int
    turning: float


@dataclass(frozen=True)
class ScoreCause:
    """The numbers that made a threshold of the score fire.

    Attributes:
        level: the threshold, a probability of being on target.
        score: the score at this frame.
        frames: how many consecutive frames it had to be below, or not to be below.
        turning: the threshold at which the status would have stayed: at or below it when the score fell,
            above it when it rose.
        fell: whether the score fell below the level.
        of: what was compared instead of the score: `existence`, the probability that the target exists.
        key: the key of `lost` that holds the threshold; left out in a journal that does not say.
        before: the status until now; left out likewise.
    """

    level: float
    score: float
    frames: int
    turning: float
    fell: bool
    of: str = field(default="", metadata={"left_out_when_empty": True})
    key: str = field(default="", metadata={"left_out_when_empty": True})
    before: str = field(default="", metadata={"left_out_when_empty": True})


@dataclass(frozen=True)
class FitCause:
    """The numbers by which a target was lost because no hypothesis fitted it.

    Attributes:
        level: the threshold, `fit_below`: a likelihood as a share of that of a perfect match.
        fit: the best hypothesis' likelihood at this frame, as such a share.
        frames: how many consecutive frames it had to be below (UD too high counts as well).
        turning: the threshold at or below which it would not have been lost; None when UD alone said so, too.
    """

    level: float
    fit: float
    frames: int
    turning: float | None


@dataclass(frozen=True)
class HiddenCause:
    """The numbers that made a target be lost because it probably cannot be seen.

    Attributes:
        level: the level, `lost_above`.
        hidden: probability that it is in a mode in which it cannot be seen.
    """

    level: float
    hidden: float


@dataclass(frozen=True)
class Concentration:
    """The numbers of the test whether a belief lies around one mode: a one-sided binomial test.

    Attributes:
        share: share of the belief that has to lie inside the window.
        within_box: radius of the window, in sqrt(w h) of the most probable state.
        confidence: confidence of the test.
        inside: share that lies inside at this frame.
        trials: effective hypotheses, the trials of the test; infinite when the share is exact.
        vouched: largest `share` at which the test would say at this frame that the belief is concentrated.
        frames: how many consecutive frames it had to say so, or not to say so.
        turning: the `share` at which the rule would not have fired: at or below it for one that switches on,
            above it for one that switches off.
        radius_px: radius of the window.
        ud_px2: UD at this frame.
    """

    share: float
    within_box: float
    confidence: float
    inside: float
    trials: float
    vouched: float
    frames: int
    turning: float
    radius_px: float
    ud_px2: float
