"""The conditions of rules: levels of UD, and the test whether a belief lies around one mode."""

from __future__ import annotations

from dataclasses import dataclass

from bayesnet_track.graph.spec import Concentrated, Level
from bayesnet_track.journal.net.target_net import Cause, Concentration
from bayesnet_track.numerics.distributions import vouched_share


@dataclass(frozen=True)
class Reading:
    """A level applied to one value of UD: both in the level's unit."""

    unit: str
    level: float
    value: float
    ud_px2: float
    scale_px2: float

    @property
    def above(self) -> bool:
        """UD lies above the level: things are not well."""
        return self.value > self.level

    @property
    def below(self) -> bool:
        """UD lies below the level: all is well."""
        return self.value < self.level

    def cause(self, frames: int, turning: float) -> Cause:
        """The numbers for the journal."""
        return Cause(self.unit, self.level, self.value, frames, turning, self.ud_px2, self.scale_px2)

    def cause_above(self, frames: int, values: tuple[float, ...]) -> Cause:
        """Why a rule fired that asks for UD above the level; `values` are those of its streak."""
        return self.cause(frames, min(values))

    def cause_below(self, frames: int, values: tuple[float, ...]) -> Cause:
        """Why a rule fired that asks for UD below the level."""
        return self.cause(frames, max(values))


def read_level(level: Level, ud_px2: float, area_px2: float, quiet_px2: float | None) -> Reading | None:
    """`ud_px2` in the level's unit; None while the baseline that it needs is unknown."""
    scale = scale_of(level, area_px2, quiet_px2)
    return None if scale is None else Reading(level.kind, level.settings, ud_px2 / scale, ud_px2, scale)


def scale_of(level: Level, area_px2: float, quiet_px2: float | None) -> float | None:
    """The level's unit in px^2; None while the baseline that it needs is unknown."""
    scale = {"ud_px2": 1.0, "ud_box": area_px2, "ud_baseline": quiet_px2}[level.kind]
    return None if scale is None or scale <= 0 else scale


@dataclass(frozen=True)
class Inside:
    """What of a belief lies around its mode.

    Attributes:
        share: of the belief, inside the window.
        trials: effective hypotheses that know it; inf when it is exact.
        radius_px: of the window.
    """

    share: float
    trials: float
    radius_px: float


@dataclass(frozen=True)
class Tested:
    """The binomial test applied to one belief.

    `value` is the largest share that the test grants (the lower Clopper-Pearson bound): the belief is
    concentrated when it reaches the share that is asked for, which is the case exactly when
    P(X >= inside | trials, share) <= 1 - confidence.
    """

    test: Concentrated
    inside: Inside
    value: float
    ud_px2: float

    @property
    def above(self) -> bool:
        """The test cannot say that the belief is concentrated: things are not well."""
        return self.value < self.test.share

    @property
    def below(self) -> bool:
        """It can: all is well."""
        return not self.above

    def cause_above(self, frames: int, values: tuple[float, ...]) -> Concentration:
        """Why a rule fired that asks for no concentration; `values` are those of its streak."""
        return self._cause(frames, max(values))

    def cause_below(self, frames: int, values: tuple[float, ...]) -> Concentration:
        """Why a rule fired that asks for concentration."""
        return self._cause(frames, min(values))

    def _cause(self, frames: int, turning: float) -> Concentration:
        test, inside = self.test, self.inside
        return Concentration(
            share=test.share,
            within_box=test.within_box,
            confidence=test.confidence,
            inside=inside.share,
            trials=inside.trials,
            vouched=self.value,
            frames=frames,
            turning=turning,
            radius_px=inside.radius_px,
            ud_px2=self.ud_px2,
        )


def apply_test(test: Concentrated, inside: Inside, ud_px2: float) -> Tested:
    """The test on what lies inside its window.

    >>> few = apply_test(Concentrated(share=0.9), Inside(1.0, 20.0, 10.0), 25.0)
    >>> more = apply_test(Concentrated(share=0.9), Inside(1.0, 40.0, 10.0), 25.0)
    >>> few.below, more.below
    (False, True)
    """
    return Tested(test, inside, vouched_share(inside.share, inside.trials, test.confidence), ud_px2)
