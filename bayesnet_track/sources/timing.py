"""The clock of a video: its nominal frame interval, what counts as a gap, and its declared length."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import Any

DEFAULT_RATE = Fraction(25)
FEW_STEPS = 8
_CONSTANT_SHARE = 0.9
_MAX_SNAP = 0.25


@dataclass(frozen=True)
class Timing:
    """How the time stamps of a stream become times in nominal frame intervals.

    Attributes:
        tick: seconds of one unit of a time stamp (the stream's time base).
        interval: nominal frame interval in seconds.
        gap_from: steps of this many intervals or more count as a gap.
        is_constant: whether nine in ten steps have the nominal length.
    """

    tick: Fraction
    interval: Fraction
    gap_from: float
    is_constant: bool

    @property
    def interval_s(self) -> float:
        """The nominal frame interval in seconds."""
        return float(self.interval)

    def intervals(self, ticks: int) -> float:
        """Time of a stamp, `ticks` after the origin, in intervals.

        A time within the stamps' rounding of a whole number is that number.

        >>> Timing(Fraction(1, 1000), Fraction(1, 30), 1.5, True).intervals(67)
        2.0
        """
        exact = ticks * self.tick / self.interval
        whole = round(exact)
        return (
            float(whole)
            if abs(exact - whole) <= min(float(self.tick / self.interval), _MAX_SNAP)
            else float(exact)
        )


@dataclass(frozen=True)
class Declared:
    """What a container says of its length.

    Attributes:
        frames: number of frames, or None.
        duration_s: seconds, or None.
        slack_s: how much a whole file may fall short of `duration_s`.
        from_zero: whether the duration counts from time 0 (Matroska) or from the first picture.
    """

    frames: int | None
    duration_s: float | None
    slack_s: float
    from_zero: bool = False


def timing_of(stream: Any, stamps: Sequence[int]) -> Timing:
    """The timing of a stream from the sorted stamps of its first packets (may be empty).

    The nominal interval is the median step. Stamps are rounded to ticks, so where a rate that the stream
    declares agrees with the median to one tick, that rate is taken, else the mean of the steps within one
    tick of the median. A step counts as a gap from 1.5 times the 95 % quantile of the steps on: 1.5 intervals
    at a constant rate, more where the rate varies.
    """
    tick = Fraction(stream.time_base or Fraction(1, 1000))
    rates = (stream.guessed_rate, stream.average_rate, stream.base_rate)
    # An unknown rate is None or, from PyAV 19, the untrue 0/0.
    declared = [1 / Fraction(rate) for rate in rates if rate and rate > 0]
    steps = sorted(after - before for before, after in pairwise(stamps) if after > before)
    # A cut through reordered pictures leaves holes among the last stamps, so few of them prove little.
    if len(steps) < FEW_STEPS:
        likely = [interval for interval in declared if not steps or 8 * interval >= steps[0] * tick]
        if likely or not steps:
            return Timing(tick, likely[0] if likely else 1 / DEFAULT_RATE, 1.5, True)
    median = steps[(len(steps) - 1) // 2]
    near = [step for step in steps if abs(step - median) <= 1]
    agreeing = [interval for interval in declared if abs(interval - median * tick) <= tick]
    interval = agreeing[0] if agreeing else Fraction(sum(near), len(near)) * tick
    tolerance = max(1.0, 0.1 * median)
    constant = sum(abs(step - median) <= tolerance for step in steps) >= _CONSTANT_SHARE * len(steps)
    usual = steps[min(int(0.95 * len(steps)), len(steps) - 1)] * tick / interval
    return Timing(tick, interval, 1.5 if constant else max(1.5, 1.5 * float(usual)), constant)


def declared_by(container: Any, stream: Any, timing: Timing) -> Declared:
    """What the container declares: its number of frames, else its duration (MP4 and MKV).

    Other containers declare nothing: FFmpeg's duration of them is a guess from what is there.
    """
    slack = (0.75 if timing.is_constant else timing.gap_from) * timing.interval_s
    tagged = _seconds(stream.metadata.get("DURATION", ""))
    if stream.duration is not None and stream.duration > 0:
        duration: float | None = float(stream.duration * timing.tick)
    elif tagged is not None:
        duration = tagged
    elif container.duration is not None and container.duration > 0:
        duration = container.duration / 1e6
        # Sound may last longer. A second stream of pictures is often one made up by damage.
        slack += 1.0 if any(other.type != "video" for other in container.streams) else 0.0
    else:
        duration = None
    if stream.frames > 0:
        return Declared(int(stream.frames), duration, slack)
    formats = set(container.format.name.split(","))
    if duration is None or not {"matroska", "mov"} & formats:
        return Declared(None, None, slack)
    frames = round(duration / timing.interval_s) if timing.is_constant else None
    return Declared(frames, duration, slack, "matroska" in formats)


def _seconds(text: str) -> float | None:
    """Seconds of an ``HH:MM:SS.fff`` text; None when it is something else or 0."""
    try:
        hours, minutes, seconds = (float(part) for part in text.split(":"))
    except ValueError:
        return None
    total = 3600 * hours + 60 * minutes + seconds
    return total if 0 < total < 1e9 else None
