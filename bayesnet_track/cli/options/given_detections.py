"""Say which detections of a file a run will not use, before it begins: nothing is left out without a word."""

from __future__ import annotations

import argparse
import sys
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
    from bayesnet_track.runtime.preparation import resizing_of
    from bayesnet_track.runtime.unused_detections import explain_unused

    resizing = resizing_of(source, getattr(options, "max_side", None))
    ends = [end for end in (options.end, getattr(source, "declared_frames", None)) if end is not None]
    frames = range(options.start or 0, min(ends, default=sys.maxsize), options.stride)
    for reason in explain_unused(graph, resizing.detector(detector).found, resizing.tracked, frames):
        complain(f"{options.detections}: {reason}")
