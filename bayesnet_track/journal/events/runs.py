"""Events of a run and of its source: started, continued, ended; frames missing, late or damaged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from bayesnet_track.journal.text.wording import plural

JOURNAL_VERSION = 2


@dataclass(frozen=True)
class RunStarted:
    """First line of every journal.

    Attributes:
        journal: version of the file format.
        graph: the graph's name.
        graph_sha256: hash of the graph's canonical text, which stands in graph.yaml.
        seed: seed of all random streams.
        source: the source as given.
        width: columns of the first frame.
        height: rows of the first frame.
        has_color: False for a gray source.
        declared_frames: number of frames that the source declares, or None.
        frame_interval_s: nominal seconds between frames (1 time unit).
        costs_ms: declared cost of each cue, which rules weigh with.
        versions: of Python and of the libraries that touch numbers.
        inputs: files from outside besides the source (of detections), each with its SHA-256; left out when
            there are none.
        smoothed: whether boxes and uncertainties are of beliefs given the whole sequence (`smooth`); left out
            when they are the filter's.
        tracked: width and height of the frames tracked in, where they were made smaller (`max_side`); boxes
            are in the source's pixels all the same, UD is not. Left out when they were not.
    """

    journal: int
    graph: str
    graph_sha256: str
    seed: int
    source: str
    width: int
    height: int
    has_color: bool
    declared_frames: int | None
    frame_interval_s: float
    costs_ms: Mapping[str, float] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    inputs: Mapping[str, str] = field(default_factory=dict, metadata={"left_out_when_empty": True})
    smoothed: bool = field(default=False, metadata={"left_out_when_empty": True})
    tracked: tuple[int, ...] = field(default=(), metadata={"left_out_when_empty": True})

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        colour = "" if self.has_color else " gray"
        length = "" if self.declared_frames is None else f", {plural(self.declared_frames, 'frame')}"
        kind = "smoothed run" if self.smoothed else "run"
        resized = " tracked at {}x{}".format(*self.tracked) if self.tracked else ""
        rate = (
            f"{1 / self.frame_interval_s:.4g} frames per second" if self.frame_interval_s > 0 else "no rate"
        )
        return (
            f"{kind} of {self.graph} ({self.graph_sha256[:12]}) on {self.source}: "
            f"{self.width}x{self.height}{resized}{colour}{length}, {rate}; seed {self.seed}"
        )


@dataclass(frozen=True)
class RunEnded:
    """Last line of a journal that was closed properly.

    Attributes:
        frames: frames read.
        declared_frames: what the source declared, or None.
        complete: False when the source ended early, was damaged, or the run was stopped.
        reason: end_of_source, source_truncated, source_damaged, frame_size_changed, interrupted, error.
    """

    frames: int
    declared_frames: int | None
    complete: bool
    reason: str

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        declared = self.declared_frames
        is_whole = declared is None or declared == self.frames
        frames = plural(self.frames, "frame") if is_whole else f"{self.frames} of {declared} frames"
        how = "ended" if self.complete else "ended early"
        return f"run {how} after {frames}: {self.reason.replace('_', ' ')}"


@dataclass(frozen=True)
class MachineChanged:
    """The run was resumed on another machine or with other libraries, because that was explicitly allowed.

    From this frame on its numbers may differ in their last digits from those of an unbroken run on either.

    Attributes:
        frame: the first frame that is computed there.
        changes: what differs, each in words: name, before, now.
    """

    frame: int
    changes: tuple[str, ...]

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        change = "the run continues on another machine or with other libraries"
        return f"{change}: {'; '.join(self.changes)}"


@dataclass(frozen=True)
class FramesMissing:
    """The source jumps in time: frames are missing before `frame`; the belief is predicted over the gap.

    Attributes:
        frame: first frame after the gap.
        missing: how many nominal frame intervals are missing.
    """

    frame: int
    missing: float

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        gap = plural(self.missing, "frame interval")
        return f"{gap} missing before it; the belief is predicted over the gap"


@dataclass(frozen=True)
class FrameSizeChanged:
    """The images change size or number of channels at this frame.

    Attributes:
        frame: the frame.
        width: new columns.
        height: new rows.
        action: stop, or rescale to the first frame's size.
    """

    frame: int
    width: int
    height: int
    action: str

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        effect = "the run stops" if self.action == "stop" else "they are scaled to the first frame's size"
        return f"the frame size changes to {self.width}x{self.height}; {effect}"


@dataclass(frozen=True)
class SourceDamaged:
    """The source is damaged at or before this frame.

    Attributes:
        frame: next frame to be read.
        reason: what the decoder said.
        times: how often it said so before another frame could be read.
        last: next frame to be read when it said so last; None where that was once.
    """

    frame: int
    reason: str
    times: int = 1
    last: int | None = None

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        span = "" if self.last in (None, self.frame) else f" up to frame {self.last}"
        often = "" if self.times == 1 else f", {self.times} times{span}"
        return f"the source is damaged{often}: {self.reason}"


OUTDATED = "newer ones had arrived"


@dataclass(frozen=True)
class FramesDropped:
    """Images of a live source were dropped, mostly because newer ones had arrived when the tracker was ready.

    Attributes:
        frame: next frame to be read.
        dropped: how many since the last such event.
        reason: why.
    """

    frame: int
    dropped: int
    reason: str = OUTDATED

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        return f"{plural(self.dropped, 'frame')} dropped, because {self.reason}"


@dataclass(frozen=True)
class SourceStalled:
    """A live source delivered no image for a while; the program reconnects.

    Attributes:
        frame: next frame to be read.
        seconds: wall-clock seconds since the last image.
        reason: what was wrong.
        attempt: attempts to reconnect since the last image, this one included.
    """

    frame: int
    seconds: float
    reason: str
    attempt: int

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        silent = f"source stalled for {self.seconds:.1f} s: {self.reason}"
        return f"{silent}; reconnecting, attempt {self.attempt}"
