"""What the files of agents hold that a run does not use, such as readings of frames that are not read."""

from __future__ import annotations

from collections.abc import Iterator
from sys import maxsize

from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.checks.cues import cue_parameters
from bayesnet_track.runtime.results import FrameSource
from bayesnet_track.sources.entrances.notices import notice
from bayesnet_track.sources.frames import Source


def say_unused_by_cues(graph: CheckedGraph, source: FrameSource | None = None) -> None:
    """A notice for each thing that the agents' files hold and a run through `source` does not use."""
    for text in dict.fromkeys(_unused_by_cues(graph, frames_of(source))):
        notice(text)


def _unused_by_cues(graph: CheckedGraph, frames: range) -> Iterator[str]:
    for plate in graph.targets.values():
        for _, _, chosen in plate.spec.cue_choices():
            declaration = graph.declarations[chosen.cue]
            if declaration.unused is not None:
                yield from declaration.unused(cue_parameters(chosen, declaration), frames)


def frames_of(source: FrameSource | None) -> range:
    """Numbers of the frames that a source gives; up to `sys.maxsize` where it does not say."""
    if isinstance(source, Source):
        return source.numbers
    expected = None if source is None else source.expected_frames
    return range(maxsize if expected is None else expected)
