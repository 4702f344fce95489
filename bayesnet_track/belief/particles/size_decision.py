"""The decision on a frame's number of hypotheses: from what was asked for to a number, and to its report."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from bayesnet_track.belief.contract import Report
from bayesnet_track.belief.particles.sample_size import SampleSize, SizeMemory
from bayesnet_track.graph.settings.particles import AdaptiveSize
from bayesnet_track.journal.events.sample_sizes import ParticlesResized

ENLARGED = 1.25
"""A half is enlarged when it is asked for this many times its number: a second evaluation costs time."""

NOTABLE = 1.25
"""A number is written down when it is this factor above or below the one that was written last."""


@dataclass(frozen=True)
class SizeDecision:
    """All that one frame's number of hypotheses depends on.

    Attributes:
        size: the method.
        before: the last frame.
        halves_wanted: what each half of this frame's first hypotheses asked for.
        low: the least number.
        high: the largest number.
    """

    size: AdaptiveSize
    before: SizeMemory
    halves_wanted: tuple[SampleSize, SampleSize]
    low: int
    high: int

    @property
    def begin(self) -> int:
        """Hypotheses drawn before this frame is looked at: what the last one asked for."""
        return begin_with(self.before, self.low, self.high)

    @property
    def halves(self) -> tuple[int, int]:
        """How many of them are in each half."""
        return halve(self.begin)

    @property
    def more(self) -> tuple[int, int]:
        """By how many each half is enlarged: a function of what the other half asks for, never of its own."""
        first, second = self.halves
        most_first, most_second = halve(self.high)
        return (
            self._enlarge(self.halves_wanted[1], most_first, first) - first,
            self._enlarge(self.halves_wanted[0], most_second, second) - second,
        )

    @property
    def particles(self) -> int:
        """This frame's number."""
        return self.begin + sum(self.more)

    @property
    def is_notable(self) -> bool:
        """True when the number has moved away from the one that was last written down."""
        return not self.before.reported / NOTABLE <= self.particles <= self.before.reported * NOTABLE

    @property
    def cause(self) -> SampleSize:
        """What brought the number about: this frame's wish where it was enlarged, else the last frame's."""
        if not any(self.more):
            return self.before.wanted
        mean = (self.halves_wanted[0].particles + self.halves_wanted[1].particles) / 2
        larger = max(self.halves_wanted, key=lambda wanted: wanted.particles)
        return replace(larger, particles=mean, ess=self.halves_wanted[0].ess + self.halves_wanted[1].ess)

    def _enlarge(self, wanted: SampleSize, most: int, count: int) -> int:
        asked = wanted.asks(self.begin)
        return count if asked <= ENLARGED * self.begin else max(count, min(most, math.ceil(asked / 2)))

    def scale(self, factor: float) -> SizeDecision:
        """As if `factor` times as many had been asked for, in both frames."""
        first, second = (_scale(wanted, factor) for wanted in self.halves_wanted)
        before = replace(self.before, wanted=_scale(self.before.wanted, factor))
        return replace(self, before=before, halves_wanted=(first, second))


def _scale(wanted: SampleSize, factor: float) -> SampleSize:
    return replace(wanted, particles=factor * wanted.particles)


def begin_with(before: SizeMemory, low: int, high: int) -> int:
    """The number that a frame begins with: what the last one asked for, rounded up and kept in bounds."""
    asked = before.wanted.asks(before.first_pass)
    return low if asked <= low else high if asked >= high else math.ceil(asked)


def halve(count: int) -> tuple[int, int]:
    """Two halves of a whole number, the first the larger one."""
    return count - count // 2, count // 2


def make_report(sizing: SizeDecision) -> Report:
    """The event that says which number became which, and why."""
    cause, (setting, level) = sizing.cause, sizing.size.tolerance
    return lambda frame, target: ParticlesResized(
        frame=frame,
        target=target,
        particles=sizing.particles,
        before=sizing.before.reported,
        method=sizing.size.kind,
        need=cause.particles,
        limit=find_limit(sizing),
        early=any(sizing.more),
        field=cause.field,
        ess=cause.ess,
        bins=cause.bins,
        bin_px=getattr(sizing.size.settings, "bin_px", None),
        worth=cause.worth,
        sd_px=cause.sd_px,
        setting=setting,
        level=level,
        turning=find_turning(sizing),
    )


def find_limit(sizing: SizeDecision) -> str:
    """What kept the number from being as asked: max, min, ess (too few effective to save any), or nothing."""
    wanted, particles = sizing.cause, sizing.particles
    if wanted.particles > particles:
        return "max"
    # A half that is asked for less keeps what was drawn; and each half is rounded up.
    if any(sizing.more) or wanted.particles > particles - 2:
        return ""
    return "min" if particles == sizing.low else "ess"


def find_turning(sizing: SizeDecision) -> float | None:
    """The value of the setting at which the number would not have moved notably; None when no value is it."""
    reported, has_risen = sizing.before.reported, sizing.particles > sizing.before.reported

    def stays(log_factor: float) -> bool:
        particles = sizing.scale(math.exp(log_factor)).particles
        return particles <= reported * NOTABLE if has_risen else particles >= reported / NOTABLE

    kept, moves = (-_WIDEST if has_risen else _WIDEST), 0.0
    if not stays(kept):
        return None
    for _ in range(_HALVINGS):
        middle = (kept + moves) / 2
        kept, moves = (middle, moves) if stays(middle) else (kept, middle)
    setting, level = sizing.size.tolerance
    power = {"error": -1.0, "threshold": 1.0}.get(setting, -0.5)  # N is proportional to setting^(1 / power)
    return level * math.exp(power * kept)


_WIDEST = math.log(1e6)
_HALVINGS = 50
