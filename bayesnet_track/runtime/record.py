"""Write a run down: journal, measurements, tracks, timings and the annotated video, frame by frame."""

from __future__ import annotations

import json
from contextlib import ExitStack
from types import TracebackType
from typing import Self

from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.journal.events import Event
from bayesnet_track.journal.inputs import Input
from bayesnet_track.journal.writer import JournalWriter, LineFile
from bayesnet_track.runtime.run import Result
from bayesnet_track.runtime.rundir import RunDirectory
from bayesnet_track.runtime.starts import has_births
from bayesnet_track.runtime.tracks import CsvWriter, MotWriter
from bayesnet_track.runtime.videowriter import VideoWriter


class Recorder:
    """Keeps the files of a run directory open and appends to them; a sink of `run`.

    Everything but timings.jsonl and the video is a function of graph, source, starts, seed and inputs.jsonl,
    which is there only when something came from outside.

    Args:
        directory: where the files go.
        graph: what is tracked with; its canonical text is stored.
        frame_interval_s: nominal seconds between frames, for the video.
        with_video: write the annotated video.

    Raises:
        OutputError: a file cannot be created or written.
    """

    def __init__(
        self, directory: RunDirectory, graph: CheckedGraph, frame_interval_s: float, with_video: bool = False
    ) -> None:
        self._directory, self._interval, self._with_video = directory, frame_interval_s, with_video
        with ExitStack() as files:
            # The journal comes first: what holds one counts as a run, which may be overwritten.
            self._journal = files.enter_context(JournalWriter(directory.journal))
            directory.write_text(directory.graph, graph.text)
            self._frames = files.enter_context(JournalWriter(directory.frames))
            self._mot = files.enter_context(MotWriter(directory.mot, lost=not has_births(graph)))
            self._csv = files.enter_context(CsvWriter(directory.csv))
            self._timings = files.enter_context(LineFile(directory.timings))
            self._files = files.pop_all()
        self._video: VideoWriter | None = None
        self._inputs: JournalWriter | None = None

    def event(self, event: Event) -> None:
        """Append to the journal."""
        self._journal.write(event)
        self._journal.flush()

    def frame(self, result: Result) -> None:
        """Append what one frame gave to every file, and let the system have it."""
        if result.outside:
            self._take(result.outside)
        for metrics in result.targets:
            self._frames.write(metrics)
            self._mot.write(metrics)
            self._csv.write(metrics)
        spent = {name: round(seconds, 7) for name, seconds in result.seconds.items()}
        line = {"frame": result.frame.index, "seconds": round(result.total_seconds, 7), "parts": spent}
        self._timings.append(json.dumps(line))
        # A killed run has a time for every frame it measured, as scores want it.
        for file in (self._timings, self._frames, self._mot, self._csv):
            file.flush()
        if self._with_video:
            self._draw(result)

    def _take(self, outside: tuple[Input, ...]) -> None:
        if self._inputs is None:
            self._inputs = self._files.enter_context(JournalWriter(self._directory.inputs))
        for one in outside:
            self._inputs.write(one)
        self._inputs.flush()

    def _draw(self, result: Result) -> None:
        from bayesnet_track.view.overlay import draw_overlay

        if self._video is None:
            height, width = result.frame.image.shape[:2]
            self._video = self._files.enter_context(
                VideoWriter(self._directory.video, width, height, self._interval)
            )
        image = result.frame.image
        for metrics in result.targets:
            image = draw_overlay(image, metrics)
        self._video.write(image)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._files.__exit__(kind, error, trace)
