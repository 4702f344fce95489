"""An earlier run, read back: `open_run(folder)` gives its measurements, events and tables.

The page of a run, made from its directory: for `report`, and for a notebook.

The pictures that a run was tracked in, read again: from its source, or from the video that it wrote.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayesnet_track.graph.settings.queries import query_columns
from bayesnet_track.graph.spec import AgentNode, GraphSpec
from bayesnet_track.graph.text.load import read_graph
from bayesnet_track.journal.blocks import Blocks
from bayesnet_track.journal.codec import JournalError
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.lives import Returned, TargetStarted
from bayesnet_track.journal.events.runs import RunStarted
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.reader import Measurements, Notice, read_events, read_seconds
from bayesnet_track.journal.text.wording import plural
from bayesnet_track.numerics.arrays import Image
from bayesnet_track.observation.planes import Frame
from bayesnet_track.runtime.recording.interchange import (
    AGENT_COLUMNS,
    TRACK_COLUMNS,
    Detections,
    Row,
    agent_rows,
    columns,
    track_rows,
)
from bayesnet_track.runtime.recording.rundir import RunDirectory, RunDirectoryError
from bayesnet_track.sources.paths import SourceError
from bayesnet_track.view.notebook import Page, run_html
from bayesnet_track.view.run_page import LARGEST
from bayesnet_track.view.timeline import draw_timeline

if TYPE_CHECKING:
    from bayesnet_track.graph.checked import CheckedGraph
    from bayesnet_track.runtime.results import FrameSource

SCENE = "scene:"


@dataclass(frozen=True, eq=False)
class RunPictures:
    """Pictures of a run.

    Attributes:
        views: frame, and camera -> (H, W, 3) uint8 BGR, in order; of a damaged source as far as it can be
            read. The only camera is called "".
        annotated: whether what was believed is drawn into them.
        first: name of the first camera.
    """

    views: Iterator[tuple[int, Mapping[str, Image]]]
    annotated: bool = False
    first: str = ""

    @property
    def images(self) -> Iterator[tuple[int, Image]]:
        """Frame and image of the first camera, in order."""
        return ((frame, views[self.first]) for frame, views in self.views if self.first in views)


@contextmanager
def pictures_of(
    directory: RunDirectory, header: RunStarted, first: int, final: int
) -> Iterator[tuple[RunPictures | None, str]]:
    """The pictures of frames `first` to `final`, with why they are not those of the source, or not there.

    The source is opened as it was for the run, but never over the network; where it is gone, or its pictures
    have another size now, the run's own annotated video takes its place.
    """
    reasons = []
    for open_one in (_source, _video):
        try:
            source = open_one(directory, header)
        except (SourceError, OSError, ValueError) as error:
            reasons.append(str(error))
            continue
        try:
            annotated = open_one is _video
            size = header.width, header.height
            sizes = (size, _video_size(directory, size)) if annotated else (size,)
            if (source.width, source.height) in sizes:
                # The video has the frames that were tracked, one after the other.
                place = (first, _stride(directory)) if annotated else (0, 1)
                main = next(iter(getattr(source, "sources", {})), "")
                yield RunPictures(_between(source, first, final, place, size), annotated, main), ""
                return
            was = f"{header.width}x{header.height}"
            reasons.append(f"{source.description} is {source.width}x{source.height} px now, and was {was}")
        finally:
            close_source = getattr(source, "close", None)
            if close_source is not None:
                close_source()
    yield None, "; ".join(reasons)


def _between(
    source: FrameSource, first: int, final: int, place: tuple[int, int], size: tuple[int, int]
) -> Iterator[tuple[int, Mapping[str, Image]]]:
    """The images of frames `first` to `final`; `place`: number of the source's first one, and the step.

    The only camera's have the `size` of the source, in which boxes are given.
    """
    import cv2

    for item in source:
        index = place[0] + place[1] * item.index if isinstance(item, Frame) else -1
        if not isinstance(item, Frame) or index < first:
            continue
        if index > final:
            return
        if item.cameras is not None:
            yield index, {camera: image.image for camera, image in item.cameras.items() if image.is_readable}
        elif item.image.shape[1::-1] == size:
            yield index, {"": item.image}
        else:
            yield index, {"": np.asarray(cv2.resize(item.image, size), dtype=np.uint8)}


def _video_size(directory: RunDirectory, size: tuple[int, int]) -> tuple[int, int]:
    """The size of the annotated video of a run whose source has frames of `size`."""
    from bayesnet_track.runtime.checkpoints.recipe import Recipe
    from bayesnet_track.runtime.recording.videowriter import LONGEST_SIDE, video_size

    side = Recipe.read(directory).video_side if directory.recipe.is_file() else None
    return video_size(*size, side or LONGEST_SIDE)


def _stride(directory: RunDirectory) -> int:
    from bayesnet_track.runtime.checkpoints.recipe import Recipe

    return Recipe.read(directory).origin.stride if directory.recipe.is_file() else 1


def _source(directory: RunDirectory, header: RunStarted) -> FrameSource:
    """The run's source: as its recipe says, or, of a run without one, as its journal names it."""
    from bayesnet_track.runtime.checkpoints.recipe import Recipe
    from bayesnet_track.sources.scenes import make_scene
    from bayesnet_track.sources.scenes.library import SceneSource
    from bayesnet_track.sources.several import reopen
    from bayesnet_track.sources.sources import open_source

    if directory.recipe.is_file():
        origin = Recipe.read(directory).origin
        if origin.only_once is not None:
            raise SourceError(header.source, origin.only_once, "a source of files", "keep the video")
        return reopen(replace(origin, allow_network=False))
    if header.source.startswith(SCENE):
        return SceneSource(make_scene(header.source[len(SCENE) :], seed=header.seed), header.source)
    if header.source.isascii() and header.source.isdigit():
        raise SourceError(header.source, "it was a camera", "a source of files", "keep the video")
    return open_source(header.source)


def _video(directory: RunDirectory, header: RunStarted) -> FrameSource:
    from bayesnet_track.sources.sources import open_source

    video = directory.mp4 if directory.mp4.is_file() else directory.video
    if not video.is_file():
        raise FileNotFoundError(f"and the run wrote no {video.name}")
    return open_source(str(video))


Data = tuple[dict[str, Any], dict[str, Any]]
"""What is embedded in a page: its header, and its columns."""


def page_data(
    directory: RunDirectory,
    events: Sequence[Event],
    metrics: Sequence[FrameMetrics],
    truth: NDArray[Any] | None,
    notice: Notice,
) -> Data:
    """Data that a page shows of a run, but for its pictures; `notice` is told of what cannot be shown.

    Raises:
        JournalError: a line of timings.jsonl is malformed.
    """
    from bayesnet_track.view.page_data import read_timings, run_data

    timings = read_timings(directory.timings)
    return run_data(events, metrics, timings, _graph(directory, notice), truth, directory.path.resolve().name)


def page_in_one(
    data: Data, images: RunPictures | None, missing: str, expected: int, largest: int = LARGEST
) -> Iterator[str]:
    """The text of a page in one file, in pieces.

    Args:
        data: from `page_data`.
        images: its pictures, if there are any; read before the first piece is given.
        missing: why there are none.
        expected: how many there may be.
        largest: bytes of the page, unless what was measured alone takes more.
    """
    from bayesnet_track.view.run_page import Pictures, gather, one_file, room_for_pictures

    pictures = {"": Pictures((), ())}
    if images is not None:
        event_frames = {row["frame"] for row in data[0]["events"] if row["sort"] != "note"}
        pictures = gather(
            images.views, expected, event_frames, room_for_pictures(*data, largest), images.annotated
        )
        missing = missing if pictures else "the sources of the run have none"
    return one_file(*data, pictures, missing)


def page_html(
    directory: RunDirectory,
    events: Sequence[Event],
    metrics: Sequence[FrameMetrics],
    truth: NDArray[Any] | None,
    largest: int,
) -> str:
    """The page of a run as a text of at most `largest` bytes; see `page_in_one`.

    Raises:
        ValueError: it does not begin with `run_started`.
    """

    if not events or not isinstance(events[0], RunStarted):
        raise ValueError(f"{directory.journal}: it does not begin with run_started; there is nothing to show")
    data = page_data(directory, events, metrics, truth, lambda text: None)
    frames = Blocks(metrics, ()).frames().tolist()
    if not frames:
        return "".join(page_in_one(data, None, "no frame was tracked", 0, largest))
    with pictures_of(directory, events[0], min(frames), max(frames)) as (images, missing):
        return "".join(page_in_one(data, images, missing, len(frames), largest))


def _graph(directory: RunDirectory, notice: Notice) -> CheckedGraph | None:
    """The run's graph, whose cues are not run; None, with a notice, where it cannot be read."""
    from bayesnet_track.graph.checks.cameras import AnyCalibration
    from bayesnet_track.graph.checks.run import check, cues_named
    from bayesnet_track.graph.text.load import read_graph
    from bayesnet_track.graph.text.messages import GraphError
    from bayesnet_track.observation.cue import stand_ins
    from bayesnet_track.observation.image_files import AnyMask
    from bayesnet_track.runtime.checkpoints.recipe import Recipe

    try:
        spec, positions = read_graph(directory.graph)
        cameras: Mapping[str, Any] = AnyCalibration()
        if len(spec.cameras) > 1 and directory.recipe.is_file():
            unknown = {source.key: cameras[source.key] for source in spec.cameras.values()}
            cameras = unknown | Recipe.read(directory).read_calibrations(spec)
        return check(spec, positions, stand_ins(cues_named(spec)), AnyMask(), cameras)
    except (GraphError, OSError) as error:
        notice(f"{directory.graph}: the page shows no net: {error}")
        return None


MOST_KEPT = 10_000
"""Lines of measurements that are kept in memory, at some 10 kB each; those of a longer run are read anew."""


def open_run(path: str | PathLike[str], notice: Notice | None = None) -> Run:
    """The run in a run directory, finished or killed.

    `notice` is told of a torn last line, which is dropped.

    Raises:
        RunDirectoryError: it is no run directory, or a file is missing from it.
        JournalError: a file in it is damaged. Records of a long run are checked when they are read.

    ::

        run = open_run("runs/mine")
        run.metrics[-1].xywh, run.events[0], pandas.DataFrame(run.to_dict())
    """
    directory = RunDirectory.open(Path(path))
    try:
        events = tuple(read_events(directory.journal, notice))
        run = Run(directory, events, (), directory.graph.read_text(encoding="utf-8"))
        measured = Measurements(directory.frames, notice, run.kinds)
        return replace(run, metrics=tuple(measured) if len(measured) <= MOST_KEPT else measured)
    except FileNotFoundError as error:
        raise RunDirectoryError(f"{error.filename}: missing from the run directory") from error
    except UnicodeDecodeError as error:
        raise JournalError(f"{directory.graph}: not a text: {error}") from error


@dataclass(frozen=True, eq=False, repr=False)
class Run:
    """A run as its directory holds it. Made by `open_run`.

    Attributes:
        directory: where its files are.
        events: the lines of journal.jsonl, in order.
        metrics: what was measured, in order: one per live target and frame. Of a long run a line is read from
            the file when it is asked for.
        graph_text: the canonical text of its graph.
    """

    directory: RunDirectory
    events: tuple[Event, ...]
    metrics: Sequence[FrameMetrics]
    graph_text: str

    def __repr__(self) -> str:
        frames = len(Blocks(self.metrics, ()).frames())
        return f"Run({self.name!r}: {plural(frames, 'frame')}, {plural(len(self.targets), 'target')})"

    @property
    def name(self) -> str:
        """The folder as it was given."""
        return str(self.directory.path)

    @cached_property
    def started(self) -> RunStarted:
        """The journal's first line, with source, seed, size and versions.

        Raises:
            JournalError: it is something else.
        """
        first = next(iter(self.events), None)
        if not isinstance(first, RunStarted):
            raise JournalError(f"{self.directory.journal}:1: a journal begins with run_started")
        return first

    @cached_property
    def spec(self) -> GraphSpec:
        """The graph that it was run with.

        Raises:
            GraphError: graph.yaml is no graph.
        """
        return read_graph(self.graph_text, str(self.directory.graph))[0]

    @cached_property
    def kinds(self) -> Mapping[str, str]:
        """Target id -> name of its plate, in the order in which targets appear."""
        start_types = TargetStarted | Returned
        return {event.target: event.template for event in self.events if isinstance(event, start_types)}

    @cached_property
    def costs_ms(self) -> Mapping[tuple[str, str], float]:
        """(plate, agent) -> declared cost, where the journal has one for its cue."""
        costs = self.started.costs_ms
        return {
            (plate, name): costs[node.agent.cue]
            for plate, target in self.spec.targets.items()
            for name, node in target.nodes.items()
            if isinstance(node, AgentNode) and node.agent.cue in costs
        }

    @cached_property
    def seconds(self) -> Mapping[int, float]:
        """Frame -> seconds that its step took, by a clock; empty when the run has no timings.

        Raises:
            JournalError: a line of timings.jsonl is malformed.
        """
        return dict(read_seconds(self.directory.timings))

    @property
    def targets(self) -> tuple[str, ...]:
        """Ids of all targets, in the order in which they appear."""
        return tuple(self.kinds)

    def timeline(self, target: str | None = None) -> str:
        """UD with its thresholds and the active agents of one target (the first when None), as SVG.

        Raises:
            ValueError: no such target.
        """
        return draw_timeline(self.events, self.metrics, target)

    def _repr_html_(self) -> str:
        """For notebooks: figures, timelines and decisions."""
        return run_html(self)

    def page(self, truth: ArrayLike | None = None, height: int = 900, largest: int = 2_000_000) -> Page:
        """The page that `report` writes, for a notebook: frames, belief, net, and the reason for each switch.

        Args:
            truth: ground truth to show, a corner box (N, 4) a frame, as `read_truth` gives it.
            height: of the frame in which the notebook shows it, px.
            largest: bytes of the page, which the notebook keeps: fewer and smaller pictures of the video, the
                smaller it is. What was measured is always there, and pictures take half a million bytes.
        """
        boxes = None if truth is None else np.asarray(truth, dtype=np.float64)
        html = page_html(self.directory, self.events, self.metrics, boxes, largest)
        return Page(html, height, self.name)

    @cached_property
    def columns(self) -> tuple[str, ...]:
        """`tables.TRACK_COLUMNS`, then velocities, own fields, categories and queries, as in its table."""
        measured = dict.fromkeys(name for line in self.metrics for name in (*line.state, *line.category))
        fields = (name for name in measured if name not in TRACK_COLUMNS)
        asks = "\nqueries:" in self.graph_text
        return (*TRACK_COLUMNS, *fields, *(query_columns(self.spec.queries) if asks else ()))

    def to_rows(self) -> list[Row]:
        """One row per live target and frame, with the columns of `columns`."""
        return track_rows(self.metrics, self.kinds, self.columns[len(TRACK_COLUMNS) :])

    def to_dict(self) -> dict[str, list[Any]]:
        """The same as columns: ``pandas.DataFrame(run.to_dict())``."""
        return columns(self.to_rows(), self.columns)

    def arrays(self, *names: str) -> dict[str, NDArray[Any]]:
        """Some columns of all measurements; of a long run far faster than line by line.

        Args:
            names: columns of ``frames.npy.gz``: ``score``, ``box``, ``status``, ``state/vx``, ``kl/color``, …

        Returns:
            ``frame``, ``target`` and each name: see `Blocks.arrays`. A row per line of `metrics`, in order.

        Raises:
            ValueError: no frame has such a column.
            JournalError: a record is damaged.
        """
        return Blocks(Measurements(self.directory.frames, None, self.kinds), names).arrays()

    def agents_to_dict(self) -> dict[str, list[Any]]:
        """One row per active agent, target and frame, as columns: its KL, contribution, UD, strength."""
        return columns(agent_rows(self.metrics), AGENT_COLUMNS)

    def detections(self, frame: int | None = None, lost: bool = False) -> Detections:
        """The boxes of a frame, or of all, in the shape of supervision's; `lost` for lost targets, too."""
        lines = (line for line in self.metrics if frame is None or line.frame == frame)
        return Detections.of(lines, self.kinds, tuple(self.spec.targets), lost)
