"""Data that a run reads and gives: kinds of frames, outside inputs, results, the summary."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.engine.groups import AgentMessages
from bayesnet_track.engine.lines import Lines
from bayesnet_track.engine.state import TargetState
from bayesnet_track.journal.events.event import Event, Input
from bayesnet_track.journal.events.faults import Quarantined
from bayesnet_track.journal.events.load import Released, Toggled
from bayesnet_track.journal.metrics import Answers, FrameMetrics
from bayesnet_track.journal.net import Decision, Switch
from bayesnet_track.journal.reader import Notice, read_inputs
from bayesnet_track.journal.text.wording import plural
from bayesnet_track.numerics.arrays import Floats
from bayesnet_track.observation.planes import Frame
from bayesnet_track.runtime.recording.interchange import Detections
from bayesnet_track.sources.entrances.levels import to_bgr
from bayesnet_track.sources.frames import DecodedFrame, EndReason, SourceItem
from bayesnet_track.view.overlay import draw_targets


@dataclass(frozen=True)
class FrameKind:
    """Size, colour and pixels of a frame.

    Attributes:
        width: columns.
        height: rows.
        has_color: whether it has colour; None for either.
        channels: values per pixel.
        dtype: name of their type.
    """

    width: int
    height: int
    has_color: bool | None
    channels: int
    dtype: str

    @classmethod
    def of(cls, frame: Frame) -> Self:
        """The kind of a frame."""
        if isinstance(frame, DecodedFrame):  # its pixels need not have been made
            return cls(frame.width, frame.height, frame.has_color, 3, "uint8")
        height, width, *channels = frame.image.shape
        return cls(width, height, frame.has_color, channels[0] if channels else 1, frame.image.dtype.name)

    @property
    def of_either_color(self) -> Self:
        """The same, whether or not it has colour."""
        return replace(self, has_color=None)

    def __str__(self) -> str:
        """In words: "640x480 colour"."""
        shade = {True: " colour", False: " gray", None: ""}[self.has_color]
        is_usual = (self.channels, self.dtype) == (3, "uint8")
        pixels = "" if is_usual else f" with {plural(self.channels, 'channel')} of {self.dtype}"
        return f"{self.width}x{self.height}{shade}{pixels}"

    def check(self, frame: Frame, otherwise: str) -> None:
        """Refuse a frame of another kind; `otherwise` says what else can be done. Raises ValueError."""
        kind = FrameKind.of(frame)
        if (kind.of_either_color if self.has_color is None else kind) != self:
            raise ValueError(
                f"frame {frame.index} is {kind}, the frames before it are {self}; "
                f"bring it to their size and channels, or {otherwise}"
            )


InputsAt = Callable[[int], Sequence[Input]]
"""Frame index -> what came from outside for it; asked once, right before the frame."""


def nothing(frame: int) -> Sequence[Input]:
    """Nothing comes from outside."""
    return ()


def replay_inputs(path: Path, notice: Notice | None = None) -> InputsAt:
    """External inputs of an earlier run, by its ``inputs.jsonl``.

    Raises:
        OSError: the file cannot be read.
        JournalError: it is damaged; says file and line.
    """
    by_frame: dict[int, list[Input]] = {}
    for entry in read_inputs(path, notice):
        by_frame.setdefault(entry.frame, []).append(entry)
    inputs: Mapping[int, Sequence[Input]] = by_frame
    return lambda frame: inputs.get(frame, ())


def as_inputs(source: str | PathLike[str] | InputsAt | None) -> InputsAt:
    """A file as `replay_inputs`, a function as it is, nothing for None."""
    if source is None:
        return nothing
    return source if callable(source) else replay_inputs(Path(source))


class Switchboard:
    """Takes what people ask for while a run goes on, from any thread, and hands it to the next frame.

    >>> board = Switchboard()
    >>> board.switch("1", "motion", on=False)
    >>> board(7)
    (Toggled(frame=7, target='1', node='motion', on=False),)
    >>> board(8)
    ()
    """

    def __init__(self) -> None:
        self._asked: SimpleQueue[Callable[[int], Input]] = SimpleQueue()

    def switch(self, target: str, agent: str, on: bool) -> None:
        """Switch an agent on or off, until it is released."""
        self._asked.put(lambda frame: Toggled(frame, target, agent, on))

    def release(self, target: str, agent: str) -> None:
        """Give an agent back to the rules."""
        self._asked.put(lambda frame: Released(frame, target, agent))

    def __call__(self, frame: int) -> Sequence[Input]:
        """All that was asked for since the last frame, in order."""
        requests: list[Input] = []
        while True:
            try:
                requests.append(self._asked.get_nowait()(frame))
            except Empty:
                return tuple(requests)


class FrameSource(Protocol):
    """An iterable of frames and notices, with what is known of it."""

    @property
    def description(self) -> str:
        """The source as given."""

    @property
    def expected_frames(self) -> int | None:
        """Number of frames to come, where the source declares it."""

    @property
    def frame_interval_s(self) -> float:
        """Nominal seconds between frames."""

    @property
    def width(self) -> int:
        """Columns of the first frame."""

    @property
    def height(self) -> int:
        """Rows of the first frame."""

    @property
    def end_reason(self) -> EndReason:
        """The reason why it ended; end_of_source while nothing is wrong."""

    def __iter__(self) -> Iterator[SourceItem]: ...


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """Everything that one frame gave.

    Attributes:
        frame: the frame.
        targets: measurements, one per live target (estimate, UD, active agents, ...).
        covariances: target id -> covariance (D, D) of its belief, in pixels of the frames tracked in.
        decisions: what was decided in this frame, working from the next on.
        seconds: seconds per agent and stage.
        total_seconds: seconds of the whole step, without decoding, writing and compiling.
        external_inputs: what came from outside, such as a person's switches.
        kinds: target id -> name of its plate, for all in `targets`.
        states: target id -> what is known of it after the frame, its belief included; in these pixels, too.
        heard: target id -> what its agents said in the frame.
        births: target id -> what its draws are keyed by (`numerics.streams.birth_key`).
        plates: names of all plates of the graph, in its order; empty where unknown.
        queries: query -> its answers, by target or pair; in pixels of the frames tracked in.
        cameras: camera that sees targets on the ground -> its innovations, as columns ``cameras/NAME/...`` of
            the file of frames have them.
    """

    frame: Frame
    targets: Sequence[FrameMetrics]
    covariances: dict[str, Floats]
    decisions: tuple[Decision, ...]
    seconds: dict[str, float]
    total_seconds: float = 0.0
    external_inputs: tuple[Input, ...] = ()
    kinds: dict[str, str] = field(default_factory=dict)
    states: Mapping[str, TargetState] = field(default_factory=dict)
    heard: Mapping[str, AgentMessages] = field(default_factory=dict)
    births: Mapping[str, str] = field(default_factory=dict)
    plates: tuple[str, ...] = ()
    queries: Mapping[str, Answers] = field(default_factory=dict)
    cameras: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def detections(self, lost: bool = False) -> Detections:
        """The targets' boxes in the shape of supervision's; `lost` for those of lost targets, too."""
        return Detections.of(self.targets, self.kinds, self.plates or None, lost)

    def plot(self, frame: NDArray[np.uint8] | None = None) -> NDArray[np.uint8]:
        """A copy of `frame` (its own when None), as 8-bit BGR, with boxes, hypotheses and labels of targets.

        Raises:
            ValueError: the frame is no picture.
        """
        return draw_targets(self.frame.image if frame is None else to_bgr(frame)[0], self.targets)

    def __repr__(self) -> str:
        """Frame, targets and how much was decided."""
        targets = ", ".join(map(repr, self.targets)) or "no target"
        return f"<frame {self.frame.index}: {targets}; {plural(len(self.decisions), 'decision')}>"


class Sink(Protocol):
    """An observer of a run, called as things happen. It cannot change a result."""

    def event(self, event: Event) -> None:
        """A decision, a fault or a notice."""

    def frame(self, result: Result) -> None:
        """Take the result of a frame, after its events."""


@dataclass
class Summary:
    """The course of a run, filled in while it goes on.

    Attributes:
        frames: frames that were tracked.
        reconfigurations: how many times an agent was switched on or off.
        lost_frames: frames in which a target was lost.
        complete: whether the source was read to its end.
        reason: why it ended, in the words of `RunEnded.reason`.
        seconds: wall-clock seconds, decoding and writing included.
        compiling_s: seconds of them in which kernels were compiled here, as at the first run on a machine.
        frames_per_second: after the first frame, in which everything is loaded, and without compiling; 0
            where no second frame was tracked here.
        notices: what was wrong with the source.
        most_targets: the largest number of targets in a frame that was tracked here.
        target_frames: sum of the number of targets over the frames that were tracked here.
        lost_target_frames: the same of the targets that were lost.
        failures: the first failure of each agent, by its node and reason, of frames that were tracked here.
    """

    frames: int = 0
    reconfigurations: int = 0
    lost_frames: int = 0
    complete: bool = False
    reason: str = "error"
    seconds: float = 0.0
    compiling_s: float = 0.0
    frames_per_second: float = 0.0
    notices: list[Event] = field(default_factory=list)
    most_targets: int = 0
    target_frames: int = 0
    lost_target_frames: int = 0
    failures: dict[tuple[str, str], Quarantined] = field(default_factory=dict)

    def add(self, result: Result) -> None:
        """Count one more frame."""
        self.frames += 1
        self.reconfigurations += sum(isinstance(event, Switch) for event in result.decisions)
        lost = int(Lines.of(result.targets).places.is_lost.sum())
        self.lost_frames += lost > 0
        self.lost_target_frames += lost
        self.target_frames += len(result.targets)
        self.most_targets = max(self.most_targets, len(result.targets))
        for event in result.decisions:
            if isinstance(event, Quarantined):
                self.failures.setdefault((event.node, event.reason), event)


def interval_of(source: FrameSource) -> float:
    """Nominal seconds between the frames that `source` gives, of which it may leave some out."""
    return source.frame_interval_s * int(getattr(source, "stride", 1))
