"""Which detections of a file a run will not use, and why: nothing is left out without a word."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import gcd
from pathlib import Path
from sys import maxsize

import numpy as np

from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.checks.cues import plugin_parameters
from bayesnet_track.numerics.boxes import corner_from_centre
from bayesnet_track.observation.detector import GIVEN, Detections, GivenParameters
from bayesnet_track.observation.settings import setting
from bayesnet_track.sources.entrances.boxes import LONG, LONG_SHARE, QUESTION, explain_corners
from bayesnet_track.sources.entrances.notices import notice
from bayesnet_track.vision.detectors.selection import left_out

Found = Mapping[int, Detections]


@dataclass(frozen=True)
class GivenFrames:
    """A file of detections, and the frames that were to be read.

    Attributes:
        file: its name.
        found: index of a frame -> its detections.
        frames: indices of the frames to read; up to `sys.maxsize` where their number is not known.
    """

    file: Path
    found: Found
    frames: range

    def say(self, graph: CheckedGraph, size: tuple[int, int]) -> None:
        """A notice for each reason that `explain_unused` gives."""
        for reason in explain_unused(graph, self.found, size, self.frames):
            notice(f"{self.file}: {reason}")

    def say_at_end(self, last: int) -> None:
        """A notice of detections after frame `last`, the last one that there was, if not said before."""
        stop = last + self.frames.step
        if stop < self.frames.stop:
            for reason in _explain_frames(self.found, range(self.frames.start, stop, self.frames.step)):
                notice(f"{self.file}: {reason}")


def explain_unused(graph: CheckedGraph, found: Found, size: tuple[int, int], frames: range) -> Iterator[str]:
    """A sentence for each reason to think that detections, video and graph do not go together.

    Args:
        graph: the graph.
        found: index of a frame -> its detections, in pixels of the frames that are tracked.
        size: width and height of these frames, px.
        frames: indices of the frames that are read; up to `sys.maxsize` where their number is not known.
    """
    if not any(map(len, found.values())):
        yield "no detection in it"
        return
    yield from _explain_frames(found, frames)
    read = {index: one for index, one in found.items() if index in frames}
    first = min(read, default=0)
    step = gcd(*(index - first for index in read))
    if step > frames.step:
        begin = f"{setting('--start', str(first))} " if first != frames.start else ""
        yield (
            f"only one frame in {step} has detections, and in the others nobody is detected: "
            f"{begin}{setting('--stride', str(step))} reads only those that have some"
        )
    yield from _explain_places(read, size)
    total = sum(map(len, read.values()))
    for plate in graph.targets.values():
        birth = plate.spec.birth
        if birth is None or birth.detector.detector != GIVEN:
            continue
        unused = left_out(read, plugin_parameters(birth.detector, GivenParameters), size, birth.labels)
        if unused:
            reasons = "; ".join(f"{count} {reason}" for reason, count in unused.items())
            yield f"{sum(unused.values())} of {total} detections are not used: {reasons}"


def _explain_frames(found: Found, frames: range) -> Iterator[str]:
    """What lies outside of the frames that are read, between them, and which of them have nothing."""
    read = sorted(index for index in found if index in frames)
    is_endless = frames.stop == maxsize
    span = f"{frames.start}" + (" and later ones" if is_endless else f" to {max(frames.stop - 1, 0)}")
    if found and not read:
        yield (
            f"no detection is of a frame that is read: they are of the frames {min(found)} to {max(found)}, "
            f"and {span} are read (both counted from 0; a MOT file counts from 1){QUESTION}"
        )
        return
    total = sum(map(len, found.values()))
    within = range(frames.start, frames.stop)
    outside = {
        f"before the first one that is read{QUESTION}": [one for one in found if one < frames.start],
        f"after the last one that is read{QUESTION}": [one for one in found if one >= frames.stop],
        f"which a stride of {frames.step} leaves out": [
            one for one in found if one in within and one not in frames
        ],
    }
    for where, indices in outside.items():
        if indices:
            place, _, question = where.partition(":")
            yield (
                f"{sum(len(found[one]) for one in indices)} of {total} detections are of frames {place} "
                f"({min(indices)} to {max(indices)}; {span} are read, counted from 0)"
                f"{':' * bool(question)}{question}"
            )
    if not read or is_endless:
        return
    empty = {"first": (frames.start, read[0] - 1), "last": (read[-1] + 1, frames.stop - 1)}
    for which, (first, last) in empty.items():
        length = (last - first + 1) // frames.step
        if length >= LONG and length >= LONG_SHARE * len(frames):
            yield (
                f"no detection is of the {which} {length} frames ({first} to {last}; {span} are read, "
                f"counted from 0){QUESTION}"
            )


def _explain_places(read: Found, size: tuple[int, int]) -> Iterator[str]:
    """Boxes that begin inside and reach far out of the frame, as corners do that are given as sizes."""
    if not read:
        return
    boxes = corner_from_centre(np.concatenate([one.boxes for one in read.values()]))
    yield from explain_corners(boxes, size, "detections")
