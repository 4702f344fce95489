"""Which detections of a file a run will not use, and why: nothing is left out without a word."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from math import gcd
from pathlib import Path
from sys import maxsize

from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.checks.cues import plugin_parameters
from bayesnet_track.observation.detector import GIVEN, Detections, GivenParameters
from bayesnet_track.runtime.resizing import Resizing
from bayesnet_track.sources.detection_files import file_detector
from bayesnet_track.vision.detectors.left_out import left_out


def warn_unused(graph: CheckedGraph, detections: Path, resizing: Resizing, frames: range) -> None:
    """A warning, at the caller of `track`, for each reason that `explain_unused` gives."""
    found = resizing.detector(file_detector(detections)).found
    for reason in explain_unused(graph, found, resizing.tracked, frames):
        warnings.warn(f"{detections}: {reason}", stacklevel=4)


def explain_unused(
    graph: CheckedGraph,
    found: Mapping[int, Detections],
    size: tuple[int, int],
    frames: range,
) -> Iterator[str]:
    """A sentence for each reason to think that detections, video and graph do not go together.

    Args:
        graph: the graph.
        found: index of a frame -> its detections, in pixels of the frames that are tracked.
        size: width and height of these frames, px.
        frames: indices of the frames that are read; up to `sys.maxsize` where their number is not known.
    """
    read = {index: one for index, one in found.items() if index in frames}
    if found and not read:
        last = " and later ones" if frames.stop == maxsize else f" to {frames.stop - 1}"
        yield (
            f"no detection is of a frame that is read: they are of the frames {min(found)} to {max(found)}, "
            f"and {frames.start}{last} are read (both counted from 0; a MOT file counts from 1)"
        )
    first = min(read, default=0)
    step = gcd(*(index - first for index in read))
    if step > frames.step:
        begin = f"--start {first} " if first != frames.start else ""
        yield (
            f"only one frame in {step} has detections, and in the others nobody is detected: "
            f"{begin}--stride {step} reads only those that have some"
        )
    total = sum(map(len, read.values()))
    for plate in graph.targets.values():
        birth = plate.spec.birth
        if birth is None or birth.detector.detector != GIVEN:
            continue
        unused = left_out(read, plugin_parameters(birth.detector, GivenParameters), size, birth.labels)
        if unused:
            reasons = "; ".join(f"{count} {reason}" for reason, count in unused.items())
            yield f"{sum(unused.values())} of {total} detections are not used: {reasons}"
