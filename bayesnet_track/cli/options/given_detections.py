"""Say which detections of a file a run will not use, before it begins: nothing is left out without a word."""

from __future__ import annotations

import argparse
from math import gcd
from typing import TYPE_CHECKING

from bayesnet_track.cli.commands.answer import complain

if TYPE_CHECKING:
    from bayesnet_track.graph.checked import CheckedGraph
    from bayesnet_track.runtime.results import FrameSource
    from bayesnet_track.sources.detection_files import FileDetector


def say_unused(
    options: argparse.Namespace, graph: CheckedGraph, source: FrameSource, detector: FileDetector
) -> None:
    """A line for each reason to think that file, video and graph do not go together."""
    from bayesnet_track.graph.checks.cues import plugin_parameters
    from bayesnet_track.observation.detector import GIVEN, GivenParameters
    from bayesnet_track.runtime.preparation import resizing_of
    from bayesnet_track.vision.detectors.left_out import left_out

    resizing = resizing_of(source, getattr(options, "max_side", None))
    start, stride = options.start or 0, options.stride
    ends = [end for end in (options.end, getattr(source, "declared_frames", None)) if end is not None]
    end = min(ends, default=None)
    read = {
        index: found
        for index, found in resizing.detector(detector).found.items()
        if index >= start and (end is None or index < end) and (index - start) % stride == 0
    }
    if detector.found and not read:
        low, high = min(detector.found), max(detector.found)
        last = "" if end is None else f" to {end - 1}"
        complain(
            f"{options.detections}: no detection is of a frame that is read: they are of the frames {low} to "
            f"{high}, and {start}{last} are read (both counted from 0; a MOT file counts from 1)"
        )
    first = min(read, default=0)
    step = gcd(*(index - first for index in read))
    if step > stride:
        begin = f"--start {first} " if first != start else ""
        complain(
            f"{options.detections}: only one frame in {step} has detections, and in the others nobody is "
            f"detected: {begin}--stride {step} reads only those that have some"
        )
    total = sum(map(len, read.values()))
    for plate in graph.targets.values():
        birth = plate.spec.birth
        if birth is None or birth.detector.detector != GIVEN:
            continue
        parameters = plugin_parameters(birth.detector, GivenParameters)
        unused = left_out(read, parameters, resizing.tracked, birth.labels)
        if unused:
            reasons = "; ".join(f"{count} {reason}" for reason, count in unused.items())
            complain(
                f"{options.detections}: {sum(unused.values())} of {total} detections are not used: {reasons}"
            )
