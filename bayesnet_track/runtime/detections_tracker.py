"""A tracker of detections with the `update` of Roboflow's `trackers`, for pipelines that already detect."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from os import PathLike
from typing import Any, ClassVar, Never

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.adapt.association import overlapping_pairs
from bayesnet_track.engine.choosing import choose_ahead
from bayesnet_track.engine.lifecycle.detecting import frames_between_looks
from bayesnet_track.engine.lines import Lines
from bayesnet_track.engine.starts import check_starts, start_targets
from bayesnet_track.engine.step import State, make_engine, step
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.text.wording import plural
from bayesnet_track.observation.cue import OWN_DETECTION
from bayesnet_track.observation.detector import GIVEN, Scan
from bayesnet_track.observation.planes import Frame
from bayesnet_track.runtime.arguments import say_unused_by_cues, whole_argument
from bayesnet_track.runtime.frame_clock import (
    Fed,
    FrameClock,
    Standing,
    image_users,
    refuse_unknown,
    rehearse_detections,
)
from bayesnet_track.runtime.given_scans import read_given, read_scans, sensor_columns
from bayesnet_track.runtime.lag import Arrival, LagWindow, SettledStep
from bayesnet_track.runtime.resizing import Resizing
from bayesnet_track.runtime.results import FrameKind
from bayesnet_track.runtime.several_cameras import USUAL_SIZE, CamerasFed, blank_image, check_cameras, mark
from bayesnet_track.runtime.storing import Storable, StoredError, Turns
from bayesnet_track.sources.entrances.levels import Levels, ValueRange, value_range_of
from bayesnet_track.sources.entrances.notices import notice

NO_TARGET = -1
"""The `tracker_id` of a detection that belongs to no target, or to one that is not confirmed yet."""

LEAST_OVERLAP = 0.3

ANEW = "call reset()"


class DetectionsTracker(Storable):
    """Give the detections of each frame the identities of targets, by a graph whose births use `detections`.

    Args:
        graph: name or path of the graph, or the graph itself.
        size: width and height of the frames in px, where `update` is given none; None for 1920 x 1080. Of a
            graph with several cameras for all of them, or camera -> its own; None for those of the
            calibrations.
        seed: seed of all randomness.
        fps: nominal frames a second: numbers per frame in the graph, such as noise and speeds, count for
            1 / fps s, whenever frames really come (`time_s`). None for 25.
        value_range: the values that become black and white in frames with more than 8 bits; see `Tracker`.
        lag_s: detections may come up to so many seconds late, in any order: those after them are then tracked
            anew. What can no longer change is told by `settled`, which should be called now and then.

    Raises:
        GraphError: every error of the graph.
        DetectorError: nothing is born from `detections` in it.
        ValueError: `size` is no size, `fps` no number of frames a second, `value_range` no range, or `lag_s`
            no time.

    Example::

        tracker = DetectionsTracker("kalman_detections", size=(640, 480))
        detections = tracker.update(detections)  # an object like supervision's Detections
        detections.tracker_id                    # (n,) int: the target of each box, -1 for none
    """

    _kind: ClassVar[str] = "DetectionsTracker"

    def __init__(
        self,
        graph: str | PathLike[str] | GraphSpec | CheckedGraph = "kalman_detections",
        size: tuple[int, int] | Mapping[str, tuple[int, int]] | None = None,
        seed: int = 0,
        fps: float | None = None,
        value_range: ValueRange | None = None,
        lag_s: float = 0.0,
    ) -> None:
        self._graph, self._seed = load_graph(graph), whole_argument("seed", seed, 0)
        say_unused_by_cues(self._graph)
        self._sizes = _checked_sizes(size)
        self._clock = FrameClock.of_rate(fps)
        self._turns = Turns(self._kind)
        self._levels = Levels("frame 0", value_range_of(value_range))
        self._window = LagWindow.opened(lag_s)
        self._renew_engine()
        self._users = image_users(self._engine)
        rehearse_detections(self._graph, self._seed, owners)
        self._now: Standing | None = None
        self._own = frozenset({*vars(self), "_own"})

    def reset(self) -> None:
        """Forget all targets: another video begins.

        Raises:
            RuntimeError: another thread is at work with this tracker.
        """
        with self._turns.take("reset"):
            self._now, self._levels = None, Levels("frame 0", self._levels.value_range)
            self._window = LagWindow.opened(self._lag_s)

    def _options(self) -> Mapping[str, Any]:
        if self._window is not None and self._window.steps:
            raise StoredError(
                f"this tracker cannot be stored while {plural(len(self._window.steps), 'step')} within its "
                f"lag of {self._lag_s:g} s can change; call settled(end=True) before"
            )
        made_with = {"size": self._sizes, "seed": self._seed, "fps": self._clock.fps}
        return {**made_with, "value_range": self._levels.value_range, "lag_s": self._lag_s}

    @property
    def _lag_s(self) -> float:
        return 0.0 if self._window is None else self._window.lag_s

    def _make_again(self, graph: CheckedGraph, options: Mapping[str, Any]) -> None:
        DetectionsTracker.__init__(self, graph, **options)

    def _renew_engine(self) -> None:
        self._sensors = sensor_columns(self._graph)
        self._fed, self._cameras = Fed(), CamerasFed.of(self._graph, self._sizes)
        if isinstance(self._sizes, dict) and self._cameras is None:
            raise ValueError(
                f"size={self._sizes!r}: sizes of cameras, and the graph {self._graph.spec.name} has not "
                "several; allowed: width and height of the frames"
            )
        self._size = None if isinstance(self._sizes, dict) else self._sizes
        fed = {GIVEN: self._fed} if self._cameras is None else self._cameras.detectors
        self._engine = make_engine(self._graph, self._seed, detectors=fed)

    @property
    def targets(self) -> tuple[FrameMetrics, ...]:
        """Measurements of every target in the last frame, also of lost ones."""
        return () if self._now is None else tuple(self._now.metrics)

    @property
    def events(self) -> tuple[Event, ...]:
        """Events and decisions of the last frame."""
        return () if self._now is None else self._now.events

    @property
    def looks_next(self) -> bool:
        """True if detections of the next frame are used; a detector need not run where they are not.

        The keys `every` and `pace` of `birth` say in which frames they are.
        """
        if self._now is None:
            return True
        ordinal, state = self._now.clock.index + 1, self._now.state
        return any(
            compiled.plate.inverses
            or (
                compiled.plate.spec.birth
                and ordinal % frames_between_looks(compiled, state.net, state.history) == 0
            )
            for compiled in self._engine.plates.values()
        )

    def choose_cameras(
        self, time_s: float | None = None, cameras: Iterable[str] | None = None
    ) -> tuple[str, ...]:
        """Cameras whose next frame is looked at, by `adapt` of the graph, the best first.

        Frames of others need neither be decoded nor searched: `update` does not read their detections.
        Before the first frame, and without `adapt`, all are looked at.

        Args:
            time_s: when the next frames are taken, as `update` will be told.
            cameras: those that have a frame then; None for all.

        Raises:
            ValueError: the graph has not several cameras, a name is none of them, or as `update` of a time.
        """
        if self._cameras is None:
            raise ValueError(f"the graph {self._graph.spec.name} has not several cameras to choose from")
        names = tuple(self._cameras.sizes if cameras is None else cameras)
        check_cameras(self._graph, dict.fromkeys(names, ()), "frames")
        if self._now is None or self._engine.budget is None:
            return names
        clock = self._now.clock.tick(time_s, ANEW)
        image = blank_image(*self._cameras.first_size)
        frame = Frame(clock.index, clock.time, image, time_s=clock.time_s)
        return choose_ahead(self._engine, self._now.state, self._cameras.step_of(frame, names))

    def __repr__(self) -> str:
        """The graph, the frames so far, and the targets."""
        metrics = self.targets
        count, index = len(metrics), -1 if self._now is None else self._now.clock.index
        live = "; ".join(map(repr, metrics[:3])) + ("; …" if count > 3 else "")
        frames = f"{plural(index + 1, 'frame')}, {plural(count, 'target')}"
        return f"<DetectionsTracker {self._graph.spec.name!r}, {frames}{': ' + live if live else ''}>"

    def update(
        self,
        detections: Any,
        frame: NDArray[np.uint8] | None = None,
        *,
        time_s: float | None = None,
        **unknown: Never,
    ) -> Any:
        """A copy of the detections with `tracker_id`, (n,) int64; `targets` has all that was measured.

        Boxes that are not finite, have no area or lie outside of the frame are left out, with a warning that
        names their rows; their `tracker_id` is -1.

        None says that no detector looked at the frame: nobody is missed in it, all targets are predicted, and
        the answer is None.

        A graph whose sensors measure quantities takes a mapping of those that looked, such as ``{"radar":
        {"range": [..], "bearing": [..]}}``, empty columns where one saw nothing, and gives the ids of each:
        agent -> (n,) int64.

        A graph with several cameras takes a mapping of those that have a frame at this time, such as
        ``{"north": boxes, "south": boxes}``, and gives one of copies. A camera without a frame is left out;
        one that saw nothing has no boxes.

        Args:
            detections: None, or with `xyxy` (n, 4) in px and, if it has them, `confidence` (n,) in 0..1 and
                `data["class_name"]` (n,), which a graph with `labels` needs.
            frame: the BGR frame: needed by graphs that look at it, of no use to others, where its size
                counts, which then stands for `size`.
            time_s: when the frame was taken, in seconds on the clock of the frames before it; given with all
                frames or with none. Without it every frame is taken for one that comes a nominal interval
                after the last one. With `lag_s` it is needed, and may lie before that of the last frame; of
                several cameras or sensors some may come later for the same time.

        Raises:
            TypeError: detections without `xyxy`, such as an array.
            RuntimeError: another thread is at work with this tracker.
            ValueError: boxes that are not (n, 4) numbers, confidences beyond 0..1, no class names for a graph
                with `labels`, or not one confidence or name for each box; no frame for a graph that looks at
                it, or one that is no picture or of another size than before; a time that is not later than
                the last one, or with `lag_s` one that is final. The tracker stays as it was.
        """
        if unknown:
            refuse_unknown("update", unknown)
        with self._turns.take("update"):
            arrival = Arrival(time_s, detections, frame)
            if self._window is None:
                self._now, marked = self._advance(self._now, arrival)
            else:
                self._window, marked = self._window.extended(arrival, self._advance, self._now, ANEW)
                self._now = self._window.newest
            return marked

    def settled(self, end: bool = False) -> list[SettledStep]:
        """Steps that have become final since the last call, in order of time; none without `lag_s`.

        They are the same, to the last bit, in whichever order the detections came within the lag.

        Args:
            end: nothing comes any more: those within the lag are final, too.

        Raises:
            RuntimeError: another thread is at work with this tracker.
        """
        with self._turns.take("settled"):
            if self._window is None:
                return []
            self._window, steps = self._window.collected(end)
            return steps

    def _advance(self, previous: Standing | None, arrival: Arrival) -> tuple[Standing, Any]:
        """The standing after an arrival, and its detections with `tracker_id`."""
        detections = arrival.detections
        clock = (self._clock if previous is None else previous.clock).tick(arrival.time_s, ANEW)
        image, kind = self._image(arrival.frame, previous, clock.index)
        of_cameras = {}
        current = Frame(clock.index, clock.time, image, bool(kind.has_color), clock.time_s, None)
        if self._cameras is not None:
            of_cameras = {} if detections is None else self._cameras.read(detections)
            current = self._cameras.frame(current, of_cameras)
        elif detections is None:
            self._fed.scanned, self._fed.now = {}, None
        elif self._sensors:
            self._fed.scanned, rows = read_scans(detections, self._sensors)
        else:
            boxes = read_given(detections, self._graph).inside(kind.width, kind.height)
            marked = copy.copy(detections)
            ids = np.full(boxes.count, NO_TARGET, dtype=np.int64)
            marked.tracker_id = ids  # what cannot be marked is refused before anything is learnt from it
            self._fed.now = boxes.detections
        if previous is None:
            check_starts(self._graph, [], kind.width, kind.height)
            outcome = start_targets(self._graph, self._engine, current, [])
        else:
            outcome = step(self._engine, previous.state, current)
        resizing = Resizing.to(kind.width, kind.height, None)
        standing = Standing(
            outcome.state, clock, outcome.metrics, outcome.events, kind, resizing, answers=outcome.answers
        )
        if detections is None:
            return standing, None
        if self._cameras is not None:
            return standing, mark(detections, of_cameras, self._engine, outcome.state, owners_by_share)
        if self._sensors:
            return standing, {
                agent: owners_by_share(outcome.state, agent, scan, rows[agent], _count(detections[agent]))
                for agent, scan in self._fed.scanned.items()
            }
        ids[boxes.rows] = owners(boxes.detections.boxes, outcome.metrics)
        return standing, marked

    def _image(
        self, frame: NDArray[np.uint8] | None, previous: Standing | None, index: int
    ) -> tuple[NDArray[np.uint8], FrameKind]:
        """The frame as it is tracked in, black where none is given and none is looked at, and its kind."""
        users = self._users
        if self._cameras is not None:
            if frame is not None:
                raise ValueError(
                    f"frame: the graph {self._graph.spec.name} has several cameras, and looks at no image; "
                    "call update({camera: detections}, time_s=...)"
                )
            size = self._cameras.first_size
            return blank_image(*size), FrameKind(*size, True, 3, "uint8")
        if frame is None:
            if users:
                raise ValueError(
                    f"the graph {self._graph.spec.name} looks at the image ({', '.join(users)}): call "
                    "update(detections, frame)"
                )
            size = (
                (self._size or self._graph.image_size or USUAL_SIZE)
                if previous is None
                else (previous.kind.width, previous.kind.height)
            )
            return blank_image(*size), FrameKind(*size, True, 3, "uint8")
        if not isinstance(frame, np.ndarray):
            raise ValueError(f"a frame is an array of pixels, not {type(frame).__name__}")
        image, has_color = self._levels(frame.copy())  # a copy: the caller may reuse its buffer
        checked = Frame(index, 0.0, image, has_color)
        kind = FrameKind.of(checked)
        if previous is not None:
            (previous.kind if users else previous.kind.of_either_color).check(checked, ANEW)
        elif self._size not in (None, (kind.width, kind.height)):
            width, height = self._size or USUAL_SIZE
            notice(f"size=({width}, {height}) is not used: the frame that is given has {kind}")
        return image, kind


def owners(boxes: NDArray[np.float64], targets: Sequence[FrameMetrics]) -> NDArray[np.int64]:
    """The target of each centre box (n, 4), best overlaps first; a target has one at most."""
    ids, places = Lines.of(targets).held()
    ids_of_boxes = [NO_TARGET] * len(boxes)
    columns, rows, shares = overlapping_pairs(places, boxes)
    order = np.lexsort((columns, rows, -shares))
    order_used = order[shares[order] >= LEAST_OVERLAP]
    assigned: set[int] = set()
    for row, column in zip(rows[order_used].tolist(), columns[order_used].tolist(), strict=True):
        if ids_of_boxes[row] == NO_TARGET and column not in assigned:
            ids_of_boxes[row] = int(ids[column])
            assigned.add(column)
    return np.array(ids_of_boxes, dtype=np.int64)


def owners_by_share(
    state: State, agent: str, scan: Scan, rows: NDArray[np.int64], count: int
) -> NDArray[np.int64]:
    """The target of each detection (count,) of a sensor: the one that it is more probably than not."""
    ids = np.full(count, NO_TARGET, dtype=np.int64)
    for target, target_state in state.targets.items():
        own_detections = target_state.references.get(agent, {}).get(OWN_DETECTION)
        if own_detections is None or not len(own_detections) or state.net.targets[target].status == "lost":
            continue
        width = scan.values.shape[1]
        weights = (
            own_detections[:, width + 1]
            if own_detections.shape[1] > width + 1
            else np.ones(len(own_detections))
        )
        heaviest = int(np.argmax(weights))
        if weights[heaviest] >= 0.5:
            same = np.flatnonzero((scan.values == own_detections[heaviest, :width]).all(axis=1))
            free = [row for row in rows[same].tolist() if ids[row] == NO_TARGET]
            ids[free[:1]] = int(target)
    return ids


def _count(columns: Mapping[str, Any]) -> int:
    """Number of rows that were given of a sensor."""
    return len(np.atleast_1d(next(iter(columns.values()))))


def _checked_sizes(size: Any) -> tuple[int, int] | dict[str, tuple[int, int]] | None:
    if isinstance(size, Mapping):
        return {str(camera): _checked(camera_size) for camera, camera_size in size.items()}
    return None if size is None else _checked(size)


def _checked(size: tuple[int, int]) -> tuple[int, int]:
    try:
        width, height = size
    except (TypeError, ValueError):
        raise ValueError(f"size={size!r}: width and height of the frames in px are needed") from None
    return whole_argument("size: width", width, 1), whole_argument("size: height", height, 1)
