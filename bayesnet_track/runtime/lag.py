"""Detections that come late, within a lag: they are tracked where they belong, and what follows anew."""

from __future__ import annotations

import copy
from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.metrics import Answers, FrameMetrics
from bayesnet_track.runtime.frame_clock import Standing, checked_seconds


@dataclass(frozen=True, eq=False)
class Arrival:
    """Input of a program for a time.

    Attributes:
        time_s: when it was taken, s; None without a clock.
        detections: those of one detector, or camera or sensor -> its own; None where nobody looked.
        frame: the BGR frame, if one is given.
    """

    time_s: float | None
    detections: Any
    frame: NDArray[np.uint8] | None


@dataclass(frozen=True, eq=False)
class SettledStep:
    """A step that is final.

    Attributes:
        time_s: when it was taken, s.
        detections: what `update` gives of its detections.
        targets: measurements of every target, also of lost ones.
        events: events and decisions.
        queries: query of the graph -> its answers.
    """

    time_s: float
    detections: Any
    targets: Sequence[FrameMetrics]
    events: tuple[Event, ...]
    queries: Mapping[str, Answers]


@dataclass(frozen=True, eq=False)
class LagStep:
    """A step that can still change: its arrival, the standing after it, and its marked detections."""

    arrival: Arrival
    time_s: float
    standing: Standing
    marked: Any

    def settled(self) -> SettledStep:
        """The step as it is told once it is final."""
        queries = {answers.query: answers for answers in self.standing.answers}
        events, targets = self.standing.events, self.standing.metrics
        return SettledStep(self.time_s, self.marked, targets, events, queries)


Advance = Callable[[Standing | None, Arrival], tuple[Standing, Any]]
"""Tracks a step: the standing before it and its arrival -> the standing after it, marked detections."""


@dataclass(frozen=True, eq=False)
class LagWindow:
    """The steps within the lag, and those before it that nobody has asked for yet.

    Attributes:
        lag_s: how late detections may come, s, above 0.
        base: where the tracker stood before the first of `steps`; None before the first frame, or without
            `steps`.
        steps: those that can still change, in order of time.
        final: final ones, in order of time.
    """

    lag_s: float
    base: Standing | None = None
    steps: tuple[LagStep, ...] = ()
    final: tuple[SettledStep, ...] = ()

    @classmethod
    def opened(cls, lag_s: float) -> Self | None:
        """The window before the first frame; None without a lag. Raises ValueError for no time."""
        try:
            seconds = checked_seconds(lag_s)
        except ValueError:
            raise ValueError(
                f"lag_s={lag_s!r}: how late detections may come, a number of seconds from 0 on, is needed"
            ) from None
        return cls(seconds) if seconds else None

    @property
    def newest(self) -> Standing | None:
        """The standing after the latest step; None without steps."""
        return self.steps[-1].standing if self.steps else None

    def extended(
        self, arrival: Arrival, advance: Advance, current: Standing | None, anew: str
    ) -> tuple[Self, Any]:
        """The window with an arrival, and the detections of this one with their targets.

        Args:
            arrival: what came.
            current: where the tracker stands after the latest time; None before the first frame.
            advance: tracks a step; called for the arrival and for all steps after it.
            anew: what to call where the clock began anew.

        Raises:
            ValueError: no time is given, it is final, or the same camera or sensor came twice for it.
        """
        if arrival.time_s is None:
            raise ValueError(f"no time_s, which the lag of {self.lag_s:g} s needs with every frame")
        time_s = checked_seconds(arrival.time_s)
        if current is not None and time_s < current.clock.time_s - self.lag_s:
            raise ValueError(
                f"time_s={time_s!r} is {current.clock.time_s - time_s:.6g} s before the latest time, "
                f"{current.clock.time_s!r}, and final, since lag_s={self.lag_s:g}: these are not used; "
                f"allowed: a longer lag_s; where the clock began anew, {anew}"
            )
        fresh = copy.deepcopy(arrival)  # the caller may reuse its buffers
        place = bisect_left(self.steps, time_s, key=lambda step: step.time_s)
        followers = self.steps[place:]
        if followers and followers[0].time_s == time_s:
            fresh, followers = _joined(followers[0].arrival, fresh), followers[1:]
        base, steps = self.base if self.steps else current, list(self.steps[:place])
        for entry in (fresh, *(step.arrival for step in followers)):
            standing, marked = advance(steps[-1].standing if steps else base, entry)
            steps.append(LagStep(entry, standing.clock.time_s, standing, marked))
        marked = steps[place].marked
        if isinstance(marked, Mapping):
            marked = {name: marked[name] for name in arrival.detections or {} if name in marked} or None
        return self._trimmed(base, steps), marked

    def collected(self, end: bool) -> tuple[Self, list[SettledStep]]:
        """The window without its final steps, and these; all of its steps at the end."""
        if not end:
            return replace(self, final=()), list(self.final)
        steps = [*self.final, *(step.settled() for step in self.steps)]
        return replace(self, base=None, steps=(), final=()), steps

    def _trimmed(self, base: Standing | None, steps: list[LagStep]) -> Self:
        """The window with these steps, of which the first may be final."""
        first_s = steps[-1].time_s - self.lag_s
        count = bisect_left(steps, first_s, key=lambda step: step.time_s)
        base = steps[count - 1].standing if count else base
        final = (*self.final, *(step.settled() for step in steps[:count]))
        return replace(self, base=base, steps=tuple(steps[count:]), final=final)


def _joined(first: Arrival, second: Arrival) -> Arrival:
    """One arrival of two for the same time.

    Raises:
        ValueError: the two are not of different cameras or sensors.
    """
    named = [arrival.detections for arrival in (first, second) if arrival.detections is not None]
    is_named = all(isinstance(detections, Mapping) for detections in named)
    twice = sorted(set(named[0]) & set(named[1])) if is_named and len(named) == 2 else []
    if not is_named or twice or first.frame is not None or second.frame is not None:
        noun = f"the detections of {', '.join(map(str, twice))}" if twice else "a frame"
        raise ValueError(
            f"time_s={second.time_s!r} came before: {noun} would count twice; allowed for a time that came "
            "before: detections of other cameras or sensors"
        )
    merged = {name: values for detections in named for name, values in detections.items()}
    return replace(first, detections=merged or None)
