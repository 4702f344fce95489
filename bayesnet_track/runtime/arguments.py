"""Arguments of `track` and the trackers: ranges, values that a run will not use, and its preparation."""

from __future__ import annotations

import math
import operator
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from math import gcd
from pathlib import Path
from sys import maxsize
from typing import Literal, SupportsIndex

import numpy as np

from bayesnet_track.engine.step import Engine
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.checks.cues import cue_parameters, plugin_parameters
from bayesnet_track.graph.checks.queries import input_columns
from bayesnet_track.journal.writer import write_atomically, writing
from bayesnet_track.numerics.boxes import corner_from_centre
from bayesnet_track.observation.detector import GIVEN, Detections, GivenParameters
from bayesnet_track.observation.settings import setting
from bayesnet_track.runtime.checkpoints.checkpoint import Checkpoints
from bayesnet_track.runtime.checkpoints.recipe import Recipe
from bayesnet_track.runtime.executors import RETRIES, Executing, PlacingError
from bayesnet_track.runtime.recording.record import Recorder
from bayesnet_track.runtime.recording.rundir import FILES, RunDirectory
from bayesnet_track.runtime.recording.videowriter import LEAST_SIDE
from bayesnet_track.runtime.resizing import LEAST_MAX_SIDE, Resizing
from bayesnet_track.runtime.results import FrameSource
from bayesnet_track.sources.entrances.boxes import LONG, LONG_SHARE, QUESTION, explain_corners
from bayesnet_track.sources.entrances.notices import notice
from bayesnet_track.sources.frames import Source
from bayesnet_track.vision.detectors.selection import left_out

MOST_MS = 1e7
"""`budget_ms` is below it."""


def whole_argument(name: str, value: SupportsIndex, minimum: int) -> int:
    """A whole number from `minimum` on, of any integer type.

    >>> whole_argument("stride", 3, 1)
    3

    Raises:
        ValueError: it is another value.
    """
    try:
        number = minimum - 1 if isinstance(value, bool) else operator.index(value)
    except TypeError:
        number = minimum - 1
    if number < minimum:
        raise ValueError(f"{name}={value!r}: a whole number from {minimum} on is needed")
    return number


def longest_side(value: SupportsIndex | None) -> int | None:
    """`max_side`; raises ValueError where it is no number of pixels that can be tracked in."""
    return None if value is None else whole_argument("max_side", value, LEAST_MAX_SIDE)


def milliseconds(value: float | None) -> float | None:
    """`budget_ms`; raises ValueError where it is no time that a frame can take."""
    if value is None:
        return None
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = 0.0
    if not 0.0 < number < MOST_MS:
        raise ValueError(
            f"budget_ms={value!r}: milliseconds above 0 and below {MOST_MS:g} are needed; None for no budget"
        )
    return number


def check_video(value: bool | Literal["mkv", "mp4"], side: SupportsIndex | None = None) -> int | None:
    """`video_side`, whole; raises ValueError where it or `video` is none that can be written."""
    if value not in (False, True, "mkv", "mp4"):
        raise ValueError(f"video={value!r}: False, True, 'mkv' or 'mp4' is needed; True is 'mkv'")
    if side is None:
        return None
    if value is False:
        raise ValueError(f"video_side={side!r}: no video is written; say which: video='mkv' or 'mp4'")
    return whole_argument("video_side", side, LEAST_SIDE)


def say_unused_by_cues(graph: CheckedGraph, source: FrameSource | None = None) -> None:
    """A notice for each thing that the agents' files hold and a run through `source` does not use."""
    frames = frames_of(source)
    seconds = float(getattr(source, "frame_interval_s", math.nan))
    for entry in input_columns(graph.spec).values():
        for text in entry.columns.gaps(frames, seconds):
            notice(text)
    for text in dict.fromkeys(_unused_by_cues(graph, frames)):
        notice(text)


def _unused_by_cues(graph: CheckedGraph, frames: range) -> Iterator[str]:
    for plate in graph.targets.values():
        for _, _, choice in plate.spec.cue_choices():
            declaration = graph.declarations[choice.cue]
            if declaration.unused is not None:
                yield from declaration.unused(cue_parameters(choice, declaration), frames)


def frames_of(source: FrameSource | None) -> range:
    """Numbers of the frames that a source gives; up to `sys.maxsize` where it does not say."""
    numbers: range | None = getattr(source, "numbers", None)
    if numbers is not None:
        return numbers
    expected = None if source is None else source.expected_frames
    return range(maxsize if expected is None else expected)


DetectionsByFrame = Mapping[int, Detections]


@dataclass(frozen=True)
class GivenFrames:
    """A file of detections, and the frames that were to be read.

    Attributes:
        file: its name.
        found: index of a frame -> its detections.
        frames: indices of the frames to read; up to `sys.maxsize` where their number is not known.
    """

    file: Path
    found: DetectionsByFrame
    frames: range

    def say(self, graph: CheckedGraph, size: tuple[int, int]) -> None:
        """A notice for each reason that `explain_unused` gives."""
        for reason in explain_unused(graph, self.found, size, self.frames):
            notice(f"{self.file}: {reason}")

    def say_at_end(self, last_frame: int) -> None:
        """A notice of detections after frame `last_frame`, the final one, if not said before."""
        stop = last_frame + self.frames.step
        if stop < self.frames.stop:
            for reason in _explain_frames(self.found, range(self.frames.start, stop, self.frames.step)):
                notice(f"{self.file}: {reason}")


def explain_unused(
    graph: CheckedGraph, detections: DetectionsByFrame, size: tuple[int, int], frames: range
) -> Iterator[str]:
    """A sentence for each reason to think that detections, video and graph do not go together.

    Args:
        graph: the graph.
        detections: index of a frame -> its detections, in pixels of the frames that are tracked.
        size: width and height of these frames, px.
        frames: indices of the frames that are read; up to `sys.maxsize` where their number is not known.
    """
    if not any(map(len, detections.values())):
        yield "no detection in it"
        return
    yield from _explain_frames(detections, frames)
    read = {index: of_frame for index, of_frame in detections.items() if index in frames}
    first = min(read, default=0)
    step = gcd(*(index - first for index in read))
    interval = step // frames.step
    if interval > 1 and not _waits_for(graph, first // frames.step, interval):
        begin = f"{setting('--start', str(first))} " if first != frames.start else ""
        yield (
            f"only one frame in {step} has detections, and in the others nobody is detected: "
            f"{begin}{setting('--stride', str(step))} reads only those that have some; with "
            f"every: {interval} in the graph's birth nobody looks at the others"
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
        unnamed = sum(label == "" for of_frame in read.values() for label in of_frame.labels)
        if unnamed:
            yield from (
                f"{unnamed} of {total} detections have no label: they say nothing of {category}"
                for category in plate.confusions.values()
            )


def _waits_for(graph: CheckedGraph, first: int, step: int) -> bool:
    """True if births by given detections leave out all but one in `step` frames, from the `first` on."""
    births = (plate.spec.birth for plate in graph.targets.values())
    intervals = [birth.every for birth in births if birth is not None and birth.detector.detector == GIVEN]
    return first % step == 0 and all(interval % step == 0 for interval in intervals)


def _explain_frames(detections: DetectionsByFrame, frames: range) -> Iterator[str]:
    """Describe detections outside of the frames that are read or between them, and frames that have none."""
    read = sorted(n for n in detections if n in frames)
    is_endless = frames.stop == maxsize
    span = f"{frames.start}" + (" and later ones" if is_endless else f" to {max(frames.stop - 1, 0)}")
    if detections and not read:
        yield (
            f"no detection is of a frame that is read: they are of the frames "
            f"{min(detections)} to {max(detections)}, and {span} are read "
            f"(both counted from 0; a MOT file counts from 1){QUESTION}"
        )
        return
    total = sum(map(len, detections.values()))
    span_read = range(frames.start, frames.stop)
    unread_frames = {
        f"before the first one that is read{QUESTION}": [n for n in detections if n < frames.start],
        f"after the last one that is read{QUESTION}": [n for n in detections if n >= frames.stop],
        f"which a stride of {frames.step} leaves out": [
            n for n in detections if n in span_read and n not in frames
        ],
    }
    for reason, indices in unread_frames.items():
        if indices:
            place, _, question = reason.partition(":")
            yield (
                f"{sum(len(detections[n]) for n in indices)} of {total} detections are of frames {place} "
                f"({min(indices)} to {max(indices)}; {span} are read, counted from 0)"
                f"{':' * bool(question)}{question}"
            )
    if not read or is_endless:
        return
    empty = {"first": (frames.start, read[0] - 1), "last": (read[-1] + 1, frames.stop - 1)}
    for end, (first, final) in empty.items():
        length = (final - first + 1) // frames.step
        if length >= LONG and length >= LONG_SHARE * len(frames):
            yield (
                f"no detection is of the {end} {length} frames ({first} to {final}; {span} are read, "
                f"counted from 0){QUESTION}"
            )


def _explain_places(read: DetectionsByFrame, size: tuple[int, int]) -> Iterator[str]:
    """Boxes that begin inside and reach far out of the frame, as corners do that are given as sizes."""
    if not read:
        return
    boxes = corner_from_centre(np.concatenate([of_frame.boxes for of_frame in read.values()]))
    yield from explain_corners(boxes, size, "detections")


def place_cues(
    stack: ExitStack,
    executing: Executing,
    engine: Engine,
    source: FrameSource,
    budget_ms: float | None,
) -> Engine:
    """The engine with its agents where they work, until `stack` closes.

    Where frames do not wait, as those of a camera or with a budget, no agent is asked again.

    Raises:
        PlacingError: an agent cannot be where it was put.
    """
    waits = budget_ms is None and not getattr(source, "is_live", False)
    if executing.hosts != "engine" and budget_ms is not None:
        raise PlacingError("hosts of cameras beside a budget: a frame of each is waited for")
    return stack.enter_context(executing).engine(engine, RETRIES if waits else 0)


def resizing_of(source: FrameSource, max_side: int | None) -> Resizing:
    """The resizing of the frames of a source, which is told of it; raises ValueError if they have depth."""
    resizing = Resizing.to(source.width, source.height, max_side)
    if not resizing.is_none and getattr(source, "has_depth", False):
        raise ValueError("max_side: frames with depth cannot be resized; allowed: frames of one camera")
    if isinstance(source, Source) and not resizing.is_none:
        source.tracked = resizing.tracked
    return resizing


def held_files(directory: RunDirectory, truth: str | None) -> dict[str, bytes]:
    """The small files of a run that goes on, as they are now, but for the scene's `truth`.

    Raises:
        OutputError: one cannot be read or written.
    """
    contents = {} if truth is None else {"truth": truth.encode("utf-8")}
    for key, data in contents.items():  # earlier versions wrote it in the end
        write_atomically(directory.path / FILES[key], data)
    for key in ("graph", "truth", "recipe"):
        path = directory.path / FILES[key]
        with writing(path):
            if path.exists():
                contents[key] = path.read_bytes()
    return contents


def make_checkpointer(
    directory: RunDirectory, engine: Engine, recorder: Recorder, recipe: Recipe, every_s: float
) -> Checkpoints | None:
    """The checkpointer of a run; None if no checkpoints are made, or nothing could go on from them."""
    if every_s <= 0 or recipe.origin.only_once is not None or opaque_agents(engine):
        return None
    return Checkpoints(directory, recorder, recipe.sha256, every_s)


def opaque_agents(engine: Engine) -> tuple[str, ...]:
    """Agents that keep something which cannot be stored."""
    return tuple(agent for compiled in engine.plates.values() for agent in sorted(compiled.opaque))
