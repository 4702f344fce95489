"""Write a run down: journal, measurements, tracks, timings and the annotated video, frame by frame.

Where targets are expected, as lines of ``forecasts.jsonl``: one per frame, target and frames ahead.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import Future
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from bayesnet_track.engine.compiled import Engine
from bayesnet_track.engine.queries import forecast
from bayesnet_track.engine.starts import has_births
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.journal import disk
from bayesnet_track.journal.events.event import Event, Input
from bayesnet_track.journal.frame_columns import CAMERA_NUMBERS, lines_of
from bayesnet_track.journal.frame_file import FrameFile, FrameWriter
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.writer import (
    JournalWriter,
    LineFile,
    OutputError,
    Position,
    read_position,
    writing,
)
from bayesnet_track.numerics.arrays import Image
from bayesnet_track.observation.planes import Frame
from bayesnet_track.runtime.recording.beliefs import BeliefWriter
from bayesnet_track.runtime.recording.rundir import FILES, RunDirectory
from bayesnet_track.runtime.recording.tracks import (
    FEW,
    MOST_BOXES,
    NO_IDS,
    CameraWriter,
    CsvWriter,
    MotWriter,
    QueryWriter,
    crowd_boxes,
    has_csv,
    has_only_points,
    measured,
    number_columns,
    views_of_cameras,
)
from bayesnet_track.runtime.recording.videowriter import LONGEST_SIDE, Background, VideoWriter
from bayesnet_track.runtime.resizing import Resizing
from bayesnet_track.runtime.results import Result
from bayesnet_track.sources.entrances.notices import notice

DIGITS = 3


@dataclass(frozen=True, eq=False)
class Forecaster:
    """Looks `horizon` frames ahead with an engine."""

    engine: Engine
    horizon: int
    resizing: Resizing


class ForecastWriter(LineFile):
    """``forecasts.jsonl``: a new file, or one that is continued."""

    def __init__(self, path: Path, forecaster: Forecaster, after: int | None = None) -> None:
        super().__init__(path, after)
        self._forecaster = forecaster

    def write(self, result: Result) -> None:
        """Add what is expected of every target after one frame to the next flush."""
        forecaster, resizing = self._forecaster, self._forecaster.resizing
        for line in result.targets:
            if line.target not in result.states:
                continue
            start = result.states[line.target], result.births[line.target], line
            for raw in forecast(forecaster.engine, *start, forecaster.horizon, resizing.tracked):
                expected = resizing.estimate(raw)
                self.append(
                    json.dumps(
                        {
                            "frame": line.frame,
                            "target": line.target,
                            "ahead": expected.ahead,
                            "box": _short(expected.centre_box),
                            "sd": _short(expected.sd),
                            "region50": _short(expected.region50),
                            "region90": _short(expected.region90),
                            **({"queries": _rounded(expected.queries)} if expected.queries else {}),
                        }
                    )
                )


def _short(values: tuple[float, ...]) -> list[float]:
    return [round(value, DIGITS) for value in values]


def _rounded(numbers: Mapping[str, float]) -> dict[str, float]:
    return {name: float(f"{number:.6g}") for name, number in numbers.items()}


MOST_WAITING = 4
"""Frames that wait for the encoder; with more, tracking waits."""


@dataclass(frozen=True)
class FilePositions:
    """Positions up to which a run is written down.

    Attributes:
        positions: file, by its key in `rundir.FILES` -> how far.
        ids: target -> its number in tracks.txt.
    """

    positions: Mapping[str, Position]
    ids: Mapping[str, int] = field(default_factory=dict)


class Recorder:
    """Keeps the files of a run directory open and appends to them; a sink of `run`.

    Everything but timings.jsonl and the video is a function of graph, source, starts, seed and inputs.jsonl,
    which is there only when something came from outside.

    Args:
        directory: where the files go.
        graph: what is tracked with.
        frame_interval_s: nominal seconds between frames, for the video.
        optional: which of `video` or `mp4` (annotated), `beliefs` (for smoothing), `hypotheses` (of all
            targets of every frame) and `csv` (see `has_csv`) to write as well.
        after: how far the files of a run are written that goes on here; what follows is cut off. The video
            begins anew: see `redraw`.
        before_first: called before the first frame is written; until then no file is opened, and events wait.

    Attributes:
        longest_side: px of the longer side of the video; larger frames are scaled down for it.

    Raises:
        OutputError: a file cannot be created or written.
    """

    def __init__(
        self,
        directory: RunDirectory,
        graph: CheckedGraph,
        frame_interval_s: float,
        optional: Collection[str] = (),
        written: FilePositions | None = None,
        before_first: Callable[[], None] | None = None,
    ) -> None:
        self._directory, self._interval, self._optional = directory, frame_interval_s, optional
        self._asked = graph.spec.queries
        self._has_ids, self._hypotheses = not has_births(graph), "hypotheses" in optional
        self._points = has_only_points(graph.spec)
        self._has_csv = "csv" in optional or has_csv(graph.spec)
        self._numbers = number_columns(graph.spec)
        self._views = views_of_cameras(graph)
        self._before_first, self._waiting = before_first, list[Event]()
        self._files = ExitStack()
        self.longest_side = LONGEST_SIDE
        self._video: VideoWriter | None = None
        self._drawing, self._drawn = Background("video", MOST_WAITING), deque[Future[None]]()
        self._forecaster: Forecaster | None = None
        self._forecasts: ForecastWriter | None = None
        self._kind = "mp4" if "mp4" in optional else "video"
        if before_first is None:
            self._open(written)

    def _open(self, written: FilePositions | None = None) -> None:
        directory = self._directory
        sizes = {} if written is None else {name: place.size for name, place in written.positions.items()}
        ids = NO_IDS if written is None else written.ids
        with ExitStack() as files:
            self._journal = files.enter_context(JournalWriter(directory.journal, sizes.get("journal")))
            self._frames = files.enter_context(FrameWriter(directory.frames, sizes.get("frames")))
            self._mot: MotWriter | None = None
            if written is None or "mot" in sizes:
                mot = MotWriter(directory.mot, self._has_ids, sizes.get("mot"), ids, self._points)
                self._mot = files.enter_context(mot)
                self._boxes = 0 if written is None else crowd_boxes(directory.frames)
            self._csv: CsvWriter | None = None
            if self._has_csv or "csv" in sizes:
                csv = CsvWriter(directory.csv, sizes.get("csv"), self._numbers, self._points)
                self._csv = files.enter_context(csv)
            self._cameras: CameraWriter | None = None
            if self._views:
                writer = CameraWriter(directory.cameras, self._views, sizes.get("cameras"))
                self._cameras = files.enter_context(writer)
            self._timings = files.enter_context(LineFile(directory.timings, sizes.get("timings")))
            self._queries: QueryWriter | None = None
            if self._asked:
                self._queries = files.enter_context(QueryWriter(directory.queries, sizes.get("queries")))
            self._beliefs: BeliefWriter | None = None
            if "beliefs" in self._optional:
                self._beliefs = files.enter_context(BeliefWriter(directory.beliefs, sizes.get("beliefs")))
            if self._forecaster is not None:
                self._forecasts = files.enter_context(ForecastWriter(directory.forecasts, self._forecaster))
            self._inputs: JournalWriter | None = None
            if "inputs" in sizes:
                self._inputs = files.enter_context(JournalWriter(directory.inputs, sizes["inputs"]))
            self._files = files.pop_all()
        self._before_first = None

    def look_ahead(self, forecaster: Forecaster, written: FilePositions | None = None) -> None:
        """Also write where targets are expected, from the first frame on or after what is `written`."""
        self._forecaster = forecaster
        if self._before_first is None:
            place = None if written is None else written.positions.get("forecasts")
            writer = ForecastWriter(
                self._directory.forecasts, forecaster, None if place is None else place.size
            )
            self._forecasts = self._files.enter_context(writer)

    @property
    def written(self) -> FilePositions:
        """Positions up to which the files are written, but for the video."""
        return FilePositions(
            {name: file.position for name, file in self._lines().items()},
            {} if self._mot is None else dict(self._mot.ids),
        )

    def sync(self) -> None:
        """Let the disk have all that is written, but for the video, and every file's name."""
        for file in self._lines().values():
            file.sync()
        with writing(self._directory.path):
            disk.sync_folder(self._directory.path)

    def finish(self) -> dict[str, Position]:
        """Close every file and wait until the disk has it; key in `rundir.FILES` -> how far it is written.

        Raises:
            OutputError: a file cannot be written.
        """
        self.sync()
        self._drawing.shutdown()
        self._check_drawn()
        written = dict(self.written.positions)
        for file in self._lines().values():
            file.check()
            if file.path.is_file() and _read(file.path) != file.position:
                raise OutputError(f"{file.path}: something else changed it while it was being written")
        if self._video is not None:
            self._video.finish()
            written[self._kind] = _read(self._video.path)
        self._files.close()
        return written

    def redraw(self, frames: Iterable[Frame], final: int) -> None:
        """Write the video of the frames up to number `final`, as the file of frames has them."""
        file = FrameFile(self._directory.frames)
        places = {place.frame: place for place in file.places}
        for frame in frames:
            has_lines = frame.index in places
            self._draw(frame, list(file.lines([places[frame.index]])) if has_lines else [])
            if frame.index >= final:
                break

    def _lines(self) -> dict[str, LineFile]:
        files: dict[str, LineFile] = {"journal": self._journal, "frames": self._frames}
        optional = {
            "mot": self._mot,
            "timings": self._timings,
            "csv": self._csv,
            "cameras": self._cameras,
            "queries": self._queries,
            "inputs": self._inputs,
            "beliefs": self._beliefs,
            "forecasts": self._forecasts,
        }
        return files | {name: file for name, file in optional.items() if file is not None}

    def event(self, event: Event) -> None:
        """Append to the journal."""
        if self._before_first is not None:
            self._waiting.append(event)
            return
        self._journal.write(event)
        self._journal.flush()

    def frame(self, result: Result) -> None:
        """Append what one frame gave to every file, and let the system have it."""
        if self._before_first is not None:
            self._before_first()
            self._open()
            for event in self._waiting:
                self.event(event)
        if result.external_inputs:
            self._take(result.external_inputs)
        if result.targets:
            columns, tracked = measured(result.targets, self._hypotheses)
            for camera, numbers in result.cameras.items():
                columns[f"cameras/{camera}"] = np.array([numbers[name] for name in CAMERA_NUMBERS], "<f4")
            self._frames.write_columns(columns)
            if self._mot is not None:
                self._mot.write(tracked)
            if self._csv is not None:
                self._csv.write(tracked)
            if self._cameras is not None:
                self._cameras.write(result.frame, tracked, result.kinds)
            if self._beliefs is not None:
                for target in tracked.targets:
                    if target in result.states:
                        messages = result.heard.get(target)
                        self._beliefs.write(result.frame.index, target, result.states[target], messages)
        if self._queries is not None:
            self._queries.write(result.frame, result.queries.values())
        if self._forecasts is not None:
            self._forecasts.write(result)
        spent = {name: round(seconds, 7) for name, seconds in result.seconds.items()}
        line = {"frame": result.frame.index, "seconds": round(result.total_seconds, 7), "parts": spent}
        self._timings.append(json.dumps(line))
        # A killed run has a time for every frame it measured, as scores want it: times come first.
        self._timings.flush()
        for file in self._lines().values():
            file.flush()
        self._count(len(result.targets))
        if self._kind in self._optional:
            # As the file has them, so that a run that goes on can draw the same again.
            self._draw(result.frame, list(lines_of(columns)) if result.targets else [])

    def _count(self, targets: int) -> None:
        """Leave ``tracks.txt`` out of a long run of a crowd.

        A run that goes on from before that needs no such file: there are records of `MOST_BOXES` then, which
        the disk has before the text is removed.
        """
        if self._mot is None or self._points or targets <= FEW:
            return
        self._boxes += targets
        if self._boxes - targets <= MOST_BOXES < self._boxes:
            self._frames.sync()
            self._mot.close()
            with writing(self._directory.mot):
                disk.unlink(self._directory.mot)
            self._mot = None
            notice(
                f"{self._directory.mot}: removed, since the run has more than {MOST_BOXES:,} boxes in frames "
                f"of more than {FEW} targets: they are in {self._directory.frames.name}, and "
                f"`bayesnet-track export {self._directory.path}` writes them as text, in the format mot"
            )

    def _take(self, external_inputs: tuple[Input, ...]) -> None:
        if self._inputs is None:
            self._inputs = self._files.enter_context(JournalWriter(self._directory.inputs))
        for entry in external_inputs:
            self._inputs.write(entry)
        self._inputs.flush()

    def _draw(self, frame: Frame, lines: Sequence[FrameMetrics]) -> None:
        """Have the frame drawn in the background; raises OutputError where an earlier one was not written."""
        self._check_drawn()
        if self._video is None:
            height, width = frame.image.shape[:2]
            self._video = self._files.enter_context(
                VideoWriter(
                    self._directory.path / FILES[self._kind],
                    width,
                    height,
                    self._interval,
                    self.longest_side,
                )
            )
        # A copy: a source of one's own may use its array again for the next frame.
        self._drawn.append(self._drawing.submit(_write_drawn, self._video, np.array(frame.image), lines))
        self._check_drawn()

    def _check_drawn(self) -> None:
        """Raise what went wrong with a frame of the video since then."""
        while self._drawn and self._drawn[0].done():
            self._drawn.popleft().result()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._drawing.shutdown()
        self._files.__exit__(kind, error, trace)
        if error is None or isinstance(error, GeneratorExit):
            self._check_drawn()


def _write_drawn(video: VideoWriter, image: Image, lines: Sequence[FrameMetrics]) -> None:
    from bayesnet_track.view.overlay import draw_targets

    video.write(draw_targets(image, lines))


def _read(path: Path) -> Position:
    with writing(path):
        return read_position(path)
