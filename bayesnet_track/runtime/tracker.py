"""A tracker with OpenCV's `init` and `update`, so that any harness for OpenCV's trackers runs it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial
from os import PathLike
from typing import Any, ClassVar, Never

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.belief.contract import MotionModel
from bayesnet_track.belief.motion.modes import mode_probabilities
from bayesnet_track.engine.lines import Lines
from bayesnet_track.engine.modes import status_by_modes
from bayesnet_track.engine.queries import Forecast, check_forecasts, forecast
from bayesnet_track.engine.scoring.outcome import reported_status
from bayesnet_track.engine.starts import Start, check_given, check_started, say_blank, start_targets
from bayesnet_track.engine.step import Engine, make_engine, step
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.spec import GraphSpec
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.metrics import NOT_SHOWN, FrameMetrics, HasBox
from bayesnet_track.journal.text.wording import plural
from bayesnet_track.numerics.boxes import CornerBox
from bayesnet_track.observation import plugins
from bayesnet_track.observation.cue_files import GivenCue
from bayesnet_track.observation.planes import Depth, Frame, RightEye
from bayesnet_track.runtime.arguments import longest_side, say_unused_by_cues, whole_argument
from bayesnet_track.runtime.frame_clock import FrameClock, Standing, refuse_unknown, rehearse_boxes
from bayesnet_track.runtime.recording.interchange import Detections
from bayesnet_track.runtime.resizing import Resizing
from bayesnet_track.runtime.results import FrameKind
from bayesnet_track.runtime.storing import Storable, Turns
from bayesnet_track.sources.entrances.levels import Levels, ValueRange, value_range_of
from bayesnet_track.view.overlay import draw_targets

ANEW = "call init(frame, box, time_s=...) again"

NO_BOX = (-0.5, -0.5, 0.0, 0.0)
"""The centre box of zeros as a corner box: what stands for an estimate where there is no target."""


class Tracker(HasBox, Storable):
    """Track by a graph, frame by frame: one target from a box, and those that detectors find.

    The estimate of the first target is `xywh`, `xyxy` or `cxcywh`: float64 arrays (4,) in parts of a pixel.
    Without any target `xywh` is zeros. `update` returns `xywh` as a tuple, as OpenCV's trackers do.

    Args:
        graph: name of a graph that is installed ("general"), path of a YAML file, or a graph in Python.
        seed: seed of all random streams.
        motion: a motion model of one's own in place of the graph's, such as `FunctionMotion`.
        whole_px: `update` gives whole pixels, as OpenCV's trackers do; `cv2.rectangle` takes nothing else.
        allow_plugins: cues and detectors of other packages that may be loaded, in this process from now on,
            where graphs name them.
        cues: cues of one's own that the graph may name: declarations, or paths of Python files with a
            ``CUE``, which are run.
        max_side: track in frames whose longer side is at most so many px, 16 or more; boxes stay in the
            pixels of the frames that are given, lengths in the graph count those of the smaller ones.
        copy_frames: False for a caller that never writes into a frame that it gave: nothing is copied then.
        fps: nominal frames a second: numbers per frame in the graph, such as noise and speeds, count for
            1 / fps s, whenever frames really come (`time_s`). None for 25.
        value_range: the values that become black and white in the 8 bits in which frames are tracked, for
            frames with more; all that their type holds when None.

    Raises:
        GraphError: every error of the graph.
        CueError: a cue cannot be loaded, or is not what its declaration says.
        ValueError: `max_side` is less than 16, `fps` is no number of frames a second, or `value_range` no
            range.

    Example::

        tracker = Tracker("general")
        tracker.init(frame, (x, y, w, h))       # top-left corner box, BGR frame
        ok, box = tracker.update(next_frame)    # ok is False while the target is lost
        tracker.xyxy                            # the same box as an array of corners
        tracker.score                           # 0..1; a probability where the graph is calibrated
    """

    _kind: ClassVar[str] = "Tracker"

    def __init__(
        self,
        graph: str | PathLike[str] | GraphSpec | CheckedGraph = "general",
        seed: int = 0,
        motion: MotionModel | None = None,
        whole_px: bool = False,
        allow_plugins: Iterable[str] = (),
        cues: Iterable[GivenCue] = (),
        max_side: int | None = None,
        copy_frames: bool = True,
        fps: float | None = None,
        value_range: ValueRange | None = None,
    ) -> None:
        plugins.allow(allow_plugins)
        self._clock = FrameClock.of_rate(fps)
        self._made_with: dict[str, Any] = {
            "seed": whole_argument("seed", seed, 0),
            "whole_px": bool(whole_px),
            "max_side": longest_side(max_side),
            "copy_frames": bool(copy_frames),
            "fps": self._clock.fps,
            "value_range": value_range_of(value_range),
        }
        self._whole_px, self._copy_frames = whole_px, copy_frames
        self._graph = load_graph(graph, tuple(cues))
        say_unused_by_cues(self._graph)
        plate = next(iter(self._graph.targets))
        motions = None if motion is None else {plate: motion}
        self._make = partial(make_engine, seed=seed, motion=motions)
        self._engine: Engine = self._make(self._graph)
        self._max_side = max_side
        self._levels = Levels("frame 0", self._made_with["value_range"])
        self._now: Standing | None = None
        self._turns, self._has_own_motion = Turns(self._kind), motion is not None
        self._own = frozenset({*vars(self), "_own"})

    def __repr__(self) -> str:
        """Graph, and how the first target is."""
        name = self._graph.spec.name
        if self._now is None:
            return f"<Tracker {name!r}: not started, call init(frame, box)>"
        listed = ", ".join(map(repr, self.targets[:3]))
        return f"<Tracker {name!r}, {plural(len(self.targets), 'target')}: {listed}>"

    def _options(self) -> Mapping[str, Any]:
        return self._made_with

    def _make_again(self, graph: CheckedGraph, options: Mapping[str, Any]) -> None:
        Tracker.__init__(self, graph, **options)

    def _renew_engine(self) -> None:
        if self._now is not None and self._graph.masks:  # these are resized as the frames are
            self._engine = self._make(self._now.resizing.graph(self._graph))

    def init(
        self,
        frame: NDArray[np.uint8],
        box: CornerBox | Start | None = None,
        *,
        depth: Depth | None = None,
        time_s: float | None = None,
        **unknown: Never,
    ) -> None:
        """Start on the target inside `box` = (x, y, w, h), top-left corner, of the BGR or gray `frame`.

        Without a box, on what the detectors of the graph's births find. Where the graph has several classes,
        `box` is a `Start`, which names one.

        May be called again, to start anew on another target or in another video. `depth` is the rectified
        right picture or the points that belong to `frame`, for graphs with a stereo agent. `time_s` is when
        the frame was taken, in seconds from any origin. Both also in `update`.

        Raises:
            RuntimeError: another thread is at work with this tracker.
            ValueError: the box is not four finite numbers, has no area, there or in the frames of
                `max_side`, or does not touch the frame, there is none and nothing is born, the frame is no
                picture, no agent can start from it, or `time_s` is no time. The tracker stays as it was.
        """
        if unknown:
            refuse_unknown("init", unknown)
        with self._turns.take("init"):
            clock = self._clock.tick(time_s, ANEW)
            levels = Levels("frame 0", self._levels.value_range)
            first = _frame(frame, clock, depth, self._copy_frames, levels)
            starts = [] if box is None else [box if isinstance(box, Start) else Start(box)]
            check_given(self._graph, starts, first.width, first.height)
            say_blank(first, starts)
            resizing = Resizing.to(first.width, first.height, self._max_side)
            if depth is not None and not resizing.is_none:
                raise ValueError(
                    "max_side: frames with depth cannot be resized; allowed: frames of one camera"
                )
            placed = [resizing.start(start) for start in starts]
            engine = self._make(resizing.graph(self._graph)) if self._graph.masks else self._engine
            if depth is None and not self._has_own_motion:
                rehearse_boxes(self._graph, engine, placed, resizing.frame(first))
            begun = start_targets(self._graph, engine, resizing.frame(first), placed)
            check_started(self._graph, begun)
            outcome = resizing.outcome(begun)
            self._engine, self._levels = engine, levels
            self._now = Standing(
                begun.state,
                clock,
                outcome.metrics,
                outcome.events,
                FrameKind.of(first),
                resizing,
                answers=outcome.answers,
            )

    def update(
        self,
        frame: NDArray[np.uint8],
        *,
        depth: Depth | None = None,
        time_s: float | None = None,
        **unknown: Never,
    ) -> tuple[bool, CornerBox]:
        """Process the next frame: (False while lost else True, the estimate as a top-left corner box).

        Of several targets it is that of the first (`targets` has all); without any it is (False, zeros).

        `time_s` is when the frame was taken, in seconds on the clock of the frames before it: beliefs are
        predicted over the true time from one frame to the next. Without it every frame is taken for one that
        comes a nominal interval after the last one. It is given with all frames or with none.

        Raises:
            RuntimeError: `init` was not called, or another thread is at work with this tracker.
            ValueError: the frame is no picture, not of the first one's size and channels, or not later than
                the last one, or `time_s` is no time or is given with some frames only; the tracker stays as
                it was.
        """
        if unknown:
            refuse_unknown("update", unknown)
        with self._turns.take("update"):
            standing = self._now
            if standing is None:
                raise RuntimeError("call init(frame, box) before update(frame)")
            clock = standing.clock.tick(time_s, ANEW)
            current = _frame(frame, clock, depth, self._copy_frames, self._levels)
            standing.kind.check(current, "call init again")
            tracked = step(self._engine, standing.state, standing.resizing.frame(current))
            outcome = standing.resizing.outcome(tracked)
            self._now = replace(
                standing,
                state=tracked.state,
                clock=clock,
                metrics=outcome.metrics,
                events=outcome.events,
                nets_before=standing.state.net.targets,
                answers=outcome.answers,
            )
        x, y, w, h = self.centre_box
        box = (x - (w - 1.0) / 2.0, y - (h - 1.0) / 2.0, w, h)  # as `xywh`, without an array
        if self._whole_px:
            box = (round(box[0]), round(box[1]), round(w), round(h))
        return self.status not in NOT_SHOWN, box

    @property
    def centre_box(self) -> tuple[float, ...]:
        """Centre x, y, width and height of the first target, as numbers; zeros without any target.

        Raises:
            RuntimeError: `init` was not called.
        """
        first = _first_live(self._started)
        return NO_BOX if first is None else first[1]

    def predict(self, frames: int = 1) -> tuple[Forecast, ...]:
        """Forecast each target 1 to `frames` nominal intervals after the last frame, with regions.

        An interval is 1 / `fps` s, also where frames came at other times. Nothing is learnt: the next
        `update` gives what it would have given.

        Raises:
            RuntimeError: `init` was not called.
            ValueError: `frames` is less than 1, or targets are on the ground.

        Example::

            for ahead in tracker.predict(5):
                print(ahead.target, ahead.ahead, ahead.xywh, ahead.region90)
        """
        standing = self._started
        if frames < 1:
            raise ValueError(f"predict({frames}): at least 1 frame ahead is needed")
        check_forecasts(self._graph.spec)
        size, states, births = (
            standing.resizing.tracked,
            standing.state.targets,
            standing.state.history.births,
        )
        return tuple(
            standing.resizing.estimate(expected)
            for line in standing.metrics
            if line.target in states
            for expected in forecast(
                self._engine, states[line.target], births[line.target], line, frames, size
            )
        )

    def plot(self, frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """A copy of `frame`, which was processed last, as 8-bit BGR, with every target drawn on it.

        Raises:
            RuntimeError: `init` was not called.
            ValueError: the frame is no picture.
        """
        targets = self.targets
        return draw_targets(_picture(frame, self._levels)[0], targets)

    def detections(self, lost: bool = False) -> Detections:
        """The targets of the last frame in the shape of supervision's; `lost` for lost ones, too.

        Its `time_s` is that of the frame: as given to `update`, else frames / `fps`, else NaN.
        """
        standing = self._started
        # Who ended in the last frame is measured in it, too.
        nets = {**standing.nets_before, **standing.state.net.targets}
        kinds = {target: net.template for target, net in nets.items()}
        return Detections.of(tuple(standing.metrics), kinds, tuple(self._graph.targets), lost)

    @property
    def targets(self) -> tuple[FrameMetrics, ...]:
        """Everything measured in the last frame, for every target that was live in it."""
        return tuple(self._started.metrics)

    @property
    def metrics(self) -> FrameMetrics:
        """Everything measured of the first target in the last frame, as UD, active agents, KL, sd, ...

        The first target is the one of `xywh` and `status`; one that ended in the frame is only in `targets`.

        Raises:
            RuntimeError: `init` was not called, or no target is live.
        """
        line = _first_line(self._started)
        if line is None:
            raise RuntimeError("no target is live after the last frame")
        return line

    @property
    def score(self) -> float:
        """Probability of being on target (IoU above 0.5) where the graph has `score`, 0 without a target.

        Elsewhere an index in 0..1 from UD and evidence: high is sure, but it is no probability.
        """
        line = _first_line(self._started)
        return 0.0 if line is None else line.score

    def getTrackingScore(self) -> float:
        """`score`, by the name that OpenCV's trackers have for it."""
        return self.score

    @property
    def status(self) -> str:
        """tracking, uncertain, lost or hidden after the last frame, of the first target; lost without any."""
        standing = self._started
        first = _first_live(standing)
        if first is None:
            return "lost"
        target, _ = first
        net = standing.state.net.targets[target]
        plate = self._graph.targets[net.template]
        rule = plate.inference(plate.root).guarantee
        modes = self._engine.plates[net.template].modes
        can_hide = modes is not None and modes.can_hide
        if rule is None and not can_hide:
            return net.status
        state = standing.state.targets[target]
        status = net.status if rule is None else reported_status(net.status, state.scored, rule)
        if modes is None or not can_hide:
            return status
        return status_by_modes(status, modes, mode_probabilities(state.belief, len(modes)))

    @property
    def _started(self) -> Standing:
        if self._now is None:
            raise RuntimeError("call init(frame, box) first")
        return self._now

    @property
    def events(self) -> tuple[Event, ...]:
        """Events and decisions of the last frame."""
        return () if self._now is None else self._now.events


def _first_live(standing: Standing) -> tuple[str, tuple[float, ...]] | None:
    """The first target of the last frame that is live after it, and its centre box; makes no lines."""
    (ids, boxes, _), live = Lines.of(standing.metrics).places, standing.state.net.targets
    for target, box in zip(ids, boxes.tolist(), strict=True):
        if target in live:
            return target, tuple(box)
    return None


def _first_line(standing: Standing) -> FrameMetrics | None:
    live = standing.state.net.targets
    return next((line for line in standing.metrics if line.target in live), None)


def _picture(image: NDArray[np.uint8], levels: Levels) -> tuple[NDArray[np.uint8], bool]:
    if not isinstance(image, np.ndarray):
        advice = "could the image be read?"
        if hasattr(image, "get"):
            advice = "frame.get() is one"
        elif hasattr(image, "__array__") or hasattr(image, "__array_interface__"):
            advice = "numpy.asarray(frame) is one; channels in the order blue, green, red"
        raise ValueError(f"a frame is an array of pixels, not {type(image).__name__}; {advice}")
    return levels(image)


def _frame(
    image: NDArray[np.uint8], clock: FrameClock, depth: Depth | None, copies: bool, levels: Levels
) -> Frame:
    picture, has_color = _picture(image, levels)
    if copies and np.may_share_memory(picture, image):
        picture = picture.copy()  # the caller may reuse its buffer, and the next step looks at it again
    if depth is not None:
        second = depth.image if isinstance(depth, RightEye) else depth.points
        if second.shape != picture.shape:
            raise ValueError(f"depth of shape {second.shape} does not fit a picture of {picture.shape}")
    return Frame(clock.index, clock.time, picture, has_color, clock.time_s, depth)
