"""What a tracker finds from an answered box on, forward or backward: a pure function of frame and box."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from typing import Protocol

from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.numerics.arrays import Image
from bayesnet_track.runtime.annotation.answers import Box
from bayesnet_track.runtime.tracker import Tracker

Key = tuple[int, Box, int]
"""Frame and box that a run starts with, and 1 forward or -1 backward."""

AT_ONCE = 8
"""Trackers that are kept ready to go on: each holds frames."""


class Frames(Protocol):
    """The frames of a video, in any order."""

    def __len__(self) -> int:
        """How many there are."""

    def image(self, frame: int) -> Image:
        """A frame (H, W, 3) uint8, BGR."""


@dataclass(frozen=True)
class Found:
    """What was found in a frame: a box, and how sure it is.

    Attributes:
        probability: of being on target, IoU above 0.5.
        sd: standard deviations of the centre, px.
        status: tracking, uncertain or lost.
    """

    box: Box
    probability: float
    sd: tuple[float, float]
    status: str


class Runs(Protocol):
    """Where a target is found in `frame` by a run that starts with `box` in `start`."""

    def at(self, start: int, box: Box, frame: int) -> Found:
        """Forward where `frame` is later than `start`, else backward."""


@dataclass
class TrackerRuns:
    """Runs of the tracker, each as far as it was asked for. They are kept: the same question costs nothing.

    A run begins with references learnt from its own box, so that a correction is what is learnt from; and
    it depends on nothing but its start, so that taking an answer back gives what there was before.
    """

    graph: CheckedGraph
    frames: Frames
    seed: int = 0
    max_side: int | None = None
    _runs: dict[Key, _Run] = field(default_factory=dict)
    _live: list[Key] = field(default_factory=list)

    def at(self, start: int, box: Box, frame: int) -> Found:
        """See `Runs`."""
        step = 1 if frame > start else -1
        key = (start, box, step)
        run = self._runs.setdefault(key, _Run(partial(self._find, start, box, step)))
        if not run.reaches(abs(frame - start) - 1):
            self._live = [one for one in self._live if one != key] + [key]
            for old in self._live[:-AT_ONCE]:
                self._runs[old].rest()
            self._live = self._live[-AT_ONCE:]
        return run.at(abs(frame - start) - 1)

    def _find(self, start: int, box: Box, step: int) -> Iterator[Found]:
        tracker = Tracker(self.graph, self.seed, max_side=self.max_side)
        tracker.init(self.frames.image(start), box)
        found = Found(box, 1.0, (0.0, 0.0), "tracking")
        last = len(self.frames) if step > 0 else -1
        for frame in range(start + step, last, step):
            tracker.update(self.frames.image(frame))
            yield (found := _found(tracker, found))


def _found(tracker: Tracker, before: Found) -> Found:
    try:
        line = tracker.metrics
    except RuntimeError:  # it has ended: a person corrects the box where it was last
        return replace(before, probability=0.0, status="lost")
    x, y, w, h = (float(value) for value in line.xywh)
    return Found((x, y, w, h), line.score, (float(line.sd[0]), float(line.sd[1])), tracker.status)


class _Run:
    def __init__(self, begin: Callable[[], Iterator[Found]]) -> None:
        self._begin, self._found = begin, list[Found]()
        self._ahead: Iterator[Found] | None = None

    def reaches(self, number: int) -> bool:
        return len(self._found) > number

    def at(self, number: int) -> Found:
        if self._ahead is None and not self.reaches(number):
            self._ahead = islice(self._begin(), len(self._found), None)
        try:
            while self._ahead is not None and not self.reaches(number):
                self._found.append(next(self._ahead))
        except BaseException:
            self.rest()  # an iterator that raised gives nothing more
            raise
        return self._found[number]

    def rest(self) -> None:
        """Let go of the tracker; to go on it has to begin anew."""
        self._ahead = None
