"""An earlier run, read back: `open_run(folder)` gives its measurements, events and tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bayesnet_track.graph.settings.queries import query_columns
from bayesnet_track.graph.spec import AgentNode, GraphSpec
from bayesnet_track.graph.text.load import read_graph
from bayesnet_track.journal.blocks import Blocks, targets_of
from bayesnet_track.journal.codec import JournalError
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.lives import Returned, TargetStarted
from bayesnet_track.journal.events.runs import RunStarted
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.reader import Measurements, Notice, read_events, read_seconds
from bayesnet_track.journal.text.wording import plural
from bayesnet_track.runtime.recording.interchange import Detections
from bayesnet_track.runtime.recording.report_page import page_html
from bayesnet_track.runtime.recording.rundir import RunDirectory, RunDirectoryError
from bayesnet_track.runtime.recording.tables import (
    AGENT_COLUMNS,
    TRACK_COLUMNS,
    Row,
    agent_rows,
    columns,
    track_rows,
)
from bayesnet_track.view.notebook import Page, run_html
from bayesnet_track.view.timeline import draw_timeline

MOST_KEPT = 10_000
"""Lines of measurements that are kept in memory, at some 10 kB each; those of a longer run are read anew."""


def open_run(path: str | PathLike[str], notice: Notice | None = None) -> Run:
    """The run in a run directory, finished or killed.

    `notice` is told of a torn last line, which is dropped.

    Raises:
        RunDirectoryError: it is no run directory, or a file is missing from it.
        JournalError: a file in it is damaged.

    ::

        run = open_run("runs/mine")
        run.metrics[-1].xywh, run.events[0], pandas.DataFrame(run.to_dict())
    """
    directory = RunDirectory.open(Path(path))
    try:
        events = tuple(read_events(directory.journal, notice))
        measured = Measurements(directory.frames, notice)
        targets = targets_of(measured)
        metrics = tuple(measured) if len(measured) <= MOST_KEPT else measured
        text = directory.graph.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise RunDirectoryError(f"{error.filename}: missing from the run directory") from error
    except UnicodeDecodeError as error:
        raise JournalError(f"{directory.graph}: not a text: {error}") from error
    run = Run(directory, events, metrics, text)
    unknown = {*targets} - run.kinds.keys()
    if unknown:
        raise JournalError(
            f"{directory.frames}: target {min(unknown)!r} never starts in {directory.journal.name}"
        )
    return run


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
        started = TargetStarted | Returned
        return {event.target: event.template for event in self.events if isinstance(event, started)}

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

    def agents_to_dict(self) -> dict[str, list[Any]]:
        """One row per active agent, target and frame, as columns: its KL, contribution, UD, strength."""
        return columns(agent_rows(self.metrics), AGENT_COLUMNS)

    def detections(self, frame: int | None = None, lost: bool = False) -> Detections:
        """The boxes of a frame, or of all, in the shape of supervision's; `lost` for lost targets, too."""
        chosen = (line for line in self.metrics if frame is None or line.frame == frame)
        return Detections.of(chosen, self.kinds, tuple(self.spec.targets), lost)
