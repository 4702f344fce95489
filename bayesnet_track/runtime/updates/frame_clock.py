"""A tracker between two calls: times of its frames, where it stands, whether it looks at images."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Never, Self

from bayesnet_track.engine.compiled import CompiledPlate
from bayesnet_track.engine.outcome import State
from bayesnet_track.engine.step import Engine
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.metrics import Answers, FrameMetrics
from bayesnet_track.journal.net.target_net import TargetNet
from bayesnet_track.observation.detector import GIVEN
from bayesnet_track.runtime.resizing import Resizing
from bayesnet_track.runtime.results import FrameKind
from bayesnet_track.sources.entrances.notices import notice

ASSUMED_FPS = 25.0
"""Nominal frames a second where nobody says: those of a folder of images."""

MOST_FPS = 1e6
MOST_S = 1e11
"""Beyond it are the milliseconds since 1970, not the seconds."""

MOST_INTERVALS = 1e10
"""From one frame to the next: a belief that has spread for longer has no number that is good for anything."""

LONG_GAP, LONG_GAP_S = 500.0, 5.0
"""Intervals and seconds: what milliseconds given as seconds exceed, and hardly anything that is tracked."""


@dataclass(frozen=True)
class FrameClock:
    """The time of the last frame, and what the time of the next one is found from.

    Attributes:
        fps: nominal frames a second, as given; None where nobody says.
        index: number of the last frame, from 0; -1 before the first.
        time: its time in nominal frame intervals after the first frame.
        time_s: its time in seconds, as given; NaN without a clock.
        first_s: that of the first frame where times are given, else None.
    """

    fps: float | None = None
    index: int = -1
    time: float = -1.0
    time_s: float = math.nan
    first_s: float | None = None

    @classmethod
    def of_rate(cls, fps: float | None) -> Self:
        """The clock before the first frame; raises ValueError for no number of frames a second."""
        if fps is None:
            return cls()
        number = _number(fps)
        if not 1.0 / MOST_FPS <= number <= MOST_FPS:
            raise ValueError(
                f"fps={fps!r}: nominal frames a second, a number from {1 / MOST_FPS:g} to {MOST_FPS:g}, are "
                f"needed; leave it out for {ASSUMED_FPS:g}"
            )
        return cls(number)

    @property
    def rate(self) -> float:
        """Nominal frames a second."""
        return ASSUMED_FPS if self.fps is None else self.fps

    def restarted(self) -> Self:
        """The clock before the first frame of another video."""
        return type(self)(self.fps)

    def tick(self, time_s: float | None, anew: str) -> Self:
        """The clock at the next frame, which comes at `time_s`, or one nominal interval later with None.

        Args:
            time_s: seconds, any origin from 0 on.
            anew: what to call where the camera, or its clock, began anew.

        Raises:
            ValueError: not a time, not later than the last one, or given with some frames only.
        """
        index = self.index + 1
        if index and (time_s is None) != (self.first_s is None):
            with_or_not = ("without", "with") if time_s is None else ("with", "without")
            raise ValueError(
                f"frame {index} comes {with_or_not[0]} time_s and the frames before it {with_or_not[1]}; "
                "allowed: time_s with every frame, the first one, too, or with none"
            )
        if time_s is None:
            seconds = math.nan if self.fps is None else index / self.fps
            return replace(self, index=index, time=float(index), time_s=seconds)
        seconds = _seconds(time_s)
        if self.first_s is None:
            return replace(self, index=0, time=0.0, time_s=seconds, first_s=seconds)
        time = self._intervals(seconds, self.first_s)
        if not (seconds > self.time_s and time > self.time):
            raise ValueError(
                f"frame {index} at time_s={seconds!r} is not later than the frame before it, at "
                f"{self.time_s!r}; leave out frames that come late or twice; where the camera or its clock "
                f"began anew, {anew}"
            )
        if time - self.time > MOST_INTERVALS:
            raise ValueError(
                f"frame {index} at time_s={seconds!r} is more than {MOST_INTERVALS:g} intervals of "
                f"{self.rate:g} frames a second after the frame before it, at {self.time_s!r}; for another "
                f"video {anew}"
            )
        if time - self.time >= LONG_GAP and seconds - self.time_s >= LONG_GAP_S:
            notice(
                f"frame {index} comes {seconds - self.time_s:.6g} s after the one before it, "
                f"{time - self.time:.6g} intervals of {self.rate:g} frames a second: time_s counts seconds; "
                f"for another video {anew}"
            )
        return replace(self, index=index, time=time, time_s=seconds)

    def _intervals(self, seconds: float, first_s: float) -> float:
        """Intervals after the first frame; what is whole up to the rounding of the seconds is whole."""
        time = (seconds - first_s) * self.rate
        whole = float(round(time))
        slack = 1e-9 + 4.0 * math.ulp(max(seconds, first_s)) * self.rate
        return whole if abs(time - whole) <= slack and whole > self.time else time


def refuse_unknown(call: str, unknown: dict[str, Never]) -> None:
    """Refuse keywords that a call has not, with a word on the one for times; raises TypeError."""
    for name in unknown:
        raise TypeError(f"{call}() has no argument {name!r}; the time of a frame, in seconds, is time_s=")


def _seconds(time_s: float) -> float:
    seconds = _number(time_s)
    if not 0.0 <= seconds <= MOST_S:
        raise ValueError(
            f"time_s={time_s!r}: the time of a frame in seconds, a number from 0 to {MOST_S:g}; where its "
            "clock counts milliseconds or nanoseconds, divide by 1e3 or 1e9"
        )
    return seconds


def _number(value: object) -> float:
    """The value as a float; NaN where it is none."""
    if isinstance(value, str | bytes | bool):
        return math.nan
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return math.nan


def image_users(engine: Engine) -> tuple[str, ...]:
    """Names of what needs the pixels of each frame; empty if given detections are all that is used."""
    return tuple(
        f"{name} of {plate}" if len(engine.plates) > 1 else name
        for plate, compiled in engine.plates.items()
        for name in _of_plate(compiled)
    )


def _of_plate(compiled: CompiledPlate) -> Iterator[str]:
    for agent, cue in compiled.cues.items():
        if cue.needs:
            yield f"agent {agent}"
    birth = compiled.plate.spec.birth
    if birth is not None and birth.detector.detector != GIVEN:
        yield f"births by {birth.detector.detector}"
    if compiled.finder is not None:
        yield "relocalize by a detector"
    if compiled.moving is not None and compiled.moving.camera is not None:
        yield "motion with camera"
    if compiled.verifiers:
        yield f"score with {', '.join(compiled.verifiers)}"
    lost = compiled.plate.inference(compiled.plate.root).lost
    if lost is not None and lost.scene_cut is not None:
        yield "lost with scene_cut"


@dataclass(frozen=True, eq=False)
class Standing:
    """All that a tracker knows after a frame: replaced as a whole, so that who reads it never sees half.

    Attributes:
        state: the engine's state.
        clock: at the last frame.
        metrics: what was measured in it, in the pixels of the frames that are given.
        events: what was decided in it.
        kind: of the frames.
        resizing: how these become those that the engine sees.
        nets_before: nets that were live before it.
        answers: answers to the queries of the graph.
    """

    state: State
    clock: FrameClock
    metrics: Sequence[FrameMetrics]
    events: tuple[Event, ...]
    kind: FrameKind
    resizing: Resizing
    nets_before: Mapping[str, TargetNet] = field(default_factory=dict)
    answers: tuple[Answers, ...] = ()
